"""Hard ground is more or less slippery than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    return setup.with_soil(mu=(1.0 + values["share"]) * setup.plant.soil.mu)


EFFECT = Effect(
    id="road_grip",
    family="lateral",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
    plausible=lambda vehicle: 0.3,
    sentence="the friction coefficient of the ground is {size} of its value larger",
    look_alikes=("steer_gain", "front_grip"),
    separated_by="turns at the limit of what the tyres hold",
    hard_only=True,
    change=_change,
)
