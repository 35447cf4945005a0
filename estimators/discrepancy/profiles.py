"""How well the data hold the size of a cause: the log-likelihood along it, all else fitted anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.fit import Fit
from estimators.discrepancy.nuisances import NUISANCES
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
    loss: np.ndarray  #: (P,) twice the log-likelihood that is lost there
    low: float  #: 95 % interval by the profile; NaN where it lies beyond the points
    high: float

    @property
    def unit(self) -> str:
        """Of the size."""
        return EFFECTS[self.effect].size.unit


def profiles_of(fit: Fit) -> tuple[Profile, ...]:
    """Profiles of all sizes in the model.

    At every point all else moves to where the normal equations put it, twice, and the simulation says
    what that costs: the derivatives are those at the fitted point.
    """
    if not fit.candidates:
        return ()
    fit.residual()
    fit.linearise()
    white = fit.whitener(fit._states), fit.whitener(fit.columns())
    return tuple(_profile(fit, k, white) for k in range(len(fit.candidates)))


def _profile(fit: Fit, k: int, white: tuple[np.ndarray, np.ndarray]) -> Profile:
    deviation = float(fit.deviations()[len(NUISANCES) + k])
    # An unknown road scatters the size more than the likelihood says.
    wide = 1.0 if fit.drawn is None else float(fit.widenings()[len(NUISANCES) + k])
    sizes, costs = [], []
    for point in _POINTS:
        reached = _at(fit, k, float(point) * deviation, white)
        if reached is not None:
            sizes.append(reached[0])
            costs.append(reached[1])
    sizes, loss = np.array(sizes), 2.0 * (np.array(costs) - min(costs, default=0.0)) / wide
    best = int(np.argmin(loss)) if len(loss) else 0
    return Profile(
        effect=fit.candidates[k].effect,
        size=float(fit.sizes[k]),
        deviation=deviation,
        sizes=sizes,
        loss=loss,
        low=_crossing(sizes[: best + 1][::-1], loss[: best + 1][::-1]),
        high=_crossing(sizes[best:], loss[best:]),
    )


def _at(fit: Fit, k: int, away: float, white: tuple[np.ndarray, np.ndarray]) -> tuple[float, float] | None:
    """(size, cost) with size ``k`` held ``away`` from its fitted value; None where the model breaks down."""
    trial, held = fit.branch(), len(NUISANCES) + k
    others = [i for i in range(len(NUISANCES) + len(fit.sizes)) if i != held]
    lowest = np.inf
    try:
        residual = trial.residual()
        for step in (away, 0.0):
            shares, back = trial.reduce(trial.whitener(residual), *white)
            trial._loosely_bound(shares.normal)
            change = np.zeros(len(shares.score))
            change[held] = step
            push = shares.score[others] - shares.normal[others, held] * step
            change[others] = np.linalg.solve(shares.normal[np.ix_(others, others)], push)
            trial.nuisances, trial.sizes, trial.starts = trial._moved(change, back, 1.0)
            residual = trial.residual()
            lowest = min(lowest, trial.cost_of(residual))
    except OffroadError:
        if not np.isfinite(lowest):
            return None
    return float(trial.sizes[k]), lowest


def _crossing(sizes: np.ndarray, loss: np.ndarray) -> float:
    """Size at which a loss that starts at its minimum reaches the level; by the root of the loss."""
    above = np.flatnonzero(loss >= LEVEL)
    if len(above) == 0:
        return float("nan")
    j = int(above[0])
    root = np.sqrt(np.maximum(loss[j - 1 : j + 1], 0.0))
    return float(np.interp(np.sqrt(LEVEL), root, sizes[j - 1 : j + 1]))
