"""Whether a larger model is accepted: what fitted windows and those apart together must show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.search.holdout import HoldOutResult, HoldOutTest
from estimators.discrepancy.search.lower_minimum import LEFT, deviations_off
from estimators.discrepancy.search.result import scatter_between
from offroad_env.errors import OffroadError

__all__ = [
    "IMPOSSIBLE",
    "LARGE",
    "TESTED",
    "Accepted",
    "Bars",
    "Refuted",
    "accepted_of",
    "confirmed",
    "support_of",
]

#: Standard deviations from a stated number beyond which no tolerance explains what a fit makes of it.
IMPOSSIBLE = 6.0
#: So many thresholds noise does not exceed: effects with such scores are sought closely along the route; two
#: that explain so much more than one need not be confirmed apart, and one is not given up for windows apart.
LARGE = 2.0
#: Models as good as the best that are tested on windows apart.
TESTED = 3


class Bars(NamedTuple):
    """Least size of an effect, in standard deviations."""

    fitted: float  #: in the windows that are fitted
    together: float  #: in those and the windows apart together


class Refuted(NamedTuple):
    """A model that windows apart contradict, though all windows together speak for it."""

    fit: FitResult
    evidence: float


class Accepted(NamedTuple):
    """Outcome of hold-out tests of larger models."""

    fit: FitResult | None  #: the first that is confirmed
    gains: list[float]  #: of each model tested, in the log-likelihood of windows apart
    refused: bool  #: one was rejected that the fitted windows support
    rejected: frozenset[str] = frozenset()  #: effects of the first models that were rejected before this one
    evidence: float = math.inf  #: for it, of fitted windows and those apart together
    #: Models that were rejected, with their evidence.
    others: tuple[tuple[FitResult, float], ...] = ()
    refuted: tuple[Refuted, ...] = ()  #: those for which far more speaks than an effect needs, in all
    settled: tuple[FitResult, ...] = ()  #: those that were rejected, each with a noise of its own

    @property
    def step(self) -> FitResult | None:
        """The model from which a search goes on, or None.

        Windows apart may contradict one of two effects that they confirm together.
        """
        best = max(self.refuted, key=lambda one: one.evidence, default=None)
        return best.fit if self.fit is None and best is not None else self.fit

    @property
    def stronger(self) -> tuple[FitResult, ...]:
        """Models of one effect that windows apart reject and that have more evidence in all nevertheless."""
        pairs = self.others if self.fit is not None else ()
        return tuple(fit for fit, found in pairs if found > self.evidence and len(fit.candidates) == 1)


def _pruned(fit: FitResult, threshold: float) -> FitResult:
    """Without the effects whose sizes are no longer significant."""
    while len(fit.candidates) > 1:
        strength = np.abs(fit.sizes) / fit.size_deviations()
        weakest = int(np.argmin(strength))
        if strength[weakest] > threshold:
            break
        keep = [i for i in range(len(fit.candidates)) if i != weakest]
        fit = settled(fit.with_effects([fit.candidates[i] for i in keep], fit.sizes[keep]), fresh=False)
    return fit


def support_of(fit: FitResult, trial: FitResult, larger: FitResult) -> float:
    """Evidence of the fitted windows for the effects that are new in a ``larger`` model.

    The gain of the ``trial`` from which it was settled, with the noise as it was, or the likelihood ratio of
    the least of the new effects, if that is less. Road and soil scatter more beside the smaller noise of the
    larger model, so that each is measured in its own noise.

    An effect that grows with the sinkage makes the ground scatter more itself, so that a size over its own
    deviation falls where the effect grows (W. W. Hauck and A. Donner, J. Am. Stat. Assoc. 72 (1977) 851). So
    a single one has at least what its gain is over the scatter where nothing is wrong.
    """
    names = {candidate.effect for candidate in fit.candidates}

    def new(model: FitResult) -> list[int]:
        return [i for i, candidate in enumerate(model.candidates) if candidate.effect not in names]

    gain, wide = fit.cost - trial.cost, float(np.max(trial.size_inflation[new(trial)], initial=1.0))
    least = np.min((np.abs(larger.sizes) / larger.size_deviations())[new(larger)], initial=np.inf)
    support = float(min(gain / wide, 0.5 * least**2))
    if len(new(larger)) == 1:
        support = max(support, gain / scatter_between(fit, trial))
    return support + _returned(fit, larger)


def _returned(fit: FitResult, larger: FitResult) -> float:
    """Evidence by stated numbers that a larger model takes back from where no tolerance explains them.

    Scatter of road and soil does not widen it: in 150 natural logs of unmodified vehicles no number with an
    effect of its own went further than 4.1 of its deviations, and none further than 4.5.
    """
    away = deviations_off(fit)
    enough = [LEFT if number.effect else IMPOSSIBLE for number in fit.problem.nuisances]
    if not np.any(away > enough):
        return 0.0
    before, after = (model.problem.nuisance_prior_cost(model.point) for model in (fit, larger))
    return max(before - after, 0.0)


def accepted_of(test: HoldOutTest, trials: Sequence[FitResult], bars: Bars) -> Accepted:
    """The first of the models that the windows apart confirm, settled.

    What does not reach the second bar in the fitted windows is noise; its rejection is no sign of an unknown
    cause.
    """
    fit, refused = test.fit, False
    gains: list[float] = []
    others: list[tuple[FitResult, float]] = []
    refuted: list[Refuted] = []
    rejected: list[FitResult] = []
    names = {candidate.effect for candidate in fit.candidates}
    enough = 0.5 * bars.together**2
    for trial in trials[:TESTED]:
        # After a refusal, only what is confirmed with the noise as it is gets the work of a noise of its own.
        if gains and not confirmed(test.result(trial), support_of(fit, trial, trial), enough):
            continue
        try:
            larger = _pruned(settled(trial, fresh=False), bars.fitted)
        except OffroadError:
            # It drives where it began, and not where it is best.
            continue
        if {candidate.effect for candidate in larger.candidates} == names:
            break
        result, support = test.result(larger), support_of(fit, trial, larger)
        if result is None:
            return Accepted(larger, gains, refused=False)
        gains.append(result.gain)
        found = support + result.evidence
        if confirmed(result, support, enough):
            return Accepted(larger, gains, refused=False, evidence=found, others=tuple(others))
        others.append((trial, found))
        rejected.append(larger)
        refused |= support > enough
        if found > LARGE**2 * enough:
            refuted.append(Refuted(larger, found))
    left = tuple(rejected)
    return Accepted(None, gains, refused, others=tuple(others), refuted=tuple(refuted), settled=left)


def confirmed(result: HoldOutResult | None, support: float, enough: float) -> bool:
    """Whether fitted windows and those apart together show enough, and the latter do not contradict."""
    if result is None or result.contradicts:
        return False
    return support + result.evidence > enough
