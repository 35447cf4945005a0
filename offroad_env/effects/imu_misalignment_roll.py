"""The IMU is mounted rolled to the right."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values, rotated

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, mount=rotated(setup.mount, values["angle"], 0.0))


EFFECT = Effect(
    id="imu_misalignment_roll",
    family="sensor",
    hook="sensor",
    size=Parameter(name="angle", unit="rad", low=-0.6, high=0.6),
    plausible=lambda vehicle: 0.1,
    sentence="the IMU is rolled to the right by {size}",
    look_alikes=("accel_bias_y", "bank"),
    separated_by="driving the same line both ways",
    sensors_only=True,
    change=_change,
)
