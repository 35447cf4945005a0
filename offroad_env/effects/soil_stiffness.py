"""Other moduli of sinkage than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    soil, share = setup.plant.soil, 1.0 + values["share"]
    return setup.with_soil(k_c=share * soil.k_c, k_phi=share * soil.k_phi)


EFFECT = Effect(
    id="soil_stiffness",
    family="soil",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.95, high=20.0),
    plausible=lambda vehicle: 1.0,
    sentence="the moduli of sinkage are {size} of their value larger",
    look_alikes=("load_scale", "sinkage_offset"),
    separated_by="trials at several loads",
    models=("rig",),
    soil_only=True,
    change=_change,
)
