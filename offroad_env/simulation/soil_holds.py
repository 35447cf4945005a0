"""What the soil holds: the limits of one vehicle on one soil, at static loads on flat ground.

A driver and a planner need these, and a drive can determine them where it does not determine
the soil's parameters one by one. All numbers come from the contact that the vehicle models themselves solve
(`offroad_env.physics.axle.borne_contact`), so structure, tyre, ruts and extensions of a plant count.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import (
    AxleStance,
    Plant,
    borne_contact,
    contact_columns,
    static_loads,
)
from offroad_env.physics.contact import SUNK, Support, slope_frame
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray, FourWheel, Soil, WheelMotion
from offroad_env.physics.rolling import come_straight
from offroad_env.physics.ruts import Place, follow_rut
from offroad_env.world.argument_checks import one_number, require_record

__all__ = [
    "HIGHEST_SLIP",
    "HIGHEST_SLIP_ANGLE",
    "REFERENCE_SPEED",
    "SoilHolds",
    "limits_at",
    "soils_hold",
    "what_soil_holds",
]

#: Speed of travel [m/s]; the stop begins with it.
REFERENCE_SPEED = 5.0
#: Largest slip, driven or braked [-], and largest slip angle [rad] that count.
HIGHEST_SLIP, HIGHEST_SLIP_ANGLE = 0.5, math.radians(15.0)

#: Steps to the highest slip and slip angle, and of the golden section between two of the former.
_SLIPS, _ANGLES, _SECTIONS, _GOLDEN = 8, 4, 7, 0.6180339887498949
#: Slips between which free rolling is sought, and rounds of regula falsi.
_ROLLING_SLIP, _ROUNDS = 0.6, 30


class SoilHolds(NamedTuple):
    """Limits of a vehicle on a soil. All are NaN where the soil does not carry the rolling vehicle.

    Static axle loads, level ground, wheels upright, no drag of air and bearings, no limit of engine or
    brakes. Slip is (r omega - v) / max(r omega, v) with the unloaded radius r.
    """

    #: Largest steady lateral acceleration [m/s^2] within 15 degrees of slip angle. Each axle takes the slip
    #: angle at which it holds most while its force along the travel is zero (or, where no slip up to 0.5 does
    #: that, largest); the weaker axle counts. Both axles are on soil that no wheel has pressed before.
    lateral: float
    #: Largest pull [N]: the force along the travel of all wheels at one slip from 0 to 0.5. An axle that is
    #: not driven rolls freely. The rear wheels follow the front ones.
    pull: float
    #: Slip of the largest pull [-]
    pull_slip: float
    #: Rolling resistance [N]: the force that tows the vehicle straight on, no torque on its wheels.
    resistance: float
    #: Sinkage [m] below the undisturbed surface of the wheels that run deepest, towed like that.
    sinkage: float
    #: Stopping distance [m] from 5 m/s at the largest deceleration of all braked wheels at one slip of
    #: 0 to -0.5. An axle without brakes rolls freely.
    stopping: float

    @property
    def carried(self) -> bool:
        """Whether the soil carries the rolling vehicle."""
        return not math.isnan(self.sinkage)


class _Bracket(NamedTuple):
    """Two places between which a function changes its sign."""

    low: float
    f_low: float  #: not positive, halved where the other end has moved twice
    high: float
    f_high: float
    side: float  #: which end moved last: 1 high, -1 low, 0 none


@inline_kernel
def _narrowed(b: _Bracket, x: float, f: float) -> _Bracket:
    """The bracket with ``f`` at ``x`` for one end (regula falsi, Illinois)."""
    up = f > 0.0
    return _Bracket(
        b.low if up else x,
        (b.f_low * 0.5 if b.side > 0.0 else b.f_low) if up else f,
        x if up else b.high,
        f if up else (b.f_high * 0.5 if b.side < 0.0 else b.f_high),
        1.0 if up else -1.0,
    )


@inline_kernel
def _secant(b: _Bracket) -> float:
    """Where the straight line between the ends crosses zero."""
    return (b.low * b.f_high - b.high * b.f_low) / (b.f_high - b.f_low)


class _Turning(NamedTuple):
    """How the vehicle turns the wheels of an axle."""

    driven: float  #: 1.0 = they take the slip that is asked for, 0.0 = they roll freely
    slip: float  #: of free rolling [-]


class _AxleForces(NamedTuple):
    """What level ground does to an axle, in its wheels' axes."""

    status: float  #: of the contact
    F_l: float  #: along the wheels [N]
    F_c: float  #: across them, to the left [N]
    torque: float  #: against their rotation [N m]
    sinkage: float  #: [m]


@inline_kernel
def _motion(slip: float, slip_angle: float) -> WheelMotion:
    """A wheel at the reference speed."""
    along, across = REFERENCE_SPEED * math.cos(slip_angle), REFERENCE_SPEED * math.sin(slip_angle)
    rim = along / (1.0 - slip) if slip > 0.0 else along * (1.0 + slip)
    return WheelMotion(rim, along, across)


