"""Which effects may take the place of a cause that was found, and which of them explains the drive best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.normal_equations import projected
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.physical_ranges import at_end
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.search.result import EQUIVALENT, Alternative, Cause, separation
from estimators.discrepancy.search.score_test import ScoreTest

__all__ = [
    "FIRST_LOOK",
    "NEAR_BEST",
    "REFITS",
    "as_good_as",
    "best_by_effect",
    "cause_of",
    "order_of",
    "p_value_of_score",
]

#: Alternatives that are refitted, and how close a first look must find them.
REFITS, FIRST_LOOK = 4, 3.0 * EQUIVALENT
#: The variance along the difference of two models may exceed that of a size so many times.
_WIDER = 4.0
#: Alternatives of the first step: scores that are this share of the best. A number that has taken the place
#: of an effect strengthens the score of its own effect, and weakens that of the true one.
NEAR_BEST = 0.6
#: Alternatives of a cause are refitted where a first look takes away no more than this share of its evidence.
_SHARE_LEFT = 0.5


def best_by_effect(values: np.ndarray, candidates: Sequence[Candidate]) -> list[int]:
    """Indices in the order of falling ``values``, one for each effect."""
    seen: set[str] = set()
    chosen = []
    for i in np.argsort(-values):
        if candidates[i].effect not in seen:
            seen.add(candidates[i].effect)
            chosen.append(int(i))
    return chosen


def order_of(fit: FitResult) -> tuple[bool, float]:
    """Models by whether a size is at an end of its physical range, then by their cost."""
    limits = fit.runs[0].size_limits
    pairs = zip(fit.candidates, fit.sizes, strict=True)
    return any(at_end(one.effect, float(size), limits(one.effect)) for one, size in pairs), fit.cost


def as_good_as(models: Sequence[FitResult]) -> float:
    """Cost above which a model is no alternative to the best of these with sizes inside their ranges."""
    within = [cost for end, cost in map(order_of, models) if not end]
    return min(within, default=np.inf) + 0.5 * EQUIVALENT


class _Look(NamedTuple):
    """Linearised refits with every candidate in the place of one effect, (C,) each."""

    likelihood_ratio: np.ndarray  #: against the model as it is
    size: np.ndarray


def _first_look(fit: FitResult, last: ScoreTest, k: int) -> _Look:
    """First look at every candidate in the place of effect ``k``."""
    inside = len(fit.sizes)
    order = [i for i in range(inside) if i != k] + [k] + list(range(inside, len(last.joint)))
    joint, _ = projected(last.joint[np.ix_(order, order)], np.zeros(len(order)), inside - 1)
    own, cross, theirs = joint[0, 0], joint[0, 1:], np.diag(joint)[1:]
    seen = np.diag(last.information) > 0.0
    theirs = np.where(seen, theirs, 1.0)
    size = fit.sizes[k]
    push = np.where(seen, cross * size, 0.0)
    return _Look(size * size * own - push * push / theirs, push / theirs)


def _seen_at_once(fit: FitResult, last: ScoreTest, k: int, own: float) -> dict[str, tuple[Candidate, float]]:
    """Candidates and sizes that a first look finds about as good as effect ``k``, of evidence ``own``."""
    look, near = _first_look(fit, last, k), max(FIRST_LOOK, _SHARE_LEFT * own)
    return {
        last.candidates[i].effect: (last.candidates[i], float(look.size[i]))
        for i in best_by_effect(-look.likelihood_ratio, last.candidates)[:REFITS]
        if look.likelihood_ratio[i] <= near
    }


def _scored_before(fit: FitResult, last: ScoreTest, first: ScoreTest) -> dict[str, tuple[Candidate, float]]:
    """Those whose scores were at least 0.6 of that of the only effect of a model before it was named.

    Where a tolerated number has taken a part of the true effect, a linear look is too far off.
    """
    strength, left = np.abs(first.z), {candidate.effect for candidate in last.candidates}
    named = [j for j, one in enumerate(first.candidates) if one.effect == fit.candidates[0].effect]
    enough = NEAR_BEST * float(np.max(strength[named], initial=0.0)) if named else np.inf
    return {
        first.candidates[i].effect: (first.candidates[i], float(first.size[i]))
        for i in best_by_effect(strength, first.candidates)[: REFITS + 1]
        if strength[i] > enough and first.candidates[i].effect in left
    }


def cause_of(
    fit: FitResult,
    last: ScoreTest,
    k: int,
    first: ScoreTest,
    confirmed: Callable[[FitResult], bool],
    stronger: Sequence[FitResult] = (),
) -> tuple[FitResult, Cause]:
    """All effects that can take the place of effect ``k``; the best of them takes it.

    Parameters
    ----------
    last, first
        Scores beside the model, and before any effect.
    confirmed
        Whether windows apart accept a model of one effect.
    stronger
        Models of one effect that explain more in all than this one did, though windows apart reject them:
        neither is certain.
    """
    own = float((fit.sizes[k] / fit.size_deviations()[k]) ** 2)
    found = [(fit.candidates[k], fit)]
    inside = {candidate.effect for candidate in fit.candidates}
    # Null simulations scatter along the difference of two models, which is not known before both are fitted.
    reach = 0.5 * EQUIVALENT * _WIDER * float(fit.size_inflation[k])

    def tried(candidate: Candidate, size: float) -> FitResult | None:
        names, values = list(fit.candidates), fit.sizes.copy()
        names[k], values[k] = candidate, size
        return refit(fit, names, values, k, min(trial.cost for _, trial in found) + reach)

    seen = _seen_at_once(fit, last, k, own)
    for effect, (candidate, size) in seen.items():
        trial = None if effect in inside else tried(candidate, size)
        if trial is not None:
            found.append((candidate, trial))
    if len(fit.candidates) == 1:
        for effect, (candidate, size) in _scored_before(fit, last, first).items():
            trial = None if effect in {*inside, *seen} else tried(candidate, size)
            best = min((one for _, one in found), key=order_of)
            if trial is not None and separation(best, trial) <= EQUIVALENT and confirmed(trial):
                found.append((candidate, trial))
    found.sort(key=lambda entry: order_of(entry[1]))
    best = found[0][1]
    alternatives = tuple(
        Alternative.of(trial, candidate, 2.0 * (trial.cost - best.cost))
        for candidate, trial in found
        if trial is best or (not order_of(trial)[0] and separation(best, trial) <= EQUIVALENT)
    )
    named = inside | {one.candidate.effect for one in alternatives}
    alternatives += tuple(
        Alternative.of(refused_one, refused_one.candidates[0], 0.0)
        for refused_one in stronger
        if refused_one.candidates[0].effect not in named and not order_of(refused_one)[0]
    )
    return best, Cause(
        alternatives=alternatives,
        likelihood_ratio=own + 2.0 * (fit.cost - best.cost),
        p_value=p_value_of_score(first, float(np.sqrt(own))),
    )


def p_value_of_score(first: ScoreTest, strength: float) -> float:
    """Bound of the share of null logs with so large a score, for all candidates together (Bonferroni)."""
    return min(len(first.candidates) * float(first.fit.tail(strength)), 1.0)
