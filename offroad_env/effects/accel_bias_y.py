"""Constant error of a_y."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, errors=setup.errors.shifted(1, values["bias"]))


EFFECT = Effect(
    id="accel_bias_y",
    family="sensor",
    hook="sensor",
    size=Parameter(name="bias", unit="m/s^2"),
    plausible=lambda vehicle: 1.0,
    sentence="a_y reads {size} too much",
    look_alikes=("imu_misalignment_roll", "bank"),
    separated_by="standing still, then turned by 180 degrees",
    needs=(("a_y",),),
    sensors_only=True,
    change=_change,
)
