"""Models fitted from the stated numbers, where the present fit has left these.

A number that has taken the place of a large effect moves others with it, and derivatives about that point
tell little of the effect: a payload may then have no score, and a late steering a small one beside the
inertia that stands for it. Effects that may be behind such a fit are fitted from what is stated, one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.discrepancy.model.fit import fitted_afresh
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.alternatives import best_by_effect, order_of
from estimators.discrepancy.search.lower_minimum import LEFT, deviations_off
from estimators.discrepancy.search.result import EQUIVALENT
from estimators.discrepancy.search.score_test import ScoreTest
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["fits_from_stated"]

#: Standard deviations from what is stated from which a number stands for an effect of its own, where another
#: has left its tolerance.
_SUSPECT = 2.5
#: Effects that are fitted: of the numbers furthest off, and with the largest scores beside these.
_OF_NUMBERS, _OF_SCORES = 5, 3
#: Sizes to begin from, as shares of a plausible one.
_BEGINS = (0.4, 0.8)


def fits_from_stated(scores: ScoreTest, threshold: float, others: Sequence[FitResult]) -> list[FitResult]:
    """Models with one effect more, fitted from stated numbers; none where the fit is near these.

    What cannot be as good as the best of ``others``, or of these, is of no use.
    """
    fit, found = scores.fit, list[FitResult]()
    if not np.any(deviations_off(fit) > LEFT):
        return []
    enough = fit.cost - 0.5 * threshold**2
    if others and not order_of(others[0])[0]:
        enough = min(enough, others[0].cost + 0.5 * EQUIVALENT)
    for candidate, sign in _suspects(scores):
        trial = _fitted(fit, candidate, sign, enough)
        if trial is None:
            continue
        found.append(trial)
        if not order_of(trial)[0]:
            enough = min(enough, trial.cost + 0.5 * EQUIVALENT)
    return found


def _fitted(fit: FitResult, candidate: Candidate, sign: float, enough: float) -> FitResult | None:
    """The model with this effect; None if it costs as much as ``enough`` or breaks down.

    Fitted to the end: far from the data the equations promise too little.
    """
    reach = EFFECTS[candidate.effect].plausible(fit.runs[0].setup.plant.vehicle)
    low, high = fit.runs[0].size_limits(candidate.effect)
    best: FitResult | None = None
    for share in _BEGINS:
        size = sign * share * reach
        size = size if low <= size <= high else -size
        try:
            trial = fitted_afresh(fit, (*fit.candidates, candidate), (*fit.sizes, size))
        except OffroadError:
            continue
        if trial.cost < enough:
            best, enough = trial, trial.cost
    return best


def _suspects(scores: ScoreTest) -> list[tuple[Candidate, float]]:
    """Effects that may be behind the fit, with the signs of their sizes."""
    fit, away = scores.fit, deviations_off(scores.fit)
    by_effect = {scores.candidates[i].effect: i for i in best_by_effect(np.abs(scores.z), scores.candidates)}
    signs: dict[int, float] = {}
    for k in np.argsort(-away):
        i = by_effect.get(fit.problem.nuisances[k].effect)
        if away[k] > _SUSPECT and i is not None and len(signs) < _OF_NUMBERS:
            # The effect does what the number does, if their traces are alike, or the opposite.
            alike = float(scores.white[:, k] @ scores.white[:, i - len(scores.candidates)])
            signs.setdefault(i, float(np.copysign(1.0, fit.nuisances[k] * alike)))
    for i in list(by_effect.values())[:_OF_SCORES]:
        signs.setdefault(i, float(np.copysign(1.0, scores.size[i])))
    return [(scores.candidates[i], sign) for i, sign in signs.items()]
