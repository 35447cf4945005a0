"""A bounded parameter as an unbounded one, and back.

A filter whose belief is Gaussian would put weight outside the range in which n means anything.
It therefore estimates eta, with

    n = low + (high - low) / (1 + exp(-eta)),        eta = log((n - low) / (high - n)),

and every sigma point is a possible soil.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel

__all__ = ["belief_of", "from_range", "interval", "moments", "range_slope", "to_range"]

#: Gauss-Hermite rule of 9 nodes for a standard normal variable.
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_WEIGHTS = _WEIGHTS / math.sqrt(2.0 * math.pi)
#: |eta| beyond which n is its bound to 15 digits: more would only lose the slope.
_FURTHEST = 35.0
#: Logarithm of the widest variance of eta that a prior may have. Beyond a standard deviation of 3 the
#: density piles up at both bounds, which three sigma points cannot represent.
_WIDEST = math.log(9.0)


@kernel
def to_range(eta: float, low: float, high: float) -> float:
    """n in (low, high) of the unbounded ``eta``."""
    eta = min(max(eta, -_FURTHEST), _FURTHEST)
    return low + (high - low) / (1.0 + math.exp(-eta))


@kernel
def from_range(n: float, low: float, high: float) -> float:
    """eta of ``n``, which must lie strictly between the bounds (else inf or NaN)."""
    return math.log((n - low) / (high - n))


@kernel
def range_slope(eta: float, low: float, high: float) -> float:
    """dn/deta at ``eta``."""
    share = 1.0 / (1.0 + math.exp(-min(max(eta, -_FURTHEST), _FURTHEST)))
    return (high - low) * share * (1.0 - share)


@kernel
def moments(eta: float, variance: float, low: float, high: float) -> tuple[float, float]:
    """``(mean, sd)`` of n when eta is normal with that mean and variance.

    Nine Gauss-Hermite nodes: within 1e-5 of the range for a standard deviation of eta up to 1.5.
    To first order sd(n) = dn/deta sd(eta), but a wide belief near a bound is skewed, and then its
    mean lies further inside than ``to_range(eta)``, which is its median.
    """
    spread = math.sqrt(max(variance, 0.0))
    mean = square = 0.0
    middle = to_range(eta, low, high)
    for i in range(_NODES.shape[0]):
        d = to_range(eta + spread * _NODES[i], low, high) - middle
        mean += _WEIGHTS[i] * d
        square += _WEIGHTS[i] * d * d
    return middle + mean, math.sqrt(max(square - mean * mean, 0.0))


@lru_cache(maxsize=256)  # the same prior at every start of an episode
def belief_of(mean: float, sd: float, low: float, high: float) -> tuple[float, float]:
    """``(eta, variance)`` of the belief whose n has this mean and standard deviation: `moments` inverted.

    Raises
    ------
    InvalidParameter
        For a mean outside (low, high), or a standard deviation too wide for it.
    """
    from scipy.optimize import brentq  # here: it takes longer to load than the whole environment

    if not low < mean < high:
        raise InvalidParameter(f"the mean must be in ({low:g}, {high:g}), got {mean}")

    def centre(variance: float) -> float:
        """eta at which the mean is right: the mean grows with eta."""
        root: float = brentq(lambda eta: moments(eta, variance, low, high)[0] - mean, -_FURTHEST, _FURTHEST)
        return root

    def spread(log_variance: float) -> float:
        variance = math.exp(log_variance)
        return moments(centre(variance), variance, low, high)[1]

    widest = spread(_WIDEST)
    if not 0.0 < sd <= widest:
        raise InvalidParameter(f"sd must be in (0, {widest:.3g}] for a mean of {mean:g}, got {sd}")
    # sd grows with the variance; to first order it is dn/deta sqrt(variance).
    first = 2.0 * math.log(sd / range_slope(from_range(float(mean), low, high), low, high))
    log_variance = brentq(lambda value: spread(value) - sd, min(first, _WIDEST) - 4.0, _WIDEST)
    return centre(math.exp(log_variance)), math.exp(log_variance)


def interval(
    eta: float, variance: float, low: float, high: float, z: float = 1.959964
) -> tuple[float, float]:
    """Central interval of n, inside (low, high): the bounds are quantiles, so they map exactly.

    ``z`` is the normal quantile; the default gives 95 %.
    """
    spread = z * math.sqrt(variance)
    return to_range(eta - spread, low, high), to_range(eta + spread, low, high)
