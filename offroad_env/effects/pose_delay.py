"""What says where the vehicle is comes late against the other sensors."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, errors=replace(setup.errors, pose_delay=setup.errors.pose_delay + values["delay"]))


EFFECT = Effect(
    id="pose_delay",
    family="sensor",
    hook="sensor",
    size=Parameter(name="delay", unit="s", low=-0.5, high=1.0),
    plausible=lambda vehicle: 0.3,
    sentence="position, heading and speed over ground are {size} older than they say",
    look_alikes=("antenna_x",),
    separated_by="braking and turning hard",
    needs=(("x", "y", "yaw", "speed", "course"),),
    sensors_only=True,
    change=_change,
)
