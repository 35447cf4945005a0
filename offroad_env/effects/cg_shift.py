"""The centre of gravity lies further back than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    v = setup.plant.vehicle
    back = min(max(values["distance"], 0.1 - v.l_f), v.l_r - 0.1)
    return setup.with_vehicle(l_f=v.l_f + back, l_r=v.l_r - back)


EFFECT = Effect(
    id="cg_shift",
    family="mass",
    hook="parameter",
    size=Parameter(name="distance", unit="m", low=-2.0, high=2.0),
    plausible=lambda vehicle: 0.2 * (vehicle.l_f + vehicle.l_r),
    sentence="the centre of gravity lies {size} further back than stated",
    look_alikes=(),
    separated_by="an axle scale",
    change=_change,
)