@kernel
def _axle_forces(
    plant: Plant, place: tuple[float, float], axle: int, motion: WheelMotion, warm: FloatArray
) -> _AxleForces:
    """What level ground does to an axle under its static load; ``warm`` is its row of the contact state."""
    v, seen = plant.vehicle, np.empty(at.AXLE)
    load = static_loads(v)[axle]
    stance = AxleStance(place[0], place[1], 0.0, 0.0, 0.0, v.l_f if axle == 0 else -v.l_r)
    support, frame = Support(load, 0.0, v.wheels_per_axle), slope_frame(0.0, 0.0)
    found = borne_contact(plant, motion, stance, support, frame, warm, seen)
    if found.status >= SUNK:
        # The next search does not start where this one got lost.
        warm[: at.CONTACT_SIZE] = 0.0
    return _AxleForces(found.status, found.F_l, found.F_c, found.torque, seen[at.SINKAGE])


@inline_kernel
def _aside(four: FourWheel | None) -> float:
    """How far beside the front wheels the rear ones run [m]."""
    if four is None:
        return 0.0
    return 0.5 * (four.track_f - four.track_r)


@kernel
def _enter_rut(plant: Plant, sinkage: float, warm: FloatArray) -> None:
    """Let the rear wheels stand in what the front ones have left, coming straight."""
    v, structure, aside = plant.vehicle, plant.structure, _aside(plant.four_wheel)
    come_straight(structure, warm[0], Place(0.0, 0.0, (0.0, 1.0)), sinkage, v.l_f + v.l_r)
    follow_rut(structure, warm[0], warm[1], v.b, -(v.l_f + v.l_r), aside)


@kernel
def _free_slip(plant: Plant, place: tuple[float, float], axle: int, warm: FloatArray) -> float:
    """Slip at which an axle rolls without torque (regula falsi, Illinois); NaN where it is not carried."""
    bracket = _Bracket(-_ROLLING_SLIP, math.nan, _ROLLING_SLIP, math.nan, 0.0)
    # From rolling without slip on: a wheel that spins or is braked may sink where a rolling one is carried.
    slip, tolerance = 0.0, 1e-9 * static_loads(plant.vehicle)[axle] * plant.vehicle.r
    step = 0.02
    for _ in range(_ROUNDS):
        found = _axle_forces(plant, place, axle, _motion(slip, 0.0), warm)
        T = found.torque
        if found.status >= SUNK:
            return math.nan
        if abs(T) <= tolerance:
            break
        bracket = _narrowed(bracket, slip, T)
        if math.isnan(bracket.f_low) or math.isnan(bracket.f_high):
            slip = min(max(slip - bracket.side * step, -_ROLLING_SLIP), _ROLLING_SLIP)
            step *= 2.0
        else:
            slip = _secant(bracket)
    return slip


@kernel
def _force_along(
    plant: Plant, place: tuple[float, float], slip: float, axles: tuple[_Turning, _Turning], warm: FloatArray
) -> float:
    """Force on the whole vehicle along straight travel [N] at a slip; NaN where a wheel is not carried."""
    total = 0.0
    for axle in range(2):
        own = axles[axle]
        taken = slip if own.driven > 0.5 else own.slip
        found = _axle_forces(plant, place, axle, _motion(taken, 0.0), warm[axle])
        if found.status >= SUNK:
            return math.nan
        total += found.F_l
        if axle == 0:
            _enter_rut(plant, found.sinkage, warm)
    return total


@kernel
def _largest_force(
    plant: Plant, place: tuple[float, float], way: float, axles: tuple[_Turning, _Turning], warm: FloatArray
) -> tuple[float, float]:
    """(force [N], slip) where ``way`` times the force along travel is largest, up to the highest slip.

    Slips at which wheels spin into the ground do not count.
    """
    step = HIGHEST_SLIP / _SLIPS
    best, best_slip = -math.inf, 0.0
    for i in range(_SLIPS + 1):
        force = way * _force_along(plant, place, way * i * step, axles, warm)
        if math.isnan(force):
            break
        if force > best:
            best, best_slip = force, i * step
    low, high = max(best_slip - step, 0.0), min(best_slip + step, HIGHEST_SLIP)
    for _ in range(_SECTIONS):
        first, second = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_first = way * _force_along(plant, place, way * first, axles, warm)
        at_second = way * _force_along(plant, place, way * second, axles, warm)
        if at_first > best:
            best, best_slip = at_first, first
        if at_second > best:
            best, best_slip = at_second, second
        # Not a number counts as less.
        if at_second > at_first:
            low = first
        else:
            high = second
    return best, best_slip


