"""A bounded parameter as an unbounded one, and back.

A filter whose belief is Gaussian would put weight outside the range in which n means anything.
It therefore estimates eta, with

    n = low + (high - low) / (1 + exp(-eta)),        eta = log((n - low) / (high - n)),

and every sigma point is a possible soil.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics._jit import kernel

__all__ = ["from_range", "interval", "moments", "range_slope", "to_range"]

#: Gauss-Hermite rule of 9 nodes for a standard normal variable.
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
_WEIGHTS = _WEIGHTS / math.sqrt(2.0 * math.pi)
#: |eta| beyond which n is its bound to 15 digits: more would only lose the slope.
_FURTHEST = 35.0


@kernel
def to_range(eta, low, high):
    """n in (low, high) of the unbounded ``eta``."""
    eta = min(max(eta, -_FURTHEST), _FURTHEST)
    return low + (high - low) / (1.0 + math.exp(-eta))


@kernel
def from_range(n, low, high):
    """eta of ``n``, which must lie strictly between the bounds (else inf or NaN)."""
    return math.log((n - low) / (high - n))


@kernel
def range_slope(eta, low, high):
    """dn/deta at ``eta``."""
    share = 1.0 / (1.0 + math.exp(-min(max(eta, -_FURTHEST), _FURTHEST)))
    return (high - low) * share * (1.0 - share)


@kernel
def moments(eta, variance, low, high):
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


def interval(
    eta: float, variance: float, low: float, high: float, z: float = 1.959964
) -> tuple[float, float]:
    """Central interval of n, inside (low, high): the bounds are quantiles, so they map exactly.

    ``z`` is the normal quantile; the default gives 95 %.
    """
    spread = z * math.sqrt(variance)
    return to_range(eta - spread, low, high), to_range(eta + spread, low, high)
