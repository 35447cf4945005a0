"""Uncertain masses of the vehicle, one row an effect."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from offroad_env.effects.protocol import Effect, Parameter, Setup
from offroad_env.errors import InvalidParameter

__all__ = ["TABLE"]

_row = partial(Effect, family="mass", hook="parameter")

#: Places of a load that a search tries: ahead of the centre of gravity, in wheelbases.
_PLACES = (-0.4, 0.0, 0.4)
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


def _loaded(setup: Setup, share: float, place: float) -> Setup:
    """A load at one point of the vehicle: the centre moves; inertias by the parallel axis theorem."""
    v = setup.plant.vehicle
    arm = place * (v.l_f + v.l_r)
    ahead = share / (1.0 + share) * arm
    more = v.m * share / (1.0 + share) * arm * arm
    return setup.with_vehicle(
        m=(1.0 + share) * v.m, I_z=v.I_z + more, I_y=v.I_y + more, l_f=v.l_f - ahead, l_r=v.l_r + ahead
    )


def _inflated(setup: Setup, share: float) -> Setup:
    """Tyres at another pressure; `find_effect` and its checks have seen that there are tyres."""
    structure = setup.plant.structure
    if structure is None or structure.tyre is None:
        raise InvalidParameter("tyre_pressure needs a vehicle on tyres, got rigid rims")
    tyre = structure.tyre._replace(inflation=(1.0 + share) * structure.tyre.inflation)
    return replace(setup, plant=setup.plant._replace(structure=structure._replace(tyre=tyre)))


def _turning(setup: Setup, share: float) -> Setup:
    v, factor = setup.plant.vehicle, 1.0 + share
    return setup.with_vehicle(I_z=factor * v.I_z, I_y=factor * v.I_y)


def _higher(setup: Setup, share: float) -> Setup:
    return setup.with_vehicle(h_cg=(1.0 + share) * setup.plant.vehicle.h_cg)


def _stiffer(setup: Setup, share: float) -> Setup:
    v, factor = setup.plant.vehicle, 1.0 + share
    return setup.with_vehicle(k_f=factor * v.k_f, k_r=factor * v.k_r)


TABLE = (
    _row(
        id="cg_height",
        size=Parameter(name="share", unit="-", low=-0.8, high=2.0),
        plausible=lambda vehicle: 0.4,
        sentence="the centre of gravity lies {size} of its height higher than stated",
        source="definition: scale factor of h_cg",
        look_alikes=("spring_rate",),
        separated_by="weighing the vehicle on a slope",
        change=_higher,
    ),
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
        id="inertia",
        size=Parameter(name="share", unit="-", low=-0.8, high=4.0),
        plausible=lambda vehicle: 0.5,
        sentence="the moments of inertia are {size} of their value larger",
        source="definition: scale factor of I_z and I_y",
        look_alikes=("payload", "steer_lag"),
        separated_by="swinging the vehicle on a bifilar suspension",
        change=_turning,
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
    _row(
        id="placed_payload",
        size=Parameter(name="share", unit="-", low=0.0, high=2.0),
        others=(Parameter(name="place", unit="-", low=-1.0, high=1.0),),
        places=lambda route: [{"place": place} for place in _PLACES],
        plausible=lambda vehicle: 0.4,
        sentence="a load of {size} of the mass lies at one place of the vehicle",
        source="definition: point mass along the wheelbase, inertias by the parallel axis theorem",
        look_alikes=("payload", "cg_shift"),
        separated_by="an axle scale",
        change=_loaded,
    ),
    _row(
        id="spring_rate",
        family="suspension",
        size=Parameter(name="share", unit="-", low=-0.8, high=4.0),
        plausible=lambda vehicle: 0.6,
        sentence="the springs are {size} of their rate stiffer",
        source="definition: scale factor of k_f and k_r",
        look_alikes=("cg_height", "damper_nonlinear"),
        separated_by="pressing down one axle with a known load",
        change=_stiffer,
    ),
    _row(
        id="tyre_pressure",
        family="suspension",
        size=Parameter(name="share", unit="-", low=-0.9, high=2.0),
        plausible=lambda vehicle: 0.4,
        sentence="the pressure of the tyres is {size} of its value larger",
        source="definition: scale factor of the inflation pressure",
        look_alikes=("spring_rate", "rolling_resistance"),
        separated_by="a pressure gauge",
        models=("full",),
        tyres_only=True,
        change=_inflated,
    ),
)
