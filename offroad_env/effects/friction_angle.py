"""The soil is stronger in shear than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    phi = min(max(setup.plant.soil.phi + values["angle"], 0.01), 1.2)
    return setup.with_soil(phi=phi)


EFFECT = Effect(
    id="friction_angle",
    family="wheel",
    hook="parameter",
    size=Parameter(name="angle", unit="rad", low=-0.5, high=0.6),
    plausible=lambda vehicle: 0.15,
    sentence="the angle of internal friction is {size} larger",
    look_alikes=("grouser_thrust", "shear_modulus"),
    separated_by="a shear box",
    models=("full", "paper", "rig"),
    soil_only=True,
    change=_change,
)
