"""What a search for causes returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Linearisation
from estimators.discrepancy.model.null_simulations import inflation_along
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.score_test import ScoreTest
from offroad_env.errors import OffroadError

__all__ = ["EQUIVALENT", "Alternative", "Cause", "SearchResult", "scatter_between", "separation"]

#: Effects within this likelihood-ratio statistic of the best are alternatives: 99 % of chi-square, 1 degree.
EQUIVALENT = 6.63


def separation(better: FitResult, other: FitResult) -> float:
    """Twice the log-likelihood by which a model is better than another, in the noise that there is.

    White noise moves the likelihood ratio of two models by twice the root of their distance (D. R. Cox,
    J. Roy. Statist. Soc. B 24, 1962). Roads and soil scatter more along their difference, by a factor that
    null simulations tell, and by so much less is the ratio worth. What a nuisance lies off its prior is no
    residual, and counts in full.
    """
    prior = other.problem.nuisance_prior_cost(other.point) - better.problem.nuisance_prior_cost(better.point)
    gain = other.cost - better.cost - prior
    if better.null is None:
        return 2.0 * (gain + prior)
    difference = better.noise.whiten(other.residual - better.residual)
    along = better.without_states(difference[:, None])[:, 0]
    return 2.0 * (gain / inflation_along(along, better.null.white) + prior)


def scatter_between(fit: FitResult, other: FitResult) -> float:
    """Variance of null simulations along the difference of two fitted models, over that of white noise.

    Without what the parameters of the first can take away: null simulations would be fitted, too.
    """
    if fit.null is None:
        return 1.0
    columns = fit.without_states(fit.completed().white_shared())
    difference = fit.noise.whiten((fit.residual - other.residual)[:, None])
    direction = fit.without_states(difference)[:, 0]
    gram, prior = columns.T @ columns, fit.problem.nuisance_information
    gram[np.arange(len(prior)), np.arange(len(prior))] += prior
    direction = direction - columns @ (np.linalg.pinv(gram, hermitian=True) @ (columns.T @ direction))
    return inflation_along(direction, fit.null.white)


@dataclass(frozen=True, kw_only=True)
class Alternative:
    """An effect that explains the data about as well as another."""

    candidate: Candidate
    size: float
    deviation: float
    likelihood_ratio: float  #: likelihood-ratio statistic against the best: twice the log-likelihood it lacks
    ground: float  #: the ground's parameter fitted with it (see `NUISANCES`)
    ground_deviation: float

    @classmethod
    def of(cls, fit: FitResult, candidate: Candidate, likelihood_ratio: float) -> Alternative:
        """An effect of a fitted model."""
        i = fit.candidates.index(candidate)
        return cls(
            candidate=candidate,
            size=float(fit.sizes[i]),
            deviation=float(fit.size_deviations()[i]),
            likelihood_ratio=float(likelihood_ratio),
            ground=float(fit.nuisances[0]),
            ground_deviation=float(fit.deviations()[0]),
        )


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A place in the model that some effect must fill: all that can, best first.

    Last are those that windows apart reject although they explain more in all.
    """

    alternatives: tuple[Alternative, ...]
    likelihood_ratio: float  #: likelihood-ratio statistic of the best against the model without it
    p_value: float  #: share of null logs with so large a score among all candidates

    @property
    def best(self) -> Alternative:
        """The one that the extended model uses."""
        return self.alternatives[0]


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """Models before and after a search, and what was found on the way."""

    nominal: FitResult
    extended: FitResult
    first: ScoreTest  #: scores against the nominal model
    last: ScoreTest  #: scores against the extended model
    threshold: float  #: of the first scores
    holdout_gains: tuple[float, ...] = ()  #: of each tested model on windows apart, in the log-likelihood
    #: Whether scores of the fitted windows are significant, but the hold-out test rejects every larger model.
    refused: bool = False
    #: Whether a model holds as many effects as one may, and scores of others are still significant.
    capped: bool = False
    #: Whether a score that is refused is larger than those of null logs.
    beyond_null_logs: bool = False
    #: Numbers of vehicle and soil that the model has to move beyond any tolerance, also with its causes.
    strayed: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    #: Places of causes for which far more speaks than an effect needs, and that windows apart contradict.
    uncertain: tuple[int, ...] = ()

    def score_of(self, change: np.ndarray) -> np.ndarray:
        """Change of the last scores (C,), in standard deviations, by a change of the residuals (M,)."""
        return self.last.scores(self.extended, change)

    def solver_error(self) -> float:
        """Largest change of a score by a finer solver [standard deviations]; infinite if it breaks down."""
        try:
            fine = Linearisation.at(self.extended.problem.refined(), self.extended.point)
        except OffroadError:
            return float("inf")
        change = fine.residual - self.extended.residual
        return float(np.abs(self.score_of(change)).max(initial=0.0))
