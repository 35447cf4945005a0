"""Which effects together explain the trials of a rig: every candidate refitted, with noise of its own.

On a rig effects are far from linear: the score at the nominal model has little information about an effect
that trebles the sinkage. A refit takes a fraction of a second here, so scores only decide whether there is
anything to find, and likelihoods, each with the noise that its own fit leaves, decide what. That is why the
loop of `stepwise.search`, which chooses by linearised scores, is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.physical_ranges import at_end
from estimators.discrepancy.rig.fit import held_out_trials
from estimators.discrepancy.rig.repeat_noise import rig_noise
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from estimators.discrepancy.search.alternatives import p_value_of_score
from estimators.discrepancy.search.result import EQUIVALENT, Alternative, Cause, SearchResult
from estimators.discrepancy.search.score_test import ScoreTest, candidates_for, score_test, score_threshold
from estimators.discrepancy.search.stepwise import MOST, outside
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = [
    "deviance",
    "holdout_gain",
    "pruned",
    "scored_only",
    "search_rig",
    "stand_ins",
    "without_stand_ins",
]

#: Passes of exchanging one effect for another, and the gain that pays for one, in twice the log-likelihood.
_SWAPS, _WORTH_A_SWAP = 4, 1.0
#: Sizes to descend from, in plausible sizes, besides what the score proposes.
_STARTS = (-1.0, 1.0)
#: Steps of a first look at a candidate, and how many of the best are fitted in full.
_ROUGHLY, _PROMISING = 4, 4
#: Gain of an effect without which the model has no solution, in twice the log-likelihood.
_INDISPENSABLE = 1e6
#: The score proposes at most so many plausible sizes.
_REACH = 2.0


class _Trial(NamedTuple):
    """A refitted model."""

    deviance: float  #: twice minus the log-likelihood
    number: int  #: of the candidate, or of the effect that was left out; settles ties
    fit: FitResult


def deviance(fit: FitResult) -> float:
    """Twice minus the log-likelihood, with the noise of this fit."""
    return 2.0 * fit.minus_log_likelihood


def scores_of(fit: FitResult, candidates: Sequence[Candidate]) -> ScoreTest:
    """Scores in the noise that a smooth error of the model is not counted in."""
    noise = rig_noise(fit).for_detection(fit.residual)
    return score_test(replace(fit, noise=noise), candidates)


def stand_ins(fit: FitResult) -> list[int]:
    """Effects whose size is at an end of its physical range: they stand in for something else."""
    run = trials_of(fit.runs)
    pairs = enumerate(zip(fit.candidates, fit.sizes, strict=True))
    return [k for k, (c, size) in pairs if at_end(c.effect, float(size), run.size_limits(c.effect))]


def without_stand_ins(fit: FitResult) -> FitResult:
    """The model without effects that are at an end of their physical ranges.

    Raises
    ------
    SolverFailure
        When a contact has no solution without them.
    """
    while wrong := stand_ins(fit):
        fit = _without(fit, wrong[0])
    return fit


def _best(trials: Iterable[_Trial]) -> _Trial | None:
    return min(trials, key=lambda trial: trial[:2], default=None)


def _first_look(fit: FitResult, candidates: Sequence[Candidate], sizes: Sequence[float]) -> FitResult | None:
    """The model with these effects after one descent, the last from several sizes; None if it breaks down."""
    effect = EFFECTS[candidates[-1].effect]
    reach = effect.plausible(fit.runs[0].setup.plant.vehicle)
    first = float(np.clip(sizes[-1], -_REACH * reach, _REACH * reach))
    trials = []
    low, high = trials_of(fit.runs).size_limits(effect.id)
    for size in {
        min(max(own, low), high) for own in (first, *(effect.size.off + s * reach for s in _STARTS))
    }:
        try:
            trials.append(fit.with_effects(candidates, [*sizes[:-1], size]))
        except OffroadError:
            continue
    if not trials:
        return None
    try:
        return (
            GaussNewton(rounds=_ROUGHLY)
            .descend(min(trials, key=lambda trial: trial.cost))
            .with_learned_noise()
        )
    except OffroadError:
        return None


def _without(fit: FitResult, k: int) -> FitResult:
    """The model fitted without effect ``k``."""
    keep = [i for i in range(len(fit.candidates)) if i != k]
    return settled(fit.with_effects([fit.candidates[i] for i in keep], fit.sizes[keep]))


def _with_one_more(fit: FitResult, kept: Sequence[int], candidates: Sequence[Candidate]) -> list[_Trial]:
    """The effects ``kept`` of a fit with each of the most promising candidates, best first."""
    names, sizes = [fit.candidates[i] for i in kept], fit.sizes[list(kept)]
    inside = {candidate.effect for candidate in names}
    looks, found = [], []
    for i, candidate in enumerate(candidates):
        if candidate.effect in inside:
            continue
        seen = _first_look(fit, [*names, candidate], [*sizes, EFFECTS[candidate.effect].size.off])
        if seen is not None:
            looks.append(_Trial(deviance(seen), i, seen))
    for look in sorted(looks, key=lambda trial: trial[:2])[:_PROMISING]:
        try:
            done = settled(look.fit)
        except OffroadError:
            continue
        if not stand_ins(done):
            found.append(_Trial(deviance(done), look.number, done))
    return sorted(found, key=lambda trial: trial[:2])


def _exchanged(fit: FitResult, candidates: Sequence[Candidate]) -> FitResult:
    """The model after every exchange of one effect for another that explains clearly more."""
    # A single effect has been chosen among all just now.
    for _ in range(_SWAPS if len(fit.candidates) > 1 else 0):
        trials = []
        for k in range(len(fit.candidates)):
            others = [i for i in range(len(fit.candidates)) if i != k]
            trials += [trial._replace(number=k) for trial in _with_one_more(fit, others, candidates)[:1]]
        best = _best(trials)
        if best is None or best.deviance > deviance(fit) - _WORTH_A_SWAP:
            break
        fit = best.fit
    return fit


def pruned(fit: FitResult, threshold: float) -> FitResult:
    """Without the effects whose likelihood-ratio statistics are below the squared threshold."""
    while fit.candidates:
        trials = []
        for k in range(len(fit.candidates)):
            try:
                without = _without(fit, k)
            except OffroadError:
                continue
            trials.append(_Trial(deviance(without), k, without))
        best = _best(trials)
        if best is None or best.deviance - deviance(fit) > threshold**2:
            break
        fit = best.fit
    try:
        return without_stand_ins(fit)
    except OffroadError:
        return fit


def holdout_gain(fit: FitResult, larger: FitResult, apart: RigModel) -> float:
    """Gain of a larger model on trials apart, in the log-likelihood.

    Both in the scatter that the larger one leaves where it was fitted: an imperfect model errs more on
    conditions to which it was not fitted, which must not count against a close fit.
    """
    noise = rig_noise(larger)
    return held_out_trials(fit, apart, noise).cost - held_out_trials(larger, apart, noise).cost


def search_rig(
    nominal: FitResult,
    library: Sequence[str],
    rate: float,
    apart: RigModel | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> SearchResult:
    """Find the effects that are wrong in trials.

    Parameters
    ----------
    nominal
        Fitted, with its noise.
    library
        Effects among which causes are sought.
    rate
        Share of null logs in which the first scores may find something.
    apart
        Trials of the hold-out test: every step must gain on them too, or it is refused and the search ends.
    progress
        Called once the scores are known, before the long part.
    """
    candidates = candidates_for(nominal, library)
    first = last = scores_of(nominal, candidates)
    threshold = score_threshold(first, rate)
    progress("search")
    fit = nominal
    gains: list[float] = []
    while len(fit.candidates) < MOST and np.abs(last.z).max(initial=0.0) > threshold:
        trials = _with_one_more(fit, range(len(fit.candidates)), candidates)
        if not trials or deviance(fit) - trials[0].deviance < threshold**2:
            break
        larger = pruned(_exchanged(trials[0].fit, candidates), threshold)
        if deviance(fit) - deviance(larger) < _WORTH_A_SWAP:
            # What was added went again: the step would be the same for ever.
            break
        if apart is not None:
            gains.append(holdout_gain(fit, larger, apart))
            if gains[-1] <= 0.0:
                break
        fit = larger
        last = scores_of(fit, outside(fit, candidates))
    return SearchResult(
        nominal=nominal,
        extended=fit,
        first=first,
        last=last,
        threshold=threshold,
        holdout_gains=tuple(gains),
        refused=not fit.candidates and float(np.abs(first.z).max(initial=0.0)) > threshold,
        causes=tuple(_cause(fit, k, candidates, first) for k in range(len(fit.candidates))),
    )


def scored_only(nominal: FitResult, library: Sequence[str], rate: float) -> SearchResult:
    """The scores of all effects, without a search."""
    first = scores_of(nominal, candidates_for(nominal, library))
    threshold = score_threshold(first, rate)
    return SearchResult(nominal=nominal, extended=nominal, first=first, last=first, threshold=threshold)


def _cause(fit: FitResult, k: int, candidates: Sequence[Candidate], first: ScoreTest) -> Cause:
    """All effects that can take the place of effect ``k``; it is the best of them."""
    others = [i for i in range(len(fit.candidates)) if i != k]
    own = deviance(fit)
    try:
        gain = deviance(_without(fit, k)) - own
    except OffroadError:
        # The soil of the model cannot support the wheel without it.
        gain = _INDISPENSABLE
    alternatives = [Alternative.of(fit, fit.candidates[k], 0.0)]
    left = outside(fit, candidates)
    for trial in _with_one_more(fit, others, left):
        if trial.deviance - own <= EQUIVALENT:
            lacks = max(trial.deviance - own, 0.0)
            alternatives.append(Alternative.of(trial.fit, left[trial.number], lacks))
    return Cause(
        alternatives=tuple(alternatives),
        likelihood_ratio=float(gain),
        p_value=p_value_of_score(first, np.sqrt(max(gain, 0.0))),
    )
