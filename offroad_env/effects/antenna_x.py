"""The point whose position is measured lies ahead of the centre of gravity."""

from __future__ import annotations

from dataclasses import replace

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return replace(setup, errors=replace(setup.errors, antenna=setup.errors.antenna + values["distance"]))


EFFECT = Effect(
    id="antenna_x",
    family="sensor",
    hook="sensor",
    size=Parameter(name="distance", unit="m", low=-10.0, high=10.0),
    plausible=lambda vehicle: vehicle.l_f + vehicle.l_r,
    sentence="the positions are those of a point {size} further ahead on the vehicle than stated",
    look_alikes=("pose_delay",),
    separated_by="tight turns at walking pace",
    needs=(("x", "y"),),
    sensors_only=True,
    change=_change,
)
