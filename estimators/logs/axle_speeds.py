"""What two axles tell of a vehicle's speed where their wheels spin or lock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from estimators.logs.immobile import only_spins, stuck_spans
from estimators.logs.signals import Windows

__all__ = ["always_off", "one_spins", "rolls_undriven", "spins_less"]

#: Ratio of a wheel's speed to the vehicle's beyond any spin, and the quartiles' ratio of a wrong scale.
_SPINS, _EVEN = 20.0, 1.6
#: A light axle on soft soil may spin all the time, at a slip of two thirds: so many times as fast as the
#: vehicle.
_DRIVEN = 3.0
#: Slip grows with the torque: least correlation of the two, and the ratio without torque up to which a wheel
#: may roll. So many windows tell it.
_GROWS, _UNDRIVEN, _WINDOWS = 0.5, 1.5, 10


def always_off(ratio: np.ndarray, spread: float) -> bool:
    """Whether a wheel has one wrong ratio to the speed at all times, or one that no wheel spins with.

    Parameters
    ----------
    ratio : (W,)
        Of their sizes, NaN where unknown.
    spread
        Factor between the two that no vehicle exceeds.
    """
    ratio = ratio[np.isfinite(ratio)]
    if not len(ratio):
        return False
    least, low, high = np.quantile(ratio, [0.02, 0.25, 0.75])
    even = high < _EVEN * low
    return bool(low > _SPINS or (even and (least > _DRIVEN or high < 1.0 / spread)))


def rolls_undriven(front: np.ndarray, rear: np.ndarray, torques: Sequence[np.ndarray | None]) -> bool:
    """Whether the faster axle is ahead by its slip: more with more torque, and by nothing without any.

    A scale, or another unit, is the same factor whatever drives the wheel.

    Parameters
    ----------
    front, rear : (W,)
        Speeds of the rims [m/s], NaN where unknown.
    torques : sequence of (W,)
        Of the front and the rear axle, and of both, in any unit; None where it is not logged.
    """
    speeds = np.abs(np.stack([front, rear]))
    known = np.isfinite(speeds).all(axis=0) & (speeds > 0.0).all(axis=0)
    if known.sum() < _WINDOWS:
        return False
    ahead = np.log(speeds[0, known] / speeds[1, known])
    in_front = bool(np.median(ahead) > 0.0)
    own = torques[0 if in_front else 1]
    torque = torques[2] if own is None else own
    if torque is None:
        return False
    push, ahead = np.abs(torque[known]), ahead if in_front else -ahead
    if not np.isfinite(push).all() or np.std(push) <= 0.0 or np.std(ahead) <= 0.0:
        return False
    _slope, undriven = np.polyfit(push, ahead, 1)
    return bool(np.corrcoef(push, ahead)[0, 1] > _GROWS and undriven < math.log(_UNDRIVEN))


def one_spins(windows: Windows, front: np.ndarray, rear: np.ndarray) -> bool:
    """Whether two axles' speeds (W,) [m/s] contradict each other since one spins, whichever it is.

    It does before a vehicle gets stuck.
    """
    faster, slower = np.fmax(np.abs(front), np.abs(rear)), np.fmin(np.abs(front), np.abs(rear))
    torques = [windows.mean(name) for name in ("torque_f", "torque_r", "drive_force")]
    return bool(
        stuck_spans(windows.log) or only_spins(faster, slower) or rolls_undriven(front, rear, torques)
    )


def spins_less(
    front: np.ndarray, rear: np.ndarray, torques: Sequence[np.ndarray | None], direction: np.ndarray
) -> np.ndarray:
    """Speed of the axle that spins, or locks, less: the slower one, but the faster one under brakes.

    Parameters
    ----------
    front, rear : (W,)
        Speeds of the rims [m/s].
    torques : sequence of (W,)
        What drives the vehicle forwards, or brakes it, in any unit; None where it is not logged.
    direction : (W,)
        -1 where the vehicle drives backwards, otherwise 1.

    Returns
    -------
    speed : (W,)
        [m/s]; that of the other axle where one shows nothing.
    """
    push = sum((np.nan_to_num(one) for one in torques if one is not None), start=np.zeros(len(front)))
    slower = np.where(np.abs(front) <= np.abs(rear), front, rear)
    faster = np.where(np.abs(front) <= np.abs(rear), rear, front)
    chosen = np.where(push * direction < 0.0, faster, slower)
    known = np.where(np.isfinite(front), front, rear)
    return np.where(np.isfinite(front) & np.isfinite(rear), chosen, known)
