"""The largest pressure lies elsewhere under the wheel than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return setup.with_soil(a_0=setup.plant.soil.a_0 + values["share"])


EFFECT = Effect(
    id="peak_angle",
    family="wheel",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.9, high=0.8),
    plausible=lambda vehicle: 0.2,
    sentence="the largest pressure lies {size} of the entry angle further ahead",
    look_alikes=("exit_angle", "front_bulldozing"),
    separated_by="wheel tests with a pressure cell",
    models=("rig",),
    soil_only=True,
    change=_change,
)
