"""Profile likelihood of the size of a cause: the log-likelihood along it, all else fitted anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import moved
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.normal_equations import reduced
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["Profile", "profiles_of"]

#: Points of a profile, in standard deviations of the size.
_POINTS = np.array([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0])
#: Twice the log-likelihood at the ends of a 95 % interval.
LEVEL = 3.841


@dataclass(frozen=True, kw_only=True)
class Profile:
    """One cause of the extended model."""

    effect: str
    size: float  #: fitted
    deviation: float
    sizes: np.ndarray  #: (P,)
    likelihood_ratio: np.ndarray  #: (P,) likelihood-ratio statistic against the best point
    low: float  #: 95 % interval by the profile; NaN where it lies beyond the points
    high: float

    @property
    def unit(self) -> str:
        """Of the size."""
        return EFFECTS[self.effect].size.unit


def profiles_of(fit: FitResult) -> tuple[Profile, ...]:
    """Profiles of all sizes in the model.

    At every point all else moves twice to where the normal equations put it, with the derivatives at the
    fitted point, and a simulation gives the cost there.
    """
    if not fit.candidates:
        return ()
    renewed = replace(fit, jacobian=Jacobian().renewed(fit.linearisation))
    shared = renewed.white_shared()
    return tuple(_profile(fit, k, renewed.white_states, shared) for k in range(len(fit.candidates)))


def _profile(fit: FitResult, k: int, states: np.ndarray, shared: np.ndarray) -> Profile:
    """Profile of size ``k``, with whitened derivatives by states (M, S) and shared parameters (M, g)."""
    deviation = float(fit.size_deviations()[k])
    points = [_at(fit, k, float(away) * deviation, (states, shared)) for away in _POINTS]
    reached = [point for point in points if point is not None]
    sizes, costs = np.array([size for size, _ in reached]), np.array([cost for _, cost in reached])
    # An unknown road scatters the size more than the likelihood predicts.
    ratio = 2.0 * (costs - min(costs, default=0.0)) / float(fit.size_inflation[k])
    best = int(np.argmin(ratio)) if len(ratio) else 0
    return Profile(
        effect=fit.candidates[k].effect,
        size=float(fit.sizes[k]),
        deviation=deviation,
        sizes=sizes,
        likelihood_ratio=ratio,
        low=_crossing(sizes[: best + 1][::-1], ratio[: best + 1][::-1]),
        high=_crossing(sizes[best:], ratio[best:]),
    )


def _at(
    fit: FitResult, k: int, away: float, white: tuple[np.ndarray, np.ndarray]
) -> tuple[float, float] | None:
    """(size, cost) with size ``k`` held ``away`` from its fitted value; None where the model breaks down.

    ``white`` are whitened derivatives by states (M, S) and shared parameters (M, g).
    """
    states, shared = white
    trial, held = fit, len(fit.nuisances) + k
    others = [i for i in range(len(fit.point.shared)) if i != held]
    prior, lowest = fit.problem.size_information(fit.candidates), np.inf
    try:
        for step in (away, 0.0):
            residual = fit.noise.whiten(trial.residual)
            equations = reduced(fit.problem, trial.point, residual, states, shared)
            equations = equations.with_prior_of_sizes(prior)
            change = np.zeros(len(equations.score))
            change[held] = step
            push = equations.score[others] - equations.normal[others, held] * step
            change[others] = np.linalg.solve(equations.normal[np.ix_(others, others)], push)
            trial = trial.moved(moved(fit.problem, trial.point, change, equations.windows, 1.0))
            lowest = min(lowest, trial.cost)
    except OffroadError:
        if not np.isfinite(lowest):
            return None
    return float(trial.sizes[k]), lowest


def _crossing(sizes: np.ndarray, ratio: np.ndarray) -> float:
    """Size at which a statistic that starts at its minimum reaches the level; by its square root."""
    above = np.flatnonzero(ratio >= LEVEL)
    if len(above) == 0:
        return float("nan")
    j = int(above[0])
    root = np.sqrt(np.maximum(ratio[j - 1 : j + 1], 0.0))
    return float(np.interp(np.sqrt(LEVEL), root, sizes[j - 1 : j + 1]))