@kernel
def _held_across(
    plant: Plant, place: tuple[float, float], axle: int, slip_angle: float, warm: FloatArray
) -> float:
    """Force across the travel [N] of an axle at a slip angle, none along it, toward the bend's centre.

    Not a number where the wheels are not carried.
    """
    sin, cos = math.sin(slip_angle), math.cos(slip_angle)
    low, along_low, most, across = 0.0, math.nan, -math.inf, math.nan
    high, along_high = math.nan, math.nan
    for i in range(_SLIPS + 1):
        slip = HIGHEST_SLIP * (i / _SLIPS) ** 2
        found = _axle_forces(plant, place, axle, _motion(slip, slip_angle), warm)
        if found.status >= SUNK:
            return across
        along = found.F_l * cos + found.F_c * sin
        if along > most:
            most, across = along, found.F_l * sin - found.F_c * cos
        if along >= 0.0:
            high, along_high = slip, along
            break
        low, along_low = slip, along
    if math.isnan(along_high) or math.isnan(along_low):
        return across
    bracket, tolerance = (
        _Bracket(low, along_low, high, along_high, 0.0),
        1e-6 * static_loads(plant.vehicle)[axle],
    )
    for _ in range(_ROUNDS):
        slip = _secant(bracket)
        found = _axle_forces(plant, place, axle, _motion(slip, slip_angle), warm)
        if found.status >= SUNK:
            break
        along = found.F_l * cos + found.F_c * sin
        across = found.F_l * sin - found.F_c * cos
        if abs(along) <= tolerance:
            break
        bracket = _narrowed(bracket, slip, along)
    return across


@kernel
def _lateral(plant: Plant, place: tuple[float, float]) -> float:
    """Largest lateral acceleration [m/s^2]."""
    weaker, loads = math.inf, static_loads(plant.vehicle)
    for axle in range(2):
        warm, held = np.zeros(contact_columns(plant.structure)), -math.inf
        for i in range(_ANGLES):
            across = _held_across(plant, place, axle, HIGHEST_SLIP_ANGLE * (i + 1) / _ANGLES, warm)
            if across > held:
                held = across
        weaker = min(weaker, GRAVITY * held / loads[axle])
    return weaker if weaker > -math.inf else math.nan


@inline_kernel
def _turned(share: float, slip: float) -> _Turning:
    """An axle that has this share of all torque."""
    return _Turning(1.0 if share > 0.0 else 0.0, slip)


@kernel
def limits_at(plant: Plant, place: tuple[float, float]) -> SoilHolds:
    """`what_soil_holds` as a kernel, on the soil at ``place`` = (X, Y) [m]."""
    v, warm = plant.vehicle, np.zeros((2, contact_columns(plant.structure)))
    rolling, sinkage, slips = 0.0, 0.0, np.empty(2)
    for axle in range(2):
        slips[axle] = _free_slip(plant, place, axle, warm[axle])
        if math.isnan(slips[axle]):
            nan = math.nan
            return SoilHolds(nan, nan, nan, nan, nan, nan)
        found = _axle_forces(plant, place, axle, _motion(slips[axle], 0.0), warm[axle])
        rolling, sinkage = rolling - found.F_l, max(sinkage, found.sinkage)
        if axle == 0:
            _enter_rut(plant, found.sinkage, warm)
    driven = _turned(v.drive_front, slips[0]), _turned(1.0 - v.drive_front, slips[1])
    pull, pull_slip = _largest_force(plant, place, 1.0, driven, warm)
    braked = _turned(v.brake_front, slips[0]), _turned(1.0 - v.brake_front, slips[1])
    braking = _largest_force(plant, place, -1.0, braked, warm)[0]
    stopping = 0.5 * v.m * REFERENCE_SPEED * REFERENCE_SPEED / braking if braking > 0.0 else math.inf
    return SoilHolds(_lateral(plant, place), pull, pull_slip, rolling, sinkage, stopping)


def what_soil_holds(plant: Plant, *, x: float = 0.0, y: float = 0.0) -> SoilHolds:
    """What the soil of a plant holds for its vehicle, at static loads on flat ground.

    Parameters
    ----------
    plant : Plant
        Vehicle, soil, structure and tyres, from `make_plant`, of any model. Its ground does not count.
    x, y : float
        Place whose soil is meant [m], where the plant's soil varies.

    Returns
    -------
    SoilHolds
        NaN throughout where the soil does not carry the rolling vehicle.

    Raises
    ------
    InvalidParameter
        For anything but a plant and two finite numbers.
    """
    require_record("plant", plant, Plant, "make_plant")
    return SoilHolds(*limits_at(plant, (one_number("x", x), one_number("y", y))))


def soils_hold(plant: Plant, soils: Iterable[Soil]) -> np.ndarray:
    """(S, 6) what each of ``soils`` would hold for the vehicle of a plant, in the order of `SoilHolds`.

    Such as the samples of a belief; the plant's own soil, its map and its field do not count.
    """
    bare = plant._replace(soil_field=None, soil_map=plant.soil_map._replace(patches=np.empty((0, 4))))
    return np.array([limits_at(bare._replace(soil=soil), (0.0, 0.0)) for soil in soils]).reshape(-1, 6)
