"""What stands in for channels of the IMU that a log does not have, where a filter needs all of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimators.logs.log import Log
from estimators.logs.schema import IMU
from estimators.logs.signals import roll_back, unwrapped
from offroad_env.errors import DataError
from offroad_env.physics.numerics import GRAVITY

__all__ = ["substituted"]

#: Time over which a difference quotient of a speed or heading is taken [s].
_OVER = 0.5


def substituted(log: Log) -> tuple[Log, tuple[str, ...]]:
    """The log with all channels of the IMU, and a sentence for each that was not measured.

    Raises
    ------
    DataError
        If a channel is missing that no other can stand in for.
    """
    missing = [name for name in IMU if name not in log.channels]
    if not missing:
        return log, ()
    sensed = [log.channels[name] for name in IMU if name in log.channels]
    rows = np.all([~np.isnan(values) for values in sensed], axis=0)
    t = log.times[rows]
    channels, notes = dict(log.channels), []
    for name in sorted(missing, key=_ORDER.index):
        values, how = _substitute(log, channels, name, t)
        column = np.full(len(rows), math.nan)
        column[rows] = values
        column.flags.writeable = False
        channels[name] = column
        notes.append(f"{name} is not measured: {how}")
    return replace(log, channels=channels), tuple(notes)


#: The rate before the acceleration that follows from it.
_ORDER = ("pitch_rate", "a_z", "yaw_rate", "a_y", "a_x")


def _substitute(
    log: Log, channels: dict[str, np.ndarray], name: str, t: np.ndarray
) -> tuple[np.ndarray, str]:
    """(values at the times ``t``, where they are from)."""
    if name == "pitch_rate":
        return np.zeros(len(t)), "taken as 0, so pitching is not judged"
    if name == "a_z":
        rest = 0.0 if log.imu.kinematic else GRAVITY
        return np.full(len(t), rest), "taken as at rest, so the axles carry their static load"
    if name == "yaw_rate":
        return _yaw_rate(log, t)
    speed = _speed(log, t)
    if speed is None:
        raise DataError(f"{log.name}: has no {name}, and no speed from which it would follow")
    if name == "a_y":
        rate = np.interp(t, log.times[~np.isnan(channels["yaw_rate"])], _present(channels["yaw_rate"]))
        return np.asarray(speed * rate), "taken as speed x yaw_rate, so side slip is not judged"
    return _slope(t, speed, t), f"taken as the change of speed over {_OVER:g} s"


def _present(values: np.ndarray) -> np.ndarray:
    return np.asarray(values[~np.isnan(values)])


def _speed(log: Log, t: np.ndarray) -> np.ndarray | None:
    """Forward speed by the first channel that has it [m/s]."""
    for name in ("v_x", "speed", "omega_r", "omega_f"):
        if name in log.channels:
            scale = log.vehicle.r if name.startswith("omega") else 1.0
            values = np.asarray(scale * np.interp(t, *log.samples(name)))
            return _with_direction(log, t, values) if name == "speed" else values
    return None


def _with_direction(log: Log, t: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """A speed over ground [m/s], below zero where all wheels turn backwards: a receiver's has no sign."""
    if (speed < -0.5).any():
        return speed
    back = roll_back(t, (log.samples(name) for name in ("omega_f", "omega_r") if name in log.channels))
    return np.where(back, -speed, speed)


def _yaw_rate(log: Log, t: np.ndarray) -> tuple[np.ndarray, str]:
    if "yaw" in log.channels:
        times, yaw = log.samples("yaw")
        return _slope(times, unwrapped(yaw), t), f"taken as the change of yaw over {_OVER:g} s"
    speed = _speed(log, t)
    if speed is None:
        raise DataError(f"{log.name}: has no yaw_rate, and neither yaw nor speed from which it would follow")
    vehicle = log.vehicle
    steer = np.interp(t, *log.samples("steer"))
    return (
        np.asarray(speed * np.tan(steer) / (vehicle.l_f + vehicle.l_r)),
        "taken as speed x tan(steer) / wheelbase, so steering and side slip are not judged",
    )


def _slope(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Difference quotient over `_OVER`, inside the times that there are."""
    low, high = (np.clip(at + side * _OVER, times[0], times[-1]) for side in (-0.5, 0.5))
    rise = np.interp(high, times, values) - np.interp(low, times, values)
    return np.asarray(rise / np.maximum(high - low, 1e-9))
