"""Samples of a distribution that is known up to a constant, by adaptive importance sampling.

Proposals are Student's t distributions with mean and covariance of the samples so far; all samples are
weighted by the mixture of all proposals (adaptive multiple importance sampling: J.-M. Cornuet et al.,
Scandinavian Journal of Statistics 39, 2012; A. Owen & Y. Zhou, Journal of the American Statistical
Association 95, 2000).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from offroad_env.physics.records import FloatArray

__all__ = ["WeightedSamples", "importance_samples"]

#: Draws of a round, most rounds, and effective number of samples that is enough after two or more.
_DRAWS, _ROUNDS, _ENOUGH = 200, 8, 120.0
#: Degrees of freedom of a proposal, and its standard deviations over those that were found: its tails must
#: reach further than those of the posterior.
_FREEDOM, _WIDER = 6.0, 1.3
#: Effective samples that the next proposal needs, over the numbers: until then weights are flattened.
_LEAST, _FLATTER, _FLATTEST = 3.0, 0.85, 0.05
_SEED = 0
#: Smallest variance of a proposal: a number may lie at an end of its range.
_LEAST_VARIANCE = 1e-9


@dataclass(frozen=True, kw_only=True)
class WeightedSamples:
    """Samples with weights."""

    values: FloatArray  #: (N, D)
    weights: FloatArray  #: (N,), sum one
    #: Number of independent samples that tell as much: 1 / sum of the squared weights.
    effective: float

    def mean(self) -> FloatArray:
        """(D,)"""
        found: FloatArray = self.weights @ self.values
        return found

    def covariance(self) -> FloatArray:
        """(D, D)"""
        away = self.values - self.mean()
        found: FloatArray = (away * self.weights[:, None]).T @ away
        return found


@dataclass(frozen=True, kw_only=True)
class _Proposal:
    """A multivariate Student's t distribution."""

    middle: FloatArray  #: (D,)
    factor: FloatArray  #: (D, D) lower Cholesky factor of its scale

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(N, D) samples."""
        normal = rng.standard_normal((count, len(self.middle)))
        stretch = np.sqrt(rng.chisquare(_FREEDOM, count) / _FREEDOM)
        found: FloatArray = self.middle + (normal / stretch[:, None]) @ self.factor.T
        return found

    def log_density(self, numbers: FloatArray) -> FloatArray:
        """(N,) at ``numbers`` (N, D), up to a constant that all proposals share."""
        white = solve_triangular(self.factor, (numbers - self.middle).T, lower=True)
        inner = np.log1p((white**2).sum(axis=0) / _FREEDOM)
        found: FloatArray = -0.5 * (_FREEDOM + len(self.middle)) * inner - np.log(np.diag(self.factor)).sum()
        return found


def _proposal(middle: FloatArray, covariance: FloatArray) -> _Proposal:
    factor = _WIDER * np.linalg.cholesky(covariance)
    return _Proposal(middle=middle, factor=np.asarray(factor, dtype=np.float64))


def _weights(logs: FloatArray, power: float = 1.0) -> tuple[FloatArray, float]:
    """Weights (N,) of sum one from their logarithms, and the effective number of samples."""
    raw = np.exp(power * (logs - logs.max()))
    found: FloatArray = raw / raw.sum()
    return found, 1.0 / float((found**2).sum())


def _next(numbers: FloatArray, logs: FloatArray) -> _Proposal:
    """The proposal with mean and covariance of the samples, flattened until these are of enough samples."""
    power, size = 1.0, numbers.shape[1]
    weights, effective = _weights(logs)
    while effective < _LEAST * size and power > _FLATTEST:
        power *= _FLATTER
        weights, effective = _weights(logs, power)
    middle = weights @ numbers
    away = numbers - middle
    covariance = (away * weights[:, None]).T @ away + _LEAST_VARIANCE * np.eye(size)
    return _proposal(middle, covariance)


def importance_samples(
    log_density: Callable[[FloatArray], float], starts: Sequence[tuple[FloatArray, FloatArray]]
) -> WeightedSamples:
    """Samples of a distribution; the same for the same arguments.

    Parameters
    ----------
    log_density
        Logarithm of the density at (D,) numbers, up to a constant; -inf where it is zero. Called 400 to 1,600
        times.
    starts
        Means (D,) and covariances (D, D) of parts of the distribution, one or more: the first proposals. On a
        bent ridge no single one reaches from end to end.
    """
    rng, proposals = np.random.default_rng(_SEED), [_proposal(*start) for start in starts]
    counts = [_DRAWS // len(starts)] * len(starts)
    values = np.concatenate([one.draw(rng, n) for one, n in zip(proposals, counts, strict=True)])
    target = np.array([log_density(row) for row in values])
    for rounds in range(1, _ROUNDS + 1):
        densities = [math.log(n) + one.log_density(values) for one, n in zip(proposals, counts, strict=True)]
        logs = target - np.logaddexp.reduce(densities, axis=0)
        weights, effective = _weights(logs)
        if rounds == _ROUNDS or (rounds > 1 and effective >= _ENOUGH):
            break
        proposals.append(_next(values, logs))
        counts.append(_DRAWS)
        drawn = proposals[-1].draw(rng, _DRAWS)
        values = np.concatenate([values, drawn])
        target = np.append(target, [log_density(row) for row in drawn])
    return WeightedSamples(values=values, weights=weights, effective=effective)
