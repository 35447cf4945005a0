"""The contact reaches further behind the axle."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return setup.with_soil(b_0=setup.plant.soil.b_0 + values["share"])


EFFECT = Effect(
    id="exit_angle",
    family="wheel",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.6, high=0.6),
    plausible=lambda vehicle: 0.2,
    sentence="the exit angle is {size} of the entry angle larger",
    look_alikes=("n_step", "payload"),
    separated_by="wheel tests with a pressure cell",
    models=("full", "paper", "rig"),
    soil_only=True,
    change=_change,
)
