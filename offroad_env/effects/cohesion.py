"""Another cohesion than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return setup.with_soil(c=max(setup.plant.soil.c + values["stress"], 0.0))


EFFECT = Effect(
    id="cohesion",
    family="wheel",
    hook="parameter",
    size=Parameter(name="stress", unit="Pa", low=-1e5, high=5e5),
    plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * vehicle.r * vehicle.b),
    sentence="the cohesion is {size} larger",
    look_alikes=("friction_angle", "grouser_thrust"),
    separated_by="a shear box, or trials at several loads",
    models=("rig",),
    soil_only=True,
    change=_change,
)
