"""Constant error of a_z."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, errors=setup.errors.shifted(2, values["bias"]))


EFFECT = Effect(
    id="accel_bias_z",
    family="sensor",
    hook="sensor",
    size=Parameter(name="bias", unit="m/s^2"),
    plausible=lambda vehicle: 1.0,
    sentence="a_z reads {size} too much",
    look_alikes=("accel_scale",),
    separated_by="standing still",
    needs=(("a_z",),),
    sensors_only=True,
    change=_change,
)
