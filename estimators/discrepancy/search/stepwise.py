"""Which effects together explain a drive: forward, backward and swap steps with full refits."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.fit import settled, with_null_simulations
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.protocol import ForwardModel
from estimators.discrepancy.search.acceptance import (
    IMPOSSIBLE,
    LARGE,
    TESTED,
    Accepted,
    Bars,
    Refuted,
    accepted_of,
    confirmed,
    support_of,
)
from estimators.discrepancy.search.alternatives import (
    FIRST_LOOK,
    NEAR_BEST,
    REFITS,
    as_good_as,
    best_by_effect,
    cause_of,
    order_of,
)
from estimators.discrepancy.search.finite_delays import delayed
from estimators.discrepancy.search.from_stated import fits_from_stated
from estimators.discrepancy.search.holdout import HoldOutTest
from estimators.discrepancy.search.lower_minimum import (
    LEFT,
    begun_again,
    beside_rejected,
    lower_minimum,
    strayed,
)
from estimators.discrepancy.search.pair_search import Proposal, linearised_gain, proposed_pairs
from estimators.discrepancy.search.refitting import refit
from estimators.discrepancy.search.result import (
    EQUIVALENT,
    Cause,
    SearchResult,
    separation,
)
from estimators.discrepancy.search.score_test import (
    ScoreTest,
    candidates_for,
    refined_places,
    score_test,
    score_threshold,
)
from offroad_env.effects import EFFECTS

__all__ = ["MOST", "outside", "scored_only", "search", "without_cause"]

#: Most effects in one model.
MOST = 4
#: Fitted windows and those apart together must show more than noise does in this share of the logs in which
#: the first scores may find something. With twice these two shares 11 of 300 natural logs gave a false alarm.
_CONFIRMED = 0.2
#: Share of null logs with a first score that is a discrepancy although no effect that is tried explains it.
_BEYOND = 0.005
#: How often a search may begin again from a better minimum.
_RESTARTS = 2


def outside(fit: FitResult, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates whose effects are not in the model."""
    inside = {candidate.effect for candidate in fit.candidates}
    return [candidate for candidate in candidates if candidate.effect not in inside]


def _forward(scores: ScoreTest, threshold: float, enough: float) -> list[FitResult]:
    """Models with one effect more, best first; ``enough`` as of `_refitted`."""
    fit, strength = scores.fit, np.abs(scores.z)
    order = best_by_effect(strength, scores.candidates)
    top = strength[order[0]] if order else 0.0
    if not top > threshold:
        return []
    order = [i for i in order if strength[i] > max(threshold, NEAR_BEST * top)][:REFITS]
    larger = [((*fit.candidates, scores.candidates[i]), (*fit.sizes, scores.size[i])) for i in order]
    return _refitted(fit, larger, enough)


def _refitted(
    fit: FitResult, proposals: Sequence[tuple[Sequence[Candidate], Sequence[float]]], enough: float = np.inf
) -> list[FitResult]:
    """The models of these effects and sizes fitted, best first; what breaks down is left out.

    Last are those with a size at an end of its physical range, which is never named: what is as good within
    its range comes first. What cannot cost less than ``enough`` is not fitted to the end.
    """
    trials = []
    for candidates, sizes in proposals:
        late = [i for i, candidate in enumerate(candidates) if EFFECTS[candidate.effect].family == "timing"]
        done = refit(fit, candidates, sizes, late[-1] if late else -1, enough)
        if done is not None:
            trials.append(done)
    return sorted(trials, key=order_of)


def _pairs(
    scores: ScoreTest,
    threshold: float,
    most: float,
    enough: float,
    known: Collection[frozenset[str]] = (),
) -> list[FitResult]:
    """Models with one effect more (two, if there is none yet), of which one present effect may be left out.

    Parameters
    ----------
    most
        Gain of the best model with so many effects less one, in twice the log-likelihood.
    enough
        Cost above which a model is of no use.
    known
        Sets of names that are fitted already.
    """
    fit = scores.fit
    inside = range(len(fit.sizes))
    bases = [[i for i in inside if i != k] for k in inside] or [[]]
    found = [proposal for base in bases for proposal in proposed_pairs(fit, scores, base, REFITS)]
    found = [proposal for proposal in found if proposal.gain > most + threshold**2]
    best = max((proposal.gain for proposal in found), default=0.0)
    near: dict[frozenset[str], Proposal] = {}
    for one in sorted(found, key=lambda one: -one.gain):
        names = _names(one.candidates)
        if one.gain > best - FIRST_LOOK and names not in known and len(near) < REFITS:
            near.setdefault(names, one)
    return _refitted(fit, [(one.candidates, one.sizes) for one in near.values()], enough)


