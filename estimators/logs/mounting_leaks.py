"""What the mounting of a sensor adds to its channel: shares of other motions, which are no wrong scale.

An antenna ahead of the centre of gravity moves aside as the vehicle turns; an IMU that is not level reads a
share of what its other axes should; away from the centre of gravity it feels how the turning changes. Such a
channel differs from the motion that it shows by multiples of known signals. It is compared again without
these, whose multiples stay within what a mounting can have. A wrong unit, a sign or a stuck sensor remain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from estimators.logs.signals import Windows
from offroad_env.physics.numerics import GRAVITY

__all__ = ["Leak", "antenna_limit", "leaks_into_lean", "leaks_into_push", "leaks_into_turn", "without_leaks"]

#: Largest angle by which an IMU is turned [rad], distance of an antenna [wheelbases] and of an IMU
#: [wheelbases along, m up] from the centre of gravity: mountings that a description may have wrong, not more.
_ANGLE, _ANTENNA, _ALONG, _UP = 0.2, 1.5, 0.6, 1.0
#: Windows in which a channel and all signals must have values.
_ENOUGH = 10


class Leak(NamedTuple):
    """A signal of which a mounting adds a multiple."""

    values: np.ndarray  #: (W,)
    most: float  #: largest multiple, either way


def antenna_limit(windows: Windows) -> float:
    """Largest distance of an antenna from the centre of gravity, along the vehicle [m]."""
    return _ANTENNA * _wheelbase(windows)


def without_leaks(
    values: np.ndarray, reference: np.ndarray, leaks: list[Leak], *, centred: bool
) -> np.ndarray | None:
    """A channel (W,) without what its mounting adds; None where too few windows have all signals.

    Parameters
    ----------
    reference : (W,)
        The motion that the channel shows, of which it may be any multiple.
    centred
        Whether a constant counts for nothing.
    """
    known = [leak for leak in leaks if np.isfinite(leak.values).sum() >= _ENOUGH]
    if not known:
        return None
    columns = np.column_stack([reference, *(leak.values for leak in known)])
    both = np.isfinite(values) & np.isfinite(columns).all(axis=1)
    if both.sum() < max(_ENOUGH, 2 * columns.shape[1]):
        return None
    own, table = values[both], columns[both]
    if centred:
        own, table = own - own.mean(), table - table.mean(axis=0)
    most = np.array([np.inf, *(leak.most for leak in known)])
    shares = lsq_linear(table, own, bounds=(-most, most)).x[1:]
    return np.asarray(values - columns[:, 1:] @ shares)


def leaks_into_turn(
    windows: Windows, channels: tuple[str, ...], turn: np.ndarray, speed: np.ndarray | None
) -> list[Leak]:
    """For a route to the rate of turn.

    Parameters
    ----------
    turn, speed : (W,)
        By other channels [rad/s, m/s].
    """
    if "yaw_rate" in channels:
        return _turned(windows, ("pitch_rate", "roll_rate"))
    if speed is None:
        return []
    if channels in (("course",), ("x", "y")):
        return [Leak(_change(windows, turn / speed), antenna_limit(windows))]
    if "a_y" in channels:
        lever = Leak(_change(windows, turn) / speed, _ALONG * _wheelbase(windows))
        own = [Leak(leak.values / speed, leak.most) for leak in _turned(windows, ("a_x", "a_z"))]
        if not windows.log.imu.kinematic and "a_z" not in windows.log.channels:
            own.append(Leak(GRAVITY / speed, math.sin(_ANGLE)))
        return [lever, *own]
    return []


def leaks_into_push(windows: Windows, channels: tuple[str, ...]) -> list[Leak]:
    """For a route to the change of speed."""
    if "a_x" not in channels:
        return []
    turn, pitch = windows.mean("yaw_rate"), windows.mean("pitch_rate")
    levers = [] if turn is None else [Leak(turn**2, _ALONG * _wheelbase(windows))]
    levers += [] if pitch is None else [Leak(_change(windows, pitch), _UP)]
    return [*levers, *_turned(windows, ("a_y", "a_z"))]


def leaks_into_lean(windows: Windows, gyro: str) -> list[Leak]:
    """For a gyro that shows how the body leans."""
    others = [name for name in ("yaw_rate", "pitch_rate", "roll_rate") if name != gyro]
    return [Leak(Windows.as_course_rate(leak.values), leak.most) for leak in _turned(windows, tuple(others))]


def _turned(windows: Windows, names: tuple[str, ...]) -> list[Leak]:
    """Other axes of an IMU that is turned."""
    found = [windows.mean(name) for name in names]
    return [Leak(values, math.sin(_ANGLE)) for values in found if values is not None]


def _change(windows: Windows, values: np.ndarray) -> np.ndarray:
    """Change of means of windows per second: from the window before to the one after, (W,)."""
    change = np.full(len(values), math.nan)
    change[1:-1] = (values[2:] - values[:-2]) / windows.length
    return change


def _wheelbase(windows: Windows) -> float:
    return windows.log.vehicle.l_f + windows.log.vehicle.l_r
