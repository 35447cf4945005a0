"""Innovation tests: are the innovations of a filter as small and as free of a mean as its model expects?

The innovations of a filter whose model is right are white, with the covariance that the filter states
(T. Kailath, IEEE Trans. Automatic Control 13(6), 1968), so their normalised square (NIS) of m channels is a
chi-square number of m degrees of freedom: mean m, variance 2 m. Both tests below average over a fading
window: a mean of white noise that forgets exponentially over the time T has dt / (2 T) of the variance of a
sample.
"""

from __future__ import annotations

import math

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["chi_square_excess", "fading_share", "mean_innovation_test", "nis_excess"]


@kernel
def fading_share(dt: float, time: float) -> float:
    """Weight of a new sample in a mean that forgets exponentially over ``time`` [s]."""
    return min(dt / time, 1.0)


@kernel
def nis_excess(nis: float, channels: float) -> float:
    """Excess of a NIS over its expectation, in its standard deviations."""
    return (nis - channels) / math.sqrt(2.0 * channels)


@kernel
def chi_square_excess(chi_square: float, freedom: float) -> float:
    """Excess of a chi-square number over its degrees of freedom, in its standard deviations."""
    return (chi_square - freedom) / math.sqrt(2.0 * freedom)


@kernel
def mean_innovation_test(
    mean: FloatArray, innovation: FloatArray, variance: FloatArray, share: float
) -> float:
    """Chi-square of the fading mean of the innovations, which takes in a new one, in place.

    Parameters
    ----------
    mean, innovation (m,) : running mean and the new innovation
    variance (m,) : that the mean has if the model is right
    share : weight of the new innovation, see `fading_share`
    """
    total = 0.0
    for j in range(mean.shape[0]):
        mean[j] += share * (innovation[j] - mean[j])
        total += mean[j] ** 2 / variance[j]
    return total
