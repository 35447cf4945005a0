"""Uncertain masses of the vehicle, one row an effect."""

from __future__ import annotations

from functools import partial

from offroad_env.effects.protocol import Effect, Parameter, Setup

__all__ = ["TABLE"]

_row = partial(Effect, family="mass", hook="parameter")

#: Shortest distance between the centre of gravity and an axle [m]: no axle without load.
_NEAREST = 0.1


def _further_back(setup: Setup, distance: float) -> Setup:
    """The centre of gravity further back [m], but between the axles."""
    v = setup.plant.vehicle
    back = min(max(distance, _NEAREST - v.l_f), v.l_r - _NEAREST)
    return setup.with_vehicle(l_f=v.l_f + back, l_r=v.l_r - back)


def _heavier(setup: Setup, share: float) -> Setup:
    """A payload that is spread like the vehicle's own mass: inertias grow in proportion."""
    v, factor = setup.plant.vehicle, 1.0 + share
    return setup.with_vehicle(m=factor * v.m, I_z=factor * v.I_z, I_y=factor * v.I_y)


TABLE = (
    _row(
        id="cg_shift",
        size=Parameter(name="distance", unit="m", low=-2.0, high=2.0),
        plausible=lambda vehicle: 0.2 * (vehicle.l_f + vehicle.l_r),
        sentence="the centre of gravity lies {size} further back than stated",
        source="definition: shift of l_f and l_r, their sum being the wheelbase",
        separated_by="an axle scale",
        change=_further_back,
    ),
    _row(
        id="payload",
        size=Parameter(name="share", unit="-", low=-0.5, high=2.0),
        plausible=lambda vehicle: 0.4,
        sentence="the vehicle is {size} of its mass heavier than stated",
        source="definition: scale factor of m, I_z and I_y",
        look_alikes=("torque_scale",),
        separated_by="a weighbridge, or braking and driving with known torque",
        change=_heavier,
    ),
)
