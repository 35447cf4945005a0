"""What two axles tell of a vehicle's speed where their wheels spin or lock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["always_off", "spins_less"]

#: Ratio of a wheel's speed to the vehicle's beyond any spin, and the quartiles' ratio of a wrong scale.
_SPINS, _EVEN = 20.0, 1.6
#: A light axle on soft soil may spin all the time, at a slip of two thirds: so many times as fast as the
#: vehicle.
_DRIVEN = 3.0


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
