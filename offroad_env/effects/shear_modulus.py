"""Thrust and side force build up more slowly with slip."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    soil, share = setup.plant.soil, 1.0 + values["share"]
    return setup.with_soil(k_x=share * soil.k_x, k_y=share * soil.k_y)


EFFECT = Effect(
    id="shear_modulus",
    family="wheel",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.9, high=10.0),
    plausible=lambda vehicle: 1.0,
    sentence="the shear moduli are {size} of their value larger",
    look_alikes=("friction_angle", "steer_gain"),
    separated_by="steady pulls at several slips",
    models=("full", "paper", "rig"),
    soil_only=True,
    change=_change,
)
