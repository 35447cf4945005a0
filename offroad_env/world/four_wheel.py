"""Vehicles with four wheels: the validating factory `make_four_wheel`, with a rule for what is not given."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypedDict, Unpack, cast

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import FourWheel, Vehicle
from offroad_env.world.catalogue import Quantity, given_fields

__all__ = ["FOUR_WHEEL_FIELDS", "FourWheelFields", "make_four_wheel", "stated_fields"]

_MILLIMETRES = "mm given as m"
_DEGREES = "degrees"
#: Travel where a vehicle has no stops [m].
_FREE = 1e3


def _between(low: float, high: float, unit: str, *mistakes: tuple[float, float, str]) -> Quantity:
    return Quantity(f"in [{low:g}, {high:g}] {unit}".strip(), low, high, mistakes=mistakes)


_TRACK = _between(0.01, 10.0, "m", (10.0000001, 2e4, _MILLIMETRES))
_CENTRE = _between(-2.0, 2.0, "m", (2.0000001, 2e3, _MILLIMETRES))
_ROLL_STIFFNESS = _between(1e-3, 1e8, "N m/rad")
_ANTI_ROLL = _between(0.0, 1e8, "N m/rad")
_TRAVEL = _between(1e-3, _FREE, "m")
_TOE = _between(-0.2, 0.2, "rad", (0.2000001, 20.0, _DEGREES))
_FLAG = _between(0.0, 1.0, "")

#: Every field that may be given, with its allowed range.
FOUR_WHEEL_FIELDS = MappingProxyType(
    {
        "I_x": _between(1e-6, 1e7, "kg m^2"),
        "track_f": _TRACK,
        "track_r": _TRACK,
        "roll_centre_f": _CENTRE,
        "roll_centre_r": _CENTRE,
        "roll_stiffness_f": _ROLL_STIFFNESS,
        "roll_stiffness_r": _ROLL_STIFFNESS,
        "anti_roll_f": _ANTI_ROLL,
        "anti_roll_r": _ANTI_ROLL,
        "bump_f": _TRAVEL,
        "bump_r": _TRAVEL,
        "droop_f": _TRAVEL,
        "droop_r": _TRAVEL,
        "toe_f": _TOE,
        "toe_r": _TOE,
        "ackermann": _between(-1.0, 2.0, ""),
        "rear_steer": _between(-1.0, 1.0, ""),
        "skid": _FLAG,
        "lock_f": _FLAG,
        "lock_r": _FLAG,
        "lock_c": _FLAG,
        "servo": _between(0.0, 1e6, "N m s/rad"),
    }
)

#: What a field is where it is not given. Tracks come first: other rules use them.
_RULES: Mapping[str, Callable[[Vehicle, Mapping[str, float]], float]] = MappingProxyType(
    {
        "track_f": lambda v, _: v.track,
        "track_r": lambda v, _: v.track,
        "I_x": lambda v, _: v.m * v.track**2 / 6.0,
        "roll_centre_f": lambda v, _: 0.0,
        "roll_centre_r": lambda v, _: 0.0,
        "roll_stiffness_f": lambda v, f: 0.25 * v.k_f * f["track_f"] ** 2,
        "roll_stiffness_r": lambda v, f: 0.25 * v.k_r * f["track_r"] ** 2,
        "anti_roll_f": lambda v, _: 0.0,
        "anti_roll_r": lambda v, _: 0.0,
        "bump_f": lambda v, _: _FREE,
        "bump_r": lambda v, _: _FREE,
        "droop_f": lambda v, _: _FREE,
        "droop_r": lambda v, _: _FREE,
        "toe_f": lambda v, _: 0.0,
        "toe_r": lambda v, _: 0.0,
        "ackermann": lambda v, _: 1.0,
        "rear_steer": lambda v, _: 0.0,
        "skid": lambda v, _: 0.0,
        "lock_f": lambda v, _: 0.0,
        "lock_r": lambda v, _: 0.0,
        "lock_c": lambda v, _: 0.0,
        "servo": lambda v, _: 0.0,
    }
)


class FourWheelFields(TypedDict, total=False):
    """Fields as `make_four_wheel` takes them; their meaning stands there."""

    I_x: float | None
    track_f: float | None
    track_r: float | None
    roll_centre_f: float | None
    roll_centre_r: float | None
    roll_stiffness_f: float | None
    roll_stiffness_r: float | None
    anti_roll_f: float | None
    anti_roll_r: float | None
    bump_f: float | None
    bump_r: float | None
    droop_f: float | None
    droop_r: float | None
    toe_f: float | None
    toe_r: float | None
    ackermann: float | None
    rear_steer: float | None
    skid: float | None
    lock_f: float | None
    lock_r: float | None
    lock_c: float | None
    servo: float | None


def make_four_wheel(vehicle: Vehicle, **fields: Unpack[FourWheelFields]) -> FourWheel:
    """Make the validated record of what a vehicle with four wheels has beyond a `Vehicle`.

    Parameters
    ----------
    vehicle
        The vehicle, with two wheels an axle.
    I_x
        Roll moment of inertia of the whole vehicle [kg m^2]. Default: m track^2/6, that of a uniform body
        with a square cross-section as wide as the track (radius of gyration 0.41 of it).
    track_f, track_r
        Distance between the wheels of an axle [m]. Default: the vehicle's track.
    roll_centre_f, roll_centre_r
        Height of the kinematic roll centres above the contact points [m]. Default: 0, that of trailing arms
        and of parallel wishbones of equal length (T. D. Gillespie, Fundamentals of Vehicle Dynamics, ch. 7).
    roll_stiffness_f, roll_stiffness_r
        Of the body against the wheels, without anti-roll bars, on an axle [N m/rad]. Default: springs at the
        wheels, k track^2/4; less where springs sit further inside, as on a rigid axle.
    anti_roll_f, anti_roll_r
        Roll stiffness of an axle's anti-roll bar [N m/rad]. Default: 0, none.
    bump_f, bump_r, droop_f, droop_r
        Travel from static equilibrium to the stops, up and down [m]. Default: no stops.
    toe_f, toe_r
        Toe-in of each wheel [rad]. Default: 0.
    ackermann
        1 = the wheels' axes meet in the centre of the turn, 0 = wheels of an axle are parallel. Default: 1,
        what steering of vehicles that turn tightly at low speed is made for (R. N. Jazar, Vehicle Dynamics,
        ch. 7).
    rear_steer
        Angle of the rear wheels per angle of the front wheels; negative: against them. Default: 0.
    skid
        1 = no wheel is steered, torques left and right turn the vehicle. Default: 0.
    lock_f, lock_r, lock_c
        1 = a locked differential on the front axle, the rear axle, between the axles; 0 = open, each wheel
        has half of its axle's torque. Default: 0.
    servo
        Torque per error of a wheel's speed where commands give the wheels' speeds [N m s/rad]. Default: 0,
        commands give torques.

    Returns
    -------
    FourWheel
        Record of floats that the kernels trust.

    Raises
    ------
    InvalidParameter
        With name, value, allowed range and likely mistake.
    TypeError
        For a field that it does not have.
    """
    if vehicle.wheels_per_axle != 2.0:
        raise InvalidParameter(
            f"a vehicle with four wheels needs wheels_per_axle 2, got {vehicle.wheels_per_axle:g}"
        )
    given = given_fields("make_four_wheel", cast("Mapping[str, float | None]", fields), FOUR_WHEEL_FIELDS)
    values = {name: FOUR_WHEEL_FIELDS[name].check(name, value) for name, value in given.items()}
    return _completed(vehicle, values)


def _completed(vehicle: Vehicle, values: dict[str, float]) -> FourWheel:
    """The record with the rules' values for what is not given."""
    for name, rule in _RULES.items():
        if name not in values:
            values[name] = rule(vehicle, values)
    _check_size(vehicle, values)
    for axle, k in (("f", vehicle.k_f), ("r", vehicle.k_r)):
        # The springs at the wheels have this of it; the rest acts between left and right.
        values[f"anti_roll_{axle}"] += (
            values.pop(f"roll_stiffness_{axle}") - 0.25 * k * values[f"track_{axle}"] ** 2
        )
    return FourWheel(**values)


def stated_fields(record: FourWheel, vehicle: Vehicle, default: FourWheel) -> FourWheelFields:
    """The fields from which `make_four_wheel` makes a record; those that ``default`` has too are left out."""
    fields = {name: value for name, value in record._asdict().items() if value != getattr(default, name)}
    for axle, k in (("f", vehicle.k_f), ("r", vehicle.k_r)):
        track, bar = getattr(record, f"track_{axle}"), getattr(record, f"anti_roll_{axle}")
        if bar < 0.0:
            fields[f"anti_roll_{axle}"] = 0.0
            fields[f"roll_stiffness_{axle}"] = 0.25 * k * track**2 + bar
    return cast("FourWheelFields", fields)


def _check_size(vehicle: Vehicle, values: Mapping[str, float]) -> None:
    gyration = math.sqrt(values["I_x"] / vehicle.m) / max(values["track_f"], values["track_r"])
    if not 0.1 <= gyration <= 1.5:
        raise InvalidParameter(
            f"radius of gyration in roll over the track must be in [0.1, 1.5], got {gyration:.3g} from "
            f"I_x={values['I_x']:g}, m={vehicle.m:g} - a wrong unit or power of ten in one of them?"
        )
