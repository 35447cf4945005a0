"""Sizes of effects that physics allows: beyond them a fit may be good, but the name is wrong.

A fit is held within these ranges, and a size that ends at one of their ends is that of a stand-in for
something else: it is never named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from offroad_env.effects import EFFECTS, Setup
from offroad_env.physics.records import Soil, Vehicle

__all__ = ["NEVER_NEGATIVE", "at_end", "drive_range", "soil_ranges"]

#: Effects that are absent from the nominal model, so that less than none would be the opposite force: soil
#: never pulls a wheel along and bears no less the faster it is pressed, friction never drives, and no
#: actuator runs ahead. A steering that acts before it is logged is one whose stamps are late.
NEVER_NEGATIVE = (
    "bulldozing", "coulomb_friction", "front_bulldozing", "grouser_thrust", "placed_payload", "pose_delay",
    "rate_damping", "rut_drag", "slip_sinkage", "steer_lag",
)  # fmt: skip
#: Largest size, in largest believable ones: what is believed is a judgement, so a factor is left to it.
_MOST = 3.0
#: Angles of internal friction of soils [rad]: 3 to 50 degrees.
_PHI = (math.radians(3.0), math.radians(50.0))
#: Largest factor, and inverse of the least, of a modulus.
_FACTOR = 10.0
#: Share of a range next to an end that counts as this end.
_NEAR = 0.005
#: Yaw moment of inertia over m l_f l_r, the dynamic index: near 1 for measured cars and trucks (Heydinger et
#: al., SAE 1999-01-1336). How far a stated one may be off is a judgement, like the other ranges of vehicles.
_DYNAMIC_INDEX = (0.4, 2.0)
#: Natural frequency of a body on its springs [Hz] at a wheelbase of 2.5 m: cars have 1 to 1.5 (Wong, Theory
#: of Ground Vehicles, ch. 7). Those of small vehicles grow like one over the root of the size (Froude).
_BOUNCE, _FULL_SIZE = (0.7, 3.0), 2.5
#: Mass without what can be taken off, and with the largest load, as shares of the stated one.
_MASS = (0.6, 2.0)
#: The centre of gravity lies above the hubs of the wheels, and below so many radii.
_HIGHEST = 4.0
#: It moves by no more than this share of its distance from an axle.
_ALONG = 0.5


def soil_ranges(soil: Soil) -> dict[str, tuple[float, float]]:
    """Ranges of the sizes of effects that keep a parameter of the soil physical.

    Parameters
    ----------
    soil
        As stated.
    """
    return {
        # The pressure is largest between the bottom of a rolling wheel and its entry (Wong & Reece 1967).
        "peak_angle": (-soil.a_0, 0.9 - soil.a_0),
        # Soil leaves the wheel behind its bottom.
        "exit_angle": (-1.0 - soil.b_0, -soil.b_0),
        "friction_angle": (_PHI[0] - soil.phi, _PHI[1] - soil.phi),
        "shear_modulus": (1.0 / _FACTOR - 1.0, _FACTOR - 1.0),
        "soil_stiffness": (1.0 / _FACTOR - 1.0, _FACTOR - 1.0),
    }


def _inertia(v: Vehicle) -> tuple[float, float]:
    low, high = (index * v.m * v.l_f * v.l_r / v.I_z - 1.0 for index in _DYNAMIC_INDEX)
    return low, high


def _springs(v: Vehicle) -> tuple[float, float]:
    size = _FULL_SIZE / (v.l_f + v.l_r)
    low, high = ((2.0 * math.pi * f) ** 2 * size * v.m / (v.k_f + v.k_r) - 1.0 for f in _BOUNCE)
    return low, high


#: Effect -> its range for a vehicle as stated.
_OF_VEHICLE: Mapping[str, Callable[[Vehicle], tuple[float, float]]] = MappingProxyType(
    {
        "cg_height": lambda v: (v.r / v.h_cg - 1.0, _HIGHEST * v.r / v.h_cg - 1.0),
        "inertia": _inertia,
        "payload": lambda v: (_MASS[0] - 1.0, _MASS[1] - 1.0),
        "spring_rate": _springs,
        "cg_shift": lambda v: (-_ALONG * v.l_f, _ALONG * v.l_r),
    }
)


def drive_range(effect: str, setup: Setup) -> tuple[float, float]:
    """Smallest and largest size of an effect that a vehicle on its soil can have; it holds the off-value.

    Parameters
    ----------
    effect
        Its id.
    setup
        Vehicle and soil as stated.
    """
    size, vehicle, soil = EFFECTS[effect].size, setup.plant.vehicle, setup.plant.soil
    reach = _MOST * EFFECTS[effect].plausible(vehicle)
    low, high = -reach, reach
    if effect in NEVER_NEGATIVE:
        low = size.off
    elif effect in _OF_VEHICLE:
        low, high = _OF_VEHICLE[effect](vehicle)
    elif soil.rigid < 0.5:
        own = soil_ranges(soil) | {"cohesion": (-soil.c, reach)}
        low, high = own.get(effect, (low, high))
    low, high = max(low, size.low), min(high, size.high)
    # A description may itself be unusual: as stated is always possible.
    return min(low, size.off), max(high, size.off)


#: Effects whose least size is a state that exists: sand has no cohesion.
_CLOSED_BELOW = ("cohesion",)


def at_end(effect: str, size: float, limits: tuple[float, float]) -> bool:
    """Whether a size is at an end of its physical range, or beyond it: nothing that may be named."""
    low, high = limits
    near = _NEAR * (high - low)
    if effect in _CLOSED_BELOW:
        below = size < low
    elif low == EFFECTS[effect].size.off:
        below = size <= low
    else:
        below = size <= low + near
    return below or size >= high - near