def _larger(
    scores: ScoreTest, threshold: float, test: HoldOutTest, begun: Sequence[FitResult], singly: bool
) -> list[FitResult]:
    """Models that explain more by as much as an effect must: the best, and those as good, best first.

    Parameters
    ----------
    begun
        Models with one effect more that are fitted already.
    singly
        A first effect is sought alone, not as one of two.
    """
    fit = scores.fit
    left = outside(fit, scores.candidates)
    inside = len(fit.candidates)
    news = [one for one in begun if all(new in left for new in one.candidates[inside:])]
    begun, double = ([one for one in news if len(one.candidates) == inside + k] for k in (1, 2))
    near = _forward(scores, threshold, as_good_as(begun))
    single = [*begun, *near, *delayed(fit, left, threshold)]
    single.sort(key=order_of)
    if not fit.candidates and (singly or not single):
        return single
    most = linearised_gain(fit, scores) if fit.candidates else float(np.max(scores.z**2, initial=0.0))
    # A pair must be better by as much as an effect must, or else as good as what is there.
    must = 0.5 * threshold**2
    if not fit.candidates:
        pairs = sorted([*double, *_pairs(scores, threshold, most, single[0].cost - must)], key=order_of)
        return pairs if pairs and _replaces(pairs[0], single[0], threshold, test) else single
    enough = single[0].cost + 0.5 * EQUIVALENT if single else fit.cost - must
    known = {_names(trial.candidates) for trial in single}
    pairs = _pairs(scores, threshold, most, enough, known)
    trials = sorted([*single, *(trial for trial in pairs if trial.cost < enough)], key=order_of)
    return [trial for trial in trials if 2.0 * (trial.cost - trials[0].cost) <= EQUIVALENT]


def _names(candidates: Sequence[Candidate]) -> frozenset[str]:
    return frozenset(candidate.effect for candidate in candidates)


def _replaces(pair: FitResult, single: FitResult, threshold: float, test: HoldOutTest) -> bool:
    """Whether two effects take the place of one, that need not be among them.

    The second must be significant in the fitted windows, where road and soil scatter along the difference of
    the models, and the windows apart must reject the one; or not the two, where the difference is large.
    """
    apart = separation(pair, single)
    if apart <= threshold**2:
        return False
    result = test.result(pair, single)
    large = apart > (LARGE * threshold) ** 2
    return result is None or result.surpasses or (large and not result.contradicts)


def _onward(test: HoldOutTest, last: ScoreTest, bar: float, rate: float, wide: bool) -> Accepted:
    """The next larger model: ``bar`` is the least score, ``rate`` that of the first scores."""
    last = refined_places(last, LARGE * bar, NEAR_BEST)
    strongest, inside = float(np.abs(last.z).max(initial=0.0)), test.fit.candidates
    # Where hardly a null log has such a score, a discrepancy remains whatever comes after a refusal: the next
    # best explanation costs no false alarm.
    beyond = not inside and strongest > score_threshold(last, _BEYOND)
    gains: list[float] = []
    rejected = frozenset[str]()
    others: tuple[tuple[FitResult, float], ...] = ()
    refuted: tuple[Refuted, ...] = ()
    left: tuple[FitResult, ...] = ()
    singly = pair_refused = False
    begun = fits_from_stated(last, bar, wide=wide)
    while True:
        trials = _larger(last, bar, test, begun, singly)
        # The first name is the best or none; later ones may be any that explain as much.
        tried = trials if inside else trials[:1]
        accepted = accepted_of(test, tried, Bars(bar, score_threshold(last, _CONFIRMED * rate)))
        gains += accepted.gains
        others += accepted.others
        refuted += accepted.refuted
        left += accepted.settled
        if accepted.fit is not None:
            return accepted._replace(gains=gains, refused=False, rejected=rejected, others=others)
        if not inside and not singly and trials and len(trials[0].candidates) > 1:
            # Of two effects that explain most together one may be certain, and the other too small.
            singly, pair_refused = True, accepted.refused
            continue
        again = beyond and bool(accepted.gains) and len(gains) < TESTED
        if not trials or (accepted.gains and not again):
            refused = accepted.refused or pair_refused or beyond
            return Accepted(None, gains, refused=refused, refuted=refuted, settled=left)
        # What looked best is not significant once it is fitted; what it was confounded with may be.
        names = {candidate.effect for candidate in inside}
        gone = {candidate.effect for trial in tried for candidate in trial.candidates} - names
        rejected |= gone if again else frozenset()
        gone = gone if again else gone | {c.effect for trial in trials for c in trial.candidates} - names
        last = score_test(last.fit, [c for c in last.candidates if c.effect not in gone])


