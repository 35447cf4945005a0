"""What a run is judged by, the same for every filter and state source."""

from __future__ import annotations

import math

import numpy as np

__all__ = ["SETTLED", "late_rmse", "mean_square_error", "time_to_5pct"]

#: From here on the first search is over [s].
SETTLED = 20.0


def mean_square_error(n: np.ndarray, truth: np.ndarray | float) -> float:
    """Mean square error of n over the run [-]: the number in the paper's table."""
    return float(np.mean((n - truth) ** 2))


def late_rmse(t: np.ndarray, n: np.ndarray, truth: np.ndarray | float) -> float:
    """Root mean square error from 20 s on [-]; NaN for shorter runs."""
    late = t >= SETTLED
    return float(np.sqrt(np.mean(np.square(n - truth)[late]))) if late.any() else math.nan


def time_to_5pct(t: np.ndarray, n: np.ndarray, truth: np.ndarray | float) -> float:
    """From here on the error stays below 5 % of the truth [s]; inf when it does not."""
    outside = np.flatnonzero(np.abs(n - truth) > 0.05 * np.asarray(truth))
    if outside.size == 0:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else math.inf
