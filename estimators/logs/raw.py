"""Columns of a log from what a file has in their place: axes, quaternions, single wheels, fixes."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from estimators.logs.schema import RAW_COLUMNS
from estimators.logs.signals import roll_back
from estimators.logs.tables import Table
from offroad_env.physics.records import Vehicle

__all__ = ["SIDES", "SPLIT", "derived"]

#: What is said where the torques of the axles are none that were measured.
SPLIT = "torque_f and torque_r are shares of torque_total, by drive_front, and by brake_front where it brakes"
#: Of a vehicle whose wheels are not steered.
SIDES = (
    "steer is not measured: it is the angle at which a vehicle with this wheelbase turns as the speeds of "
    "left and right wheels differ, without slip. Skid steering slips, so lateral results are not to be judged"
)

#: Ellipsoid WGS 84: equatorial radius [m], square of the eccentricity.
_EARTH, _ECCENTRICITY = 6378137.0, 6.69437999014e-3
#: Largest angle that stands for a difference between the sides [rad], and speed below which it is none [m/s].
_STEEPEST, _SLOWEST = 0.8, 0.2
#: A fix further from the others is none of this drive [rad].
_FAR = math.radians(1.0)

_RATES = {"gyro_x": ("roll_rate", 1.0), "gyro_y": ("pitch_rate", -1.0), "gyro_z": ("yaw_rate", 1.0)}
_QUATERNION = ("q_w", "q_x", "q_y", "q_z")
_AXLES = (("f", ("fl", "fr")), ("r", ("rl", "rr")))


def derived(
    table: Table, t: np.ndarray, channels: dict[str, np.ndarray], vehicle: Vehicle | None
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The channels with those of a log in place of raw ones, and sentences about what was taken for what.

    Raises
    ------
    DataError
        Where parts are missing, or a channel has two sources.
    """
    made: dict[str, np.ndarray] = {}
    notes: list[str] = []
    for name, (target, sign) in _RATES.items():
        if name in channels:
            made[target] = sign * channels[name]
    made |= _attitude(table, channels)
    made |= _place(table, channels, notes)
    made |= _axles(table, t, channels)
    if vehicle is not None and "torque_total" in channels:
        total = channels["torque_total"]
        brakes = np.where(_rolls_back(t, channels | made), -total, total) < 0.0
        front = np.where(brakes, vehicle.brake_front, vehicle.drive_front)
        made |= {"torque_f": front * total, "torque_r": (1.0 - front) * total}
        notes.append(SPLIT)
    if vehicle is not None and "omega_left" in channels and "steer" not in channels:
        made["steer"] = _steering(t, channels, vehicle)
        notes.append(SIDES)
    result = {name: values for name, values in channels.items() if name not in RAW_COLUMNS}
    for name, values in made.items():
        if name in result and name not in ("yaw", "pitch", "roll"):
            raise table.error(f"two sources of {name}: itself, and {_source_of(name, channels)}", column=name)
        result.setdefault(name, values)
    return result, tuple(notes)


def _source_of(name: str, channels: Iterable[str]) -> str:
    return ", ".join(raw for raw in channels if raw in RAW_COLUMNS and raw[0] == name[0]) or "raw columns"


def _complete(table: Table, channels: dict[str, np.ndarray], names: Iterable[str]) -> list[np.ndarray] | None:
    """The named channels, or None where none of them is there."""
    names = tuple(names)
    present = [name for name in names if name in channels]
    if not present:
        return None
    missing = [name for name in names if name not in channels]
    if missing:
        raise table.error(
            f"needs {', '.join(names)} together; {', '.join(missing)} missing", column=present[0]
        )
    return [channels[name] for name in names]


