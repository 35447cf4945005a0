"""The IMU sits further up than stated."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    lever = setup.mount.lever.copy()
    lever[2] += values["distance"]
    return replace(setup, mount=setup.mount._replace(lever=lever))


EFFECT = Effect(
    id="lever_arm_z",
    family="sensor",
    hook="sensor",
    size=Parameter(name="distance", unit="m", low=-10.0, high=10.0),
    plausible=lambda vehicle: 0.5,
    sentence="the IMU sits {size} further above the centre of gravity than stated",
    look_alikes=(),
    separated_by="hard turns and bumps",
    sensors_only=True,
    change=_change,
)
