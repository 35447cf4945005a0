"""Which effects together explain the trials of a rig: every candidate refitted, with noise of its own.

A rig's effects bend: at the nominal model a score says little about an effect that trebles the sinkage. A
refit takes a fraction of a second here, so scores only decide whether there is anything to find, and
likelihoods, each with the noise that its own fit leaves, decide what.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import norm

from estimators.discrepancy.fit import Candidate, settle
from estimators.discrepancy.rig_fit import RigFit, held_out_trials
from estimators.discrepancy.rig_model import RigModel
from estimators.discrepancy.screen import Screen, candidates_for, chance_threshold, screen
from estimators.discrepancy.search import ALIKE, Cause, Rival, Search
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["search_rig"]

#: Most effects that are named together.
_MOST = 4
#: Passes of exchanging one effect for another.
_SWAPS = 4
#: Sizes to descend from, in plausible sizes, besides what the score proposes.
_STARTS = (-1.0, 1.0)


def loss(fit: RigFit) -> float:
    """Twice minus the log-likelihood at the present point, with the noise of this fit."""
    return 2.0 * (fit.cost_of(fit.residual()) + fit.whitener.log_scale())


def _settled(fit: RigFit, candidates: Sequence[Candidate], sizes: Sequence[float]) -> RigFit | None:
    """The model with these effects fitted, the last from several sizes; None if it breaks down."""
    effect = EFFECTS[candidates[-1].effect]
    reach = effect.plausible(fit.runs[0].setup.plant.vehicle)
    first = float(np.clip(sizes[-1], -2.0 * reach, 2.0 * reach))
    trials = []
    for size in (first, *(effect.size.off + share * reach for share in _STARTS)):
        trial = fit.with_effects(candidates, [*sizes[:-1], size])
        try:
            trials.append((trial.cost_of(trial.residual()), len(trials), trial))
        except OffroadError:
            continue
    if not trials:
        return None
    best = min(trials)[2]
    try:
        settle(best, white=fit.white)
    except OffroadError:
        return None
    return best


def _with_one_more(
    fit: RigFit, kept: Sequence[int], candidates: Sequence[Candidate]
) -> list[tuple[float, int, RigFit]]:
    """The effects ``kept`` of a fit and each candidate: (loss, number of the candidate, fit), best first."""
    names, sizes = [fit.candidates[i] for i in kept], fit.sizes[list(kept)]
    inside = {candidate.effect for candidate in names}
    found = []
    for i, candidate in enumerate(candidates):
        if candidate.effect in inside:
            continue
        done = _settled(fit, [*names, candidate], [*sizes, EFFECTS[candidate.effect].size.off])
        if done is not None:
            found.append((loss(done), i, done))
    return sorted(found, key=lambda entry: entry[:2])


def _exchanged(fit: RigFit, candidates: Sequence[Candidate]) -> RigFit:
    """The model after every exchange of one effect for another that explains clearly more."""
    # A single effect has been chosen among all just now.
    for _ in range(_SWAPS if len(fit.candidates) > 1 else 0):
        before = loss(fit)
        trials = []
        for k in range(len(fit.candidates)):
            others = [i for i in range(len(fit.candidates)) if i != k]
            trials += [(entry[0], k, entry[2]) for entry in _with_one_more(fit, others, candidates)[:1]]
        if not trials or min(trials, key=lambda entry: entry[:2])[0] > before - 1.0:
            break
        fit = min(trials, key=lambda entry: entry[:2])[2]
    return fit


def _pruned(fit: RigFit, threshold: float) -> RigFit:
    """Without the effects that no longer earn their place."""
    while fit.candidates:
        trials = []
        for k in range(len(fit.candidates)):
            keep = [i for i in range(len(fit.candidates)) if i != k]
            trial = fit.with_effects([fit.candidates[i] for i in keep], fit.sizes[keep])
            try:
                settle(trial, white=fit.white)
            except OffroadError:
                continue
            trials.append((loss(trial), k, trial))
        if not trials:
            break
        best = min(trials, key=lambda entry: entry[:2])
        if best[0] - loss(fit) > threshold**2:
            break
        fit = best[2]
    return fit


def _gain_apart(fit: RigFit, larger: RigFit, apart: RigModel) -> float:
    """How much nearer a larger model comes to trials apart, in the log-likelihood.

    Both in the scatter that the larger one leaves where it was fitted: an imperfect model errs more on
    conditions that it has not seen, and must not be punished for having been fitted closely.
    """
    noise = larger.whitener.noise
    return held_out_trials(fit, apart, noise).cost - held_out_trials(larger, apart, noise).cost


def search_rig(
    nominal: RigFit,
    library: Sequence[str],
    rate: float,
    apart: RigModel | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Search:
    """Find what is wrong.

    Parameters
    ----------
    nominal
        Fitted, with its noise.
    library
        Effects that may be named.
    rate
        Share of logs with nothing wrong in which the first screen may find something.
    apart
        Trials on which every step must gain too, or it is refused and the search ends.
    progress
        Called once the scores are known, before the long part.
    """
    candidates = candidates_for(nominal, library)
    first = last = screen(nominal, candidates)
    threshold = chance_threshold(first, rate)
    progress("search")
    fit, gate = nominal, []
    while len(fit.candidates) < _MOST and np.abs(last.z).max(initial=0.0) > threshold:
        trials = _with_one_more(fit, range(len(fit.candidates)), candidates)
        if not trials or loss(fit) - trials[0][0] < threshold**2:
            break
        larger = _pruned(_exchanged(trials[0][2], candidates), threshold)
        if apart is not None:
            gate.append(_gain_apart(fit, larger, apart))
            if gate[-1] <= 0.0:
                break
        fit = larger
        inside = {candidate.effect for candidate in fit.candidates}
        last = screen(fit, [c for c in candidates if c.effect not in inside])
    causes = tuple(_cause(fit, k, candidates, first) for k in range(len(fit.candidates)))
    return Search(
        nominal=nominal,
        extended=fit,
        first=first,
        last=last,
        threshold=threshold,
        gate=tuple(gate),
        causes=causes,
    )


def _cause(fit: RigFit, k: int, candidates: Sequence[Candidate], first: Screen) -> Cause:
    """All effects that can stand in the place of effect ``k``; it is the best of them."""
    others = [i for i in range(len(fit.candidates)) if i != k]
    own = loss(fit)
    without = fit.with_effects([fit.candidates[i] for i in others], fit.sizes[others])
    settle(without, white=fit.white)
    delta = loss(without) - own
    rivals = [Rival.of(fit, fit.candidates[k], 0.0)]
    inside = {candidate.effect for candidate in fit.candidates}
    outside = [candidate for candidate in candidates if candidate.effect not in inside]
    for value, i, trial in _with_one_more(fit, others, outside):
        if value - own <= ALIKE:
            rivals.append(Rival.of(trial, outside[i], max(value - own, 0.0)))
    chance = min(len(first.candidates) * 2.0 * norm.sf(np.sqrt(max(delta, 0.0))), 1.0)
    return Cause(rivals=tuple(rivals), delta=float(delta), chance=float(chance))
