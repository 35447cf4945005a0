"""The vehicle carries more than stated."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter, Setup, Values

__all__ = ["EFFECT"]


def _change(setup: Setup, values: Values) -> Setup:
    v, share = setup.plant.vehicle, 1.0 + values["share"]
    return setup.with_vehicle(m=share * v.m, I_z=share * v.I_z, I_y=share * v.I_y)


EFFECT = Effect(
    id="payload",
    family="mass",
    hook="parameter",
    size=Parameter(name="share", unit="-", low=-0.5, high=2.0),
    plausible=lambda vehicle: 0.4,
    sentence="the vehicle is {size} of its mass heavier than stated",
    look_alikes=("torque_scale",),
    separated_by="a weighbridge, or braking and driving with known torque",
    change=_change,
)
