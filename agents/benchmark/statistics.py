"""Intervals for paired episodes and success counts.

The interquartile mean and the probability of improvement follow R. Agarwal et al., Deep
reinforcement learning at the edge of the statistical precipice, NeurIPS 2021.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import DegenerateDataWarning, bootstrap, norm, trim_mean

from offroad_env.errors import InvalidParameter

__all__ = [
    "Interval",
    "bootstrap_interval",
    "effect_size",
    "headroom",
    "interquartile_mean",
    "mean_interval",
    "paired_difference",
    "probability_of_improvement",
    "recovered_share",
    "wilson_interval",
]

_RESAMPLES = 5000


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float
    level: float = 0.95

    def __format__(self, spec: str) -> str:
        spec = spec or ".2f"
        if not math.isfinite(self.high - self.low):
            return f"{self.value:{spec}} (one sample: no interval)"
        return f"{self.value:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"


def bootstrap_interval(
    samples: tuple[np.ndarray, ...],
    statistic: Callable[..., np.ndarray],
    *,
    level: float = 0.95,
    method: str = "BCa",
    seed: int = 0,
) -> Interval:
    """Bootstrap interval of a statistic of paired samples.

    Parameters
    ----------
    samples : tuple of arrays (E,)
        Row e of every array is the same episode: episodes are drawn, not numbers.
    statistic : callable
        Takes the arrays and ``axis``; returns the statistic along that axis.
    level : float
        Confidence level, in (0, 1).
    method : {"BCa", "percentile"}
        BCa corrects bias and skewness of the mean of few episodes (B. Efron, JASA 82, 1987).
    seed : int
        Of the resampling: the same data give the same interval.

    Raises
    ------
    InvalidParameter
        With fewer than two episodes, arrays of different lengths or values that are not finite.
    """
    arrays = tuple(np.asarray(sample, dtype=np.float64) for sample in samples)
    if len({array.shape for array in arrays}) != 1 or arrays[0].ndim != 1 or arrays[0].size < 2:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise InvalidParameter(f"samples must be 1-D of one length >= 2, got shapes {shapes} - not paired?")
    if not all(np.isfinite(array).all() for array in arrays):
        raise InvalidParameter("samples must be finite, got NaN or inf - a failed episode without a score?")
    if not 0.0 < level < 1.0:
        raise InvalidParameter(f"level must be in (0, 1), got {level:g} - per cent?")
    value = float(statistic(*arrays, axis=-1))
    if all(np.ptp(array) == 0.0 for array in arrays):
        return Interval(value, value, value, level)
    with warnings.catch_warnings():
        # Differences that are all equal have no acceleration constant; handled below.
        warnings.simplefilter("ignore", DegenerateDataWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        found = bootstrap(
            arrays,
            statistic,
            paired=True,
            vectorized=True,
            n_resamples=_RESAMPLES,
            confidence_level=level,
            method=method,
            rng=np.random.default_rng(seed),
        )
    low, high = float(found.confidence_interval.low), float(found.confidence_interval.high)
    if math.isnan(low) or math.isnan(high):
        draws = found.bootstrap_distribution
        low, high = (float(q) for q in np.quantile(draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level]))
    return Interval(value, low, high, level)


def mean_interval(values: np.ndarray, *, level: float = 0.95, seed: int = 0) -> Interval:
    """Mean with its bootstrap interval."""
    return bootstrap_interval((values,), np.mean, level=level, seed=seed)


def paired_difference(a: np.ndarray, b: np.ndarray, *, level: float = 0.95, seed: int = 0) -> Interval:
    """Mean of a - b over the same episodes, with its bootstrap interval."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if a.shape != b.shape:
        raise InvalidParameter(f"paired samples must have one shape, got {a.shape} and {b.shape}")
    return bootstrap_interval((a - b,), np.mean, level=level, seed=seed)


def headroom(
    informed: np.ndarray, uninformed: tuple[np.ndarray, ...], *, level: float = 0.95, seed: int = 0
) -> Interval:
    """How much lower the mean score of ``informed`` is than that of the best uninformed arm.

    Which uninformed arm is the best is decided anew in every resample, so the interval includes the
    luck of that choice. The minimum makes the bootstrap mean a little too small: the claim errs on
    the side of "knowing does not pay". Percentile interval, since the minimum is not smooth.
    """

    def saved(*arrays: np.ndarray, axis: int) -> np.ndarray:
        others = np.stack([np.mean(array, axis=axis) for array in arrays[1:]])
        gain: np.ndarray = others.min(axis=0) - np.mean(arrays[0], axis=axis)
        return gain

    return bootstrap_interval((informed, *uninformed), saved, level=level, method="percentile", seed=seed)


def recovered_share(
    aware: np.ndarray,
    oracle: np.ndarray,
    uninformed: tuple[np.ndarray, ...],
    *,
    level: float = 0.95,
    seed: int = 0,
) -> Interval:
    """Share of the headroom that ``aware`` recovers: 1 = as good as the oracle, 0 = as the best uninformed.

    To be asked for where the headroom's interval lies above zero. Percentile interval, with the best
    uninformed arm decided anew in every resample.
    """

    def share(*arrays: np.ndarray, axis: int) -> np.ndarray:
        best = np.stack([np.mean(array, axis=axis) for array in arrays[2:]]).min(axis=0)
        recovered: np.ndarray = (best - np.mean(arrays[0], axis=axis)) / (
            best - np.mean(arrays[1], axis=axis)
        )
        return recovered

    return bootstrap_interval(
        (aware, oracle, *uninformed), share, level=level, method="percentile", seed=seed
    )


def effect_size(a: np.ndarray, b: np.ndarray) -> float:
    """Mean of the paired differences a - b over their standard deviation; 0 where they do not differ."""
    difference = np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64)
    spread = float(difference.std(ddof=1))
    return float(difference.mean()) / spread if spread > 0.0 else 0.0


def interquartile_mean(values: np.ndarray) -> float:
    """Mean of the middle half of the values."""
    return float(trim_mean(np.asarray(values, dtype=np.float64), 0.25))


def probability_of_improvement(
    a: np.ndarray, b: np.ndarray, *, level: float = 0.95, seed: int = 0
) -> Interval:
    """Share of the episodes in which ``a`` scores lower (better) than ``b``; a tie counts half."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if a.shape != b.shape:
        raise InvalidParameter(f"paired samples must have one shape, got {a.shape} and {b.shape}")
    wins = np.where(a < b, 1.0, np.where(a == b, 0.5, 0.0))
    return bootstrap_interval((wins,), np.mean, level=level, method="percentile", seed=seed)


def wilson_interval(successes: int, trials: int, *, level: float = 0.95) -> Interval:
    """Wilson's score interval of a proportion (E. B. Wilson, JASA 22, 1927)."""
    if trials < 1 or not 0 <= successes <= trials:
        raise InvalidParameter(f"successes must be in [0, trials >= 1], got {successes} of {trials}")
    z = float(norm.ppf(0.5 + 0.5 * level))
    p, square = successes / trials, z * z / trials
    centre = (p + 0.5 * square) / (1.0 + square)
    half = z / (1.0 + square) * math.sqrt(p * (1.0 - p) / trials + 0.25 * square / trials)
    return Interval(p, max(centre - half, 0.0), min(centre + half, 1.0), level)
