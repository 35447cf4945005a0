"""Constant error of pitch_rate."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, errors=setup.errors.shifted(3, values["bias"]))


EFFECT = Effect(
    id="gyro_bias_pitch",
    family="sensor",
    hook="sensor",
    size=Parameter(name="bias", unit="rad/s"),
    plausible=lambda vehicle: 0.05,
    sentence="pitch_rate reads {size} too much",
    look_alikes=(),
    separated_by="standing still",
    needs=(("pitch_rate",),),
    sensors_only=True,
    change=_change,
)
