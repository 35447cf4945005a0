"""A steering that acts late: beside a vehicle that weaves it seems to follow something else."""

from __future__ import annotations

import math

import numpy as np

from estimators.logs.log import Log
from estimators.logs.signals import likeness

__all__ = ["steers_late"]

#: Longest lag that is tried, and the step of the comparison [s]; correlation at some lag from which a vehicle
#: follows its steering.
_LONGEST, _STEP, _FOLLOWS = 0.5, 0.05, 0.7
#: Values that a comparison needs, and the least speed [m/s].
_ENOUGH, _SLOW = 40, 1.0
_SPEEDS = ("v_x", "speed")


def steers_late(log: Log) -> bool:
    """Whether the yaw rate follows steering times speed once that is delayed by up to half a second.

    Means over a second, in which channels are compared, hold nothing of a vehicle that weaves; and
    `estimators.logs.signals.offset` needs 20 s, for which a vehicle that weaves need not stay on its course.
    """
    speed = next((name for name in _SPEEDS if name in log.channels), None)
    if speed is None or not {"steer", "yaw_rate"} <= log.channels.keys():
        return False
    grid = np.arange(log.times[0], log.times[-1], _STEP)
    steer, yaw_rate, v = (_over(log, name, grid) for name in ("steer", "yaw_rate", speed))
    asked = np.where(np.abs(v) > _SLOW, v * np.tan(steer), math.nan)
    if np.isfinite(asked).sum() < _ENOUGH:
        return False
    lags = range(round(_LONGEST / _STEP) + 1)
    seen = [likeness(asked[: len(grid) - lag], yaw_rate[lag:], centred=True) for lag in lags]
    return any(one is not None and one.correlation > _FOLLOWS for one in seen)


def _over(log: Log, name: str, grid: np.ndarray) -> np.ndarray:
    t, values = log.samples(name)
    return np.asarray(np.interp(grid, t, values))
