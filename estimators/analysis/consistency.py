"""Consistency of a filter: chi-square bands for innovations and errors, coverage, and a validity flag.

A filter whose model, noise and start are right has normalised innovations squared (NIS) with a
chi-square distribution of as many degrees of freedom as there are channels, white in time, and
normalised errors squared (NEES) with as many as there are states (Y. Bar-Shalom, X. R. Li & T.
Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4). Errors
of one run are correlated in time, so NEES and coverage are judged over runs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from offroad_env.errors import InvalidParameter

__all__ = [
    "Band",
    "Consistency",
    "chi_square_band",
    "coverage",
    "innovation_flag",
    "innovations_consistent",
    "nees",
    "nees_test",
    "nis_test",
    "surprise",
]


#: Excess of the mean innovation, in its standard deviations, up to which it is consistent, and the time
#: over which that mean is taken [s].
_LARGEST_EXCESS, _WATCH_TIME = 5.0, 2.0
#: Widest 99 % interval of a valid estimate [-]: the distance of two soils that pull alike on clay.
_NARROW = 0.08


class Band(NamedTuple):
    """An interval for a mean of chi-square numbers."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether ``value`` lies inside."""
        return self.low <= value <= self.high


class Consistency(NamedTuple):
    """A mean with the band that a consistent filter keeps."""

    mean: float
    band: Band
    updates: int  #: independent numbers in the mean

    @property
    def consistent(self) -> bool:
        """Whether the mean lies inside the band."""
        return self.band.holds(self.mean)


def chi_square_band(freedom: int, count: int, probability: float = 0.95) -> Band:
    """Central interval of the mean of ``count`` independent chi-square numbers.

    Parameters
    ----------
    freedom : int
        Degrees of freedom of each.
    count : int
        How many.
    probability : float
        Of the interval, in (0, 1).
    """
    if freedom < 1 or count < 1:
        raise InvalidParameter(f"freedom and count must be >= 1, got {freedom} and {count}")
    if not 0.0 < probability < 1.0:
        raise InvalidParameter(f"probability must be in (0, 1), got {probability} - in percent?")
    tail = 0.5 * (1.0 - probability)
    law = chi2(freedom * count)
    return Band(float(law.ppf(tail)) / count, float(law.ppf(1.0 - tail)) / count)


def nis_test(nis: np.ndarray, channels: int, probability: float = 0.95) -> Consistency:
    """Mean NIS of one or more runs against its band; NaN entries (no measurement) are left out.

    Parameters
    ----------
    nis : array, any shape
        Independent in time for a consistent filter.
    channels : int
        Measured at each update.
    probability : float
        Of the band.
    """
    values = np.asarray(nis, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size == 0:
        raise InvalidParameter("nis holds no finite number: the filter made no update")
    return Consistency(float(values.mean()), chi_square_band(channels, values.size, probability), values.size)


def nees(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Normalised error squared e^T P^-1 e of every row.

    Parameters
    ----------
    errors : array (..., L)
    covariances : array (..., L, L)

    Returns
    -------
    array (...)
    """
    errors, covariances = np.asarray(errors, dtype=np.float64), np.asarray(covariances, dtype=np.float64)
    if covariances.shape != (*errors.shape, errors.shape[-1]):
        raise InvalidParameter(
            f"errors {errors.shape} need covariances {(*errors.shape, errors.shape[-1])}, "
            f"got {covariances.shape}"
        )
    # Scaled to unit diagonal first: positions and rates differ by orders of magnitude.
    sd = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    scaled = covariances / (sd[..., :, None] * sd[..., None, :])
    e = errors / sd
    return np.asarray(np.einsum("...i,...i->...", e, np.linalg.solve(scaled, e[..., None])[..., 0]))


def nees_test(errors: np.ndarray, covariances: np.ndarray, probability: float = 0.95) -> Consistency:
    """Mean NEES over independent runs, one moment of each, against its band.

    Parameters
    ----------
    errors : array (runs, L)
    covariances : array (runs, L, L)
    probability : float
        Of the band.
    """
    values = nees(errors, covariances)
    band = chi_square_band(np.shape(errors)[-1], values.size, probability)
    return Consistency(float(values.mean()), band, values.size)


def coverage(
    low: np.ndarray, high: np.ndarray, truth: np.ndarray | float, valid: np.ndarray | None = None
) -> float:
    """Share of the time in which the truth is inside the interval.

    Parameters
    ----------
    low, high : arrays of one shape
        Ends of the interval.
    truth : array or float
        Broadcast against them.
    valid : bool array, optional
        Validity flag: only samples with the flag up count.

    Returns
    -------
    float : NaN when nothing is valid.
    """
    inside = (np.asarray(low) <= truth) & (truth <= np.asarray(high))
    if valid is not None:
        inside = inside[np.broadcast_to(valid, inside.shape)]
    return float(inside.mean()) if inside.size else float("nan")


def surprise(nis: np.ndarray, channels: int, dt: float, watch_time: float = 2.0) -> np.ndarray:
    """Mean excess of the innovations over the last seconds, in its own standard deviations.

    A NIS of m channels has mean m and variance 2 m; a mean that forgets exponentially over the time
    T has dt / (2 T) of the variance of a sample. The banks compute the same while they run
    (`estimators.filters.joint_bank.watch_innovations`).

    Parameters
    ----------
    nis : array (T,)
        NaN where nothing was measured: the mean stays.
    channels : int
        Measured at each update.
    dt, watch_time : float
        Between samples, and of the mean [s].

    Returns
    -------
    array (T,)
    """
    share = min(dt / watch_time, 1.0)
    excess = (np.asarray(nis, dtype=np.float64) - channels) / np.sqrt(2.0 * channels)
    result, mean = np.zeros(excess.shape), 0.0
    for k, value in enumerate(excess):
        if np.isfinite(value):
            mean += share * (value * np.sqrt(2.0 * watch_time / dt) - mean)
        result[k] = mean
    return result


def innovations_consistent(nis: np.ndarray, channels: int, dt: float) -> np.ndarray:
    """Where (T,) the mean innovation of the last 2 s is as large as it should be; never before 2 s.

    Parameters
    ----------
    nis : array (T,)
        Normalised innovation squared; NaN where nothing was measured.
    channels : int
        Measured at each update.
    dt : float
        Between samples [s].
    """
    late = dt * np.arange(len(nis)) > _WATCH_TIME
    return np.asarray((surprise(nis, channels, dt, _WATCH_TIME) <= _LARGEST_EXCESS) & late)


def innovation_flag(nis: np.ndarray, width: np.ndarray, channels: int, dt: float) -> np.ndarray:
    """Validity flag (T,) for a filter that has none: consistent innovations and a narrow 99 % interval.

    Parameters
    ----------
    nis, channels, dt
        As in `innovations_consistent`.
    width : array (T,)
        Of the 99 % interval of n [-].
    """
    return np.asarray(innovations_consistent(nis, channels, dt) & (width <= _NARROW))