def _attitude(table: Table, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Yaw, pitch (nose up) and roll (right side down) [rad] of a quaternion."""
    parts = _complete(table, channels, _QUATERNION)
    if parts is None:
        return {}
    rows = np.stack(parts)
    with np.errstate(invalid="ignore", divide="ignore"):
        rows = rows / np.sqrt((rows**2).sum(axis=0))
    w, x, y, z = np.where(np.isfinite(rows).all(axis=0), rows, math.nan)
    return {
        "yaw": np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        "pitch": -np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        "roll": np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
    }


def _rolls_back(t: np.ndarray, channels: dict[str, np.ndarray]) -> np.ndarray:
    """Rows in which all wheels turn backwards, where a negative torque drives."""
    rims = [channels[name] for name in ("omega_f", "omega_r") if name in channels]
    return roll_back(t, ((t[np.isfinite(rim)], rim[np.isfinite(rim)]) for rim in rims))


def _place(table: Table, channels: dict[str, np.ndarray], notes: list[str]) -> dict[str, np.ndarray]:
    """East and north of the first fix [m], on the plane that touches the ellipsoid there.

    A receiver without a fix writes 0, 0, and its first fixes may lie anywhere: no drive began there.
    """
    fixes = _complete(table, channels, ("latitude", "longitude"))
    if fixes is None:
        return {}
    latitude, longitude = (np.radians(values) for values in fixes)
    nowhere = (latitude == 0.0) & (longitude == 0.0)
    if nowhere.any():
        notes.append(
            f"latitude and longitude are 0, 0 in {int(nowhere.sum())} rows: no fix, taken as missing"
        )
        latitude, longitude = (np.where(nowhere, math.nan, values) for values in (latitude, longitude))
    both = np.isfinite(latitude) & np.isfinite(longitude)
    if not both.any():
        return {}
    first = int(np.argmax(both & _together(latitude, longitude, both)))
    sine = math.sin(latitude[first])
    root = math.sqrt(1.0 - _ECCENTRICITY * sine**2)
    east, north = _EARTH / root, _EARTH * (1.0 - _ECCENTRICITY) / root**3
    turn = np.remainder(longitude - longitude[first] + math.pi, 2.0 * math.pi) - math.pi
    return {
        "x": east * math.cos(latitude[first]) * turn,
        "y": north * (latitude - latitude[first]),
    }


def _together(latitude: np.ndarray, longitude: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Which fixes lie where most do; longitudes of 180 and -180 degrees are one."""
    middle = math.atan2(*(float(np.median(of(longitude[known]))) for of in (np.sin, np.cos)))
    far = np.abs(np.remainder(longitude - middle + math.pi, 2.0 * math.pi) - math.pi)
    near = (far < _FAR) & (np.abs(latitude - np.median(latitude[known])) < _FAR)
    return near if near.any() else known


def _axles(table: Table, t: np.ndarray, channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Wheel speeds and torques of the axles from those of wheels, sides or all wheels."""
    made = {}
    for axle, wheels in _AXLES:
        speeds = _complete(table, channels, [f"omega_{wheel}" for wheel in wheels])
        torques = _complete(table, channels, [f"torque_{wheel}" for wheel in wheels])
        if speeds is not None:
            made[f"omega_{axle}"] = _sum(t, speeds) / 2.0
        if torques is not None:
            made[f"torque_{axle}"] = _sum(t, torques)
    sides = _complete(table, channels, ("omega_left", "omega_right"))
    for values in (channels.get("omega"), None if sides is None else _sum(t, sides) / 2.0):
        for axle, _ in _AXLES:
            if values is not None and f"omega_{axle}" not in channels:
                made.setdefault(f"omega_{axle}", values.copy())
    return made


def _sum(t: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """Sum of channels, in rows where one has a sample; the others straight between theirs."""
    present = np.any([~np.isnan(part) for part in parts], axis=0)
    total = np.where(present, 0.0, math.nan)
    for part in parts:
        own = ~np.isnan(part)
        total += part if own[present].all() else np.interp(t, t[own], part[own]) if own.any() else math.nan
    return total


def _steering(t: np.ndarray, channels: dict[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Front-wheel angle of a vehicle that turns as its sides differ, without slip [rad]."""
    left, right = channels["omega_left"], channels["omega_right"]
    speed = 0.5 * vehicle.r * _sum(t, [left, right])
    turn = vehicle.r * _sum(t, [right, -left]) / vehicle.track
    moving = np.abs(speed) > _SLOWEST
    curvature = np.where(moving, turn / np.where(moving, speed, 1.0), 0.0)
    angle = np.arctan((vehicle.l_f + vehicle.l_r) * curvature)
    return np.asarray(np.where(np.isnan(speed), math.nan, np.clip(angle, -_STEEPEST, _STEEPEST)))
