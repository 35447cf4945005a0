"""Models fitted from the stated numbers, where the present fit has left these.

A number that has taken the place of a large effect moves others with it, and derivatives about that point
tell little of the effect: a payload may then have no score, and a late steering a small one beside the
inertia that stands for it. Effects that may be behind such a fit are fitted from what is stated, one by one,
and those that do what a number does in its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from estimators.discrepancy.model.fit import HOPELESS, begun_afresh
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.nuisances import acts
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.alternatives import NEAR_BEST, as_good_as, best_by_effect, order_of
from estimators.discrepancy.search.lower_minimum import LEFT, astray, deviations_off
from estimators.discrepancy.search.score_test import ScoreTest
from estimators.discrepancy.search.unfitted import Begin, begin_of, begins_of_pairs, looked_at
from offroad_env.effects import EFFECTS, Setup, apply
from offroad_env.errors import OffroadError

__all__ = ["fits_from_stated"]

#: Standard deviations from what is stated from which a number stands for an effect of its own, where another
#: has left its tolerance.
_SUSPECT = 2.5
#: Effects that are fitted: of the numbers furthest off, and with the largest scores beside these, as long as
#: they are near the largest; so many of them whatever they are.
_OF_NUMBERS, _OF_SCORES, _WHATEVER = 5, 8, 3
#: What costs more unfitted than so many times the least is not fitted from there: of 107 such fits in 19 logs
#: with faults 29 were of use, and these had cost at most 1.37 times the least.
_NEAR_LEAST = 1.6
#: So many effects that cost least unfitted are fitted from there.
_BEGUN = 8
#: Steps of a fit that are taken in any case.
_FIRST = 3
#: Share of what numbers have changed, squared, that an effect may leave where it takes their place exactly.
_SAME = 0.1


def fits_from_stated(scores: ScoreTest, threshold: float, *, wide: bool) -> list[FitResult]:
    """Models with one effect more, fitted from stated numbers, that explain more by as much as it must.

    None where the fit is near these numbers. Beside other effects, whose model has been fitted from stated
    numbers itself, only what numbers of their own have done is exchanged; else only if not ``wide``. A wide
    search without effects adds models of two that explain more than one by as much.
    """
    fit = scores.fit
    if not astray(fit):
        return []
    suspects = _suspects(scores)
    # Beside others a number may undo what the effect does.
    begins = [] if fit.candidates or not wide else _begins(scores, [candidate for candidate, _ in suspects])
    most = _NEAR_LEAST * min((one.cost for one in begins), default=math.inf)
    begun = {one.candidates[0].effect: one for one in begins[:_BEGUN] if one.cost < most}
    own = {candidate.effect: (candidate, numbers) for candidate, numbers in suspects}
    must, found = 0.5 * threshold**2, list[FitResult]()
    enough = fit.cost - must
    for effect in [*begun, *(one for one in own if one not in begun)]:
        trials = [_exchanged(scores, *own[effect])] if effect in own else []
        trials += [_from_stated(fit, begun[effect], enough)] if effect in begun else []
        useful = [one for one in trials if one is not None and one.cost + _released(fit, one) < enough]
        if useful:
            found.append(min(useful, key=order_of))
            enough = min(enough, as_good_as(found))
    least = min([fit.cost, *(one.cost for one in found)]) - must
    pairs = [_from_stated(fit, one, least) for one in begins_of_pairs(fit, begins)]
    return [*found, *(one for one in pairs if one is not None and one.cost + _released(fit, one) < least)]


def _released(fit: FitResult, trial: FitResult) -> float:
    """Log-likelihood that a model gains by what is stated alone, where no number is beyond suspicion.

    Noise moves a number by 4 deviations in one null log of 60, and an effect that does the same is free:
    what the number costs is then no evidence for it.
    """
    if np.any(deviations_off(fit) > LEFT):
        return 0.0
    before, after = (fit.problem.nuisance_prior_cost(model.point) for model in (fit, trial))
    return max(before - after, 0.0)


def _begins(scores: ScoreTest, suspects: Sequence[Candidate]) -> list[Begin]:
    """Where fits of suspected effects begin, and of others; those first that cost least before."""
    fit, names = scores.fit, {one.effect for one in suspects}
    known = [begin for one in suspects if (begin := begin_of(fit, one)) is not None]
    if known:
        best = [scores.candidates[i] for i in best_by_effect(np.abs(scores.z), scores.candidates)]
        n = min(known, key=lambda one: one.cost).n
        known += looked_at(fit, [one for one in best if one.effect not in names], n)
    return sorted(known, key=lambda one: one.cost)


def _from_stated(fit: FitResult, begin: Begin, enough: float) -> FitResult | None:
    """The model with these effects; None without.

    Parameters
    ----------
    enough
        What cannot cost less is not fitted to the end. The first steps are taken in any case: far from the
        data the equations promise too little.
    """
    try:
        rough = begun_afresh(fit, begin.candidates, begin.sizes, n=begin.n, numbers=False)
        closer = GaussNewton(rounds=_FIRST).descend(replace(rough, jacobian=Jacobian()))
        if closer.cost > HOPELESS * fit.cost:
            return None
        return GaussNewton(enough=enough).descend(closer, fresh=False)
    except OffroadError:
        return None


def _exchanged(scores: ScoreTest, candidate: Candidate, numbers: Sequence[int]) -> FitResult | None:
    """The model with an effect in the place of what numbers of its own have done; None if it breaks down."""
    fit, own = scores.fit, scores.candidates.index(candidate) - len(scores.candidates)
    if not numbers:
        return None
    low, high = fit.runs[0].size_limits(candidate.effect)
    size = _doing_the_same(fit, candidate, numbers)
    if size is None:
        trace, done = scores.white[:, own], scores.white[:, list(numbers)] @ fit.nuisances[list(numbers)]
        size = float(trace @ done) / max(float(trace @ trace), 1e-300)
    nuisances = fit.nuisances.copy()
    nuisances[list(numbers)] = 0.0
    sizes = np.append(fit.sizes, min(max(size, low), high))
    point = replace(fit.point, nuisances=nuisances, candidates=(*fit.candidates, candidate), sizes=sizes)
    try:
        return GaussNewton().descend(fit.moved(point))
    except OffroadError:
        return None


def _doing_the_same(fit: FitResult, candidate: Candidate, numbers: Sequence[int]) -> float | None:
    """The size at which an effect makes of vehicle and soil what numbers have; None if it does not act on it.

    By traces in the data a friction angle would begin at two thirds of what its number has done: they are
    far from linear in it, and windows that a vehicle then drives otherwise hide the rest.
    """
    setups: list[tuple[Setup, np.ndarray, np.ndarray]] = []
    for run in fit.runs:
        there = run.setup
        for k in numbers:
            if acts(fit.problem.nuisances[k], run):
                there = fit.problem.nuisances[k].change(there, run, float(fit.nuisances[k]))
        setups.append((run.setup, run.setup.stated_numbers(), there.stated_numbers()))
    reach = EFFECTS[candidate.effect].plausible(fit.runs[0].setup.plant.vehicle)
    low, high = (limit / reach for limit in fit.runs[0].size_limits(candidate.effect))

    def missing(share: np.ndarray) -> np.ndarray:
        """Of what the numbers have changed, as shares of these changes."""
        values, rest = candidate.values(float(share[0]) * reach), []
        for setup, before, after in setups:
            moved = after != before
            now = apply(setup, [(candidate.effect, values)]).stated_numbers()
            rest.append((after - now)[moved] / (after - before)[moved])
        return np.concatenate(rest)

    nothing = missing(np.zeros(1))
    if not nothing.size or not low <= 0.0 <= high or not low < high:
        return None
    found = least_squares(missing, [0.0], bounds=(low, high))
    return float(found.x[0]) * reach if 2.0 * found.cost < _SAME * float(nothing @ nothing) else None


def _suspects(scores: ScoreTest) -> list[tuple[Candidate, tuple[int, ...]]]:
    """Effects that may be behind the fit, and numbers that stand for them."""
    fit, away = scores.fit, deviations_off(scores.fit)
    by_effect = {scores.candidates[i].effect: i for i in best_by_effect(np.abs(scores.z), scores.candidates)}
    found: dict[int, tuple[int, ...]] = {}
    for k in np.argsort(-away):
        i = by_effect.get(fit.problem.nuisances[k].effect)
        if away[k] > _SUSPECT and i is not None and (i in found or len(found) < _OF_NUMBERS):
            found[i] = (*found.get(i, ()), int(k))
    strength = np.abs(scores.z)
    for place, i in enumerate(list(by_effect.values())[:_OF_SCORES]):
        if place < _WHATEVER or strength[i] > NEAR_BEST * strength.max():
            found.setdefault(i, ())
    return [(scores.candidates[i], numbers) for i, numbers in found.items()]