def search(
    nominal: FitResult,
    library: Sequence[str],
    rate: float,
    apart: Sequence[ForwardModel] = (),
    *,
    restarts: int = _RESTARTS,
    wide: bool = False,
) -> SearchResult:
    """Find the effects that are wrong in a drive.

    Not as `search_rig`: a refit takes seconds, so scores choose the models, and a hold-out test weighs each.

    Parameters
    ----------
    nominal
        Fitted, with its noise.
    library
        Effects among which causes are sought.
    rate
        Share of null logs in which the first scores may find something.
    apart
        Windows of the hold-out tests; an effect that they reject ends the search.
    restarts
        How often it may begin again, where an effect leads to a better minimum of a model without it.
    wide
        First effects are also fitted from stated numbers, one by one and in pairs: that takes a minute.
    """
    candidates = candidates_for(nominal, library)
    first = last = score_test(_well_begun(nominal), candidates)
    threshold = bar = score_threshold(first, rate)
    fit, refused, gains = first.fit, False, list[float]()
    stronger: tuple[FitResult, ...] = ()
    begin = test = HoldOutTest(fit, apart)
    certain: HoldOutTest | None = None
    while len(fit.candidates) < MOST:
        accepted = _onward(test, last, bar, rate, wide)
        larger = None if accepted.step is None else begun_again(accepted.step)
        gains = gains + accepted.gains
        refused = accepted.refused and larger is None
        lower = _lower(fit, larger, accepted.settled, bar) if restarts else None
        if lower is not None and not lower.candidates:
            return search(lower, library, rate, apart, restarts=restarts - 1, wide=wide)
        if larger is None:
            break
        certain = certain or (HoldOutTest(fit, apart) if accepted.fit is None else None)
        if lower is not None:
            restarts, stronger = restarts - 1, ()
            last, test = score_test(lower, outside(lower, candidates)), HoldOutTest(lower, apart)
            fit = last.fit
            continue
        stronger = stronger if fit.candidates else accepted.stronger
        candidates = [c for c in candidates if c.effect not in accepted.rejected]
        last = score_test(larger, outside(larger, candidates))
        same = larger is accepted.fit
        fit, test = last.fit, test.onward(larger) if same else HoldOutTest(larger, apart)
        bar = score_threshold(last, rate)
    found = SearchResult(
        nominal=first.fit,
        extended=fit,
        first=first,
        last=last,
        threshold=threshold,
        holdout_gains=tuple(gains),
        refused=refused,
        capped=len(fit.candidates) == MOST and float(np.abs(last.z).max(initial=0.0)) > bar,
    )
    return _with_causes(found, rate, begin, certain, stronger)


def _lower(
    fit: FitResult, larger: FitResult | None, rejected: Sequence[FitResult], bar: float
) -> FitResult | None:
    """A lower minimum of a model, beside the next one, or of the nominal one beside what was rejected."""
    if larger is not None:
        return lower_minimum(fit, larger, bar)
    return None if fit.candidates else beside_rejected(fit, rejected, bar)


