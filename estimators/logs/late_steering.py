"""A steering that acts late: beside a vehicle that weaves it seems to follow something else."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from estimators.logs.log import Log
from estimators.logs.signals import Windows, likeness

__all__ = ["STEEPEST", "steered_turn", "steers_late"]

#: Longest delay and lag that are tried, and the step of the comparison [s]; correlation at one of them from
#: which a vehicle follows its steering.
_DELAY, _LAG, _STEP, _FOLLOWS = 0.5, 1.0, 0.05, 0.7
#: No wheel is steered beyond that [rad].
STEEPEST = 1.5
#: Values that a comparison needs, and the least speed [m/s].
_ENOUGH, _SLOW = 40, 1.0


def steers_late(windows: Windows, speed: np.ndarray | None, kind: str, spread: float) -> bool:
    """Whether the yaw rate follows steering times speed once that is late: half a second, or a lag of one.

    Means over a second, in which channels are compared, hold nothing of a vehicle that weaves, and too little
    of one whose wheels turn slowly; and `estimators.logs.signals.offset` needs 20 s, for which a vehicle that
    weaves need not stay on its course.

    Parameters
    ----------
    speed : (W,)
        Of the vehicle in the windows [m/s], NaN where unknown.
    kind, spread
        What the steering seems to be: a "contradiction" of the yaw rate, or another "scale", from which it
        differs if both agree within the factor ``spread`` then.
    """
    log = windows.log
    if kind not in ("contradiction", "scale"):
        return False
    if speed is None or not np.isfinite(speed).any() or not {"steer", "yaw_rate"} <= log.channels.keys():
        return False
    grid = np.arange(log.times[0], log.times[-1], _STEP)
    steer, yaw_rate = (_over(log, name, grid) for name in ("steer", "yaw_rate"))
    known = np.isfinite(speed)
    v = np.interp(grid, (windows.starts + 0.5 * windows.length)[known], speed[known])
    v[np.abs(v) <= _SLOW] = math.nan
    if np.isfinite(v).sum() < _ENOUGH:
        return False
    shifted = _delayed(steer) if kind == "contradiction" else _lagging(steer)
    seen = [likeness(steered_turn(log, v, one), yaw_rate, centred=True) for one in shifted]
    best = max((one for one in seen if one is not None), key=lambda one: one.correlation, default=None)
    if best is None or best.correlation <= _FOLLOWS:
        return False
    return kind != "scale" or 1.0 / spread < best.factor < spread


def steered_turn(log: Log, speed: np.ndarray, steer: np.ndarray) -> np.ndarray:
    """Rate of turn [rad/s] of a vehicle whose wheels roll where they point, (T,) by speed and steering."""
    turn = speed * np.tan(np.clip(steer, -STEEPEST, STEEPEST)) / (log.vehicle.l_f + log.vehicle.l_r)
    return np.asarray(turn)


def _delayed(values: np.ndarray) -> list[np.ndarray]:
    """The values (T,) after delays from none to the longest."""
    return [
        np.append(np.full(lag, math.nan), values[: len(values) - lag])
        for lag in range(round(_DELAY / _STEP) + 1)
    ]


def _lagging(values: np.ndarray) -> list[np.ndarray]:
    """The values (T,) with lags of the first order: for noise they would make a contradiction vanish."""
    shares = [1.0 / (1.0 + lag) for lag in range(round(_LAG / _STEP) + 1)]
    return [lfilter([a], [1.0, a - 1.0], values, zi=[(1.0 - a) * values[0]])[0] for a in shares]


def _over(log: Log, name: str, grid: np.ndarray) -> np.ndarray:
    t, values = log.samples(name)
    return np.asarray(np.interp(grid, t, values))