def _with_causes(
    found: SearchResult,
    rate: float,
    begin: HoldOutTest,
    certain: HoldOutTest | None,
    stronger: Sequence[FitResult],
) -> SearchResult:
    """The result with its causes, and which of them windows apart contradict.

    Parameters
    ----------
    rate
        As that of `search`.
    begin, certain
        Tests of models that are larger than the nominal one, and than the last that windows apart confirm
        before they contradict one; None if they contradict none.
    stronger
        As of `_causes`.
    """
    fit, first = found.extended, found.first
    enough = 0.5 * score_threshold(first, _CONFIRMED * rate) ** 2
    uncertain = () if certain is None else _uncertain(fit, _Confirmed(certain.fit, certain, enough))
    refused = found.refused or bool(uncertain)
    fit, causes = _causes(fit, found.last, first, _Confirmed(first.fit, begin, enough), stronger)
    return replace(
        found,
        extended=fit,
        refused=refused,
        beyond_null_logs=refused and float(np.abs(first.z).max()) > score_threshold(first, _BEYOND),
        strayed=tuple(strayed(fit, LEFT if fit.candidates else IMPOSSIBLE)),
        causes=causes,
        uncertain=uncertain,
    )


def _well_begun(nominal: FitResult) -> FitResult:
    """The nominal model with its null simulations, at the better minimum if numbers have left tolerances."""
    other = begun_again(nominal)
    return with_null_simulations(nominal if other is nominal else replace(other, null=None))


class _Confirmed:
    """Whether windows apart accept a larger model than ``fit``, whatever the noise in which it is fitted."""

    def __init__(self, fit: FitResult, test: HoldOutTest, enough: float) -> None:
        self.fit, self._test, self._enough = fit, test, enough

    def __call__(self, larger: FitResult) -> bool:
        """Of this model; its gain is that in the noise of the smaller one."""
        beside = replace(larger, noise=self.fit.noise, null=self.fit.null)
        result = self._test.result(larger)
        return result is None or confirmed(result, support_of(self.fit, beside, larger), self._enough)


def _uncertain(fit: FitResult, confirmed: _Confirmed) -> tuple[int, ...]:
    """Places of effects that windows apart contradict, also all of them together."""
    known = {candidate.effect for candidate in confirmed.fit.candidates}
    new = tuple(k for k, candidate in enumerate(fit.candidates) if candidate.effect not in known)
    return () if not new or confirmed(fit) else new


def _causes(
    fit: FitResult,
    last: ScoreTest,
    first: ScoreTest,
    confirmed: _Confirmed,
    stronger: Sequence[FitResult],
) -> tuple[FitResult, tuple[Cause, ...]]:
    """The model with the best of every cause's alternatives, and the causes; ``stronger`` of the first."""
    causes = []
    for k in range(len(fit.candidates)):
        fit, cause = cause_of(fit, last, k, first, confirmed, () if k else stronger)
        causes.append(cause)
    return fit, tuple(causes)


def without_cause(
    found: SearchResult, left_out: int, apart: Sequence[ForwardModel], rate: float
) -> SearchResult:
    """A result with one cause less, whose effect takes no other's place either.

    What it explained remains, so that the result counts as one with a refused effect.

    Parameters
    ----------
    left_out
        Place of the cause.
    apart, rate
        As those of the search.
    """
    fit, first = found.extended, found.first
    keep = [k for k in range(len(fit.sizes)) if k != left_out]
    smaller = settled(fit.with_effects([fit.candidates[k] for k in keep], fit.sizes[keep]), fresh=False)
    others = [one for one in first.candidates if one.effect != fit.candidates[left_out].effect]
    enough = 0.5 * score_threshold(first, _CONFIRMED * rate) ** 2
    confirmed = _Confirmed(found.nominal, HoldOutTest(found.nominal, apart), enough)
    scores = score_test(smaller, outside(smaller, others))
    smaller, causes = _causes(smaller, scores, first, confirmed, ())
    last = score_test(smaller, outside(smaller, first.candidates))
    away, uncertain = tuple(strayed(smaller, LEFT)), [keep.index(k) for k in found.uncertain if k in keep]
    return replace(
        found,
        extended=smaller,
        last=last,
        causes=causes,
        refused=True,
        capped=False,
        strayed=away,
        uncertain=tuple(uncertain),
    )


def scored_only(nominal: FitResult, library: Sequence[str], rate: float) -> SearchResult:
    """The first scores and nothing else, where a search breaks down."""
    first = score_test(with_null_simulations(nominal), candidates_for(nominal, library))
    return SearchResult(
        nominal=first.fit,
        extended=first.fit,
        first=first,
        last=first,
        threshold=score_threshold(first, rate),
    )
