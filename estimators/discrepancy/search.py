"""Which effects together explain a log: forward, backward and swap steps with full refits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.discrepancy.fit import NUISANCES, Candidate, Fit, settle
from estimators.discrepancy.gain import held_out
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.screen import Screen, candidates_for, chance_threshold, projected, screen
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["Cause", "Rival", "Search", "search"]

#: Most effects that are named together.
_MOST = 4
#: Causes within this of the best, in twice the log-likelihood, are as good: 99 % of one parameter.
ALIKE = 6.63
#: Rivals that are refitted, and how alike a first look must find them.
_REFITS, _FIRST_LOOK = 4, 3.0 * ALIKE
#: Rivals of the first step: scores that are this share of the best.
_NEAR_BEST = 0.8


@dataclass(frozen=True, kw_only=True)
class Rival:
    """An effect that explains the data about as well as another."""

    candidate: Candidate
    size: float
    deviation: float
    loss: float  #: twice the log-likelihood that it lacks
    ground: float  #: what the fit then makes of the ground's parameter (see `NUISANCES`)
    ground_deviation: float


@dataclass(frozen=True, kw_only=True)
class Cause:
    """A place in the model that some effect must fill: all that can, best first."""

    rivals: tuple[Rival, ...]
    delta: float  #: twice the log-likelihood that the best gains
    chance: float  #: share of null logs with so large a score

    @property
    def best(self) -> Rival:
        """The one that the extended model uses."""
        return self.rivals[0]


@dataclass(kw_only=True)
class Search:
    """What a search found."""

    nominal: Fit
    extended: Fit
    first: Screen  #: scores against the nominal model
    last: Screen  #: scores against the extended model
    threshold: float  #: of the first screen
    gate: tuple[float, ...] = ()  #: what each effect gains on the gate's windows, the last may be refused
    causes: tuple[Cause, ...] = field(default=())

    def score_of(self, change: np.ndarray) -> np.ndarray:
        """By how many standard deviations a change of the residuals (M,) moves the last scores."""
        return self.last.scores(self.extended, change)


def _starts(fit: Fit, candidate: Candidate, size: float) -> list[float]:
    """Sizes to descend from: timing has several valleys."""
    effect = EFFECTS[candidate.effect]
    reach = effect.plausible(fit.runs[0].setup.plant.vehicle)
    size = float(np.clip(size, -2.0 * reach, 2.0 * reach))
    if effect.family != "timing":
        return [size]
    return [size, *(share * reach for share in (0.2, 0.4, 0.7, 1.0))]


def refit(
    fit: Fit, candidates: Sequence[Candidate], sizes: Sequence[float], new: int = -1
) -> tuple[Fit, float] | None:
    """The model with these effects fitted, the noise as it is; None if it breaks down.

    ``new`` is the place of the effect whose size is least known.
    """
    best: tuple[float, Fit] | None = None
    for size in _starts(fit, candidates[new], sizes[new]):
        point = np.array(sizes, dtype=np.float64)
        point[new] = size
        trial = fit.with_effects(candidates, point)
        try:
            cost = trial.cost_of(trial.residual())
        except OffroadError:
            continue
        if best is None or cost < best[0]:
            best = (cost, trial)
    if best is None:
        return None
    try:
        return best[1], best[1].descend(fresh=False)
    except OffroadError:
        return None


def _outside(fit: Fit, candidates: Sequence[Candidate]) -> list[Candidate]:
    inside = {candidate.effect for candidate in fit.candidates}
    return [candidate for candidate in candidates if candidate.effect not in inside]


def _best_by_effect(values: np.ndarray, candidates: Sequence[Candidate]) -> list[int]:
    """Indices in the order of falling ``values``, one for each effect."""
    seen: set[str] = set()
    chosen = []
    for i in np.argsort(-values):
        if candidates[i].effect not in seen:
            seen.add(candidates[i].effect)
            chosen.append(int(i))
    return chosen


def _forward(fit: Fit, result: Screen, threshold: float) -> Fit | None:
    """The model with the one effect more that fits best, or None."""
    strength = np.abs(result.z)
    order = _best_by_effect(strength, result.candidates)
    top = strength[order[0]] if order else 0.0
    if not top > threshold:
        return None
    order = [i for i in order if strength[i] > max(threshold, _NEAR_BEST * top)][:_REFITS]
    trials = []
    for i in order:
        done = refit(fit, (*fit.candidates, result.candidates[i]), [*fit.sizes, result.size[i]])
        if done is not None:
            trials.append((done[1], len(trials), done[0]))
    if not trials:
        return None
    return min(trials)[2]


def _pruned(fit: Fit, threshold: float, *, white: bool) -> Fit:
    """Without the effects that no longer stand out."""
    while len(fit.candidates) > 1:
        strength = np.abs(fit.sizes) / fit.deviations()[-len(fit.sizes) :]
        weakest = int(np.argmin(strength))
        if strength[weakest] > threshold:
            break
        keep = [i for i in range(len(fit.candidates)) if i != weakest]
        fit = fit.with_effects([fit.candidates[i] for i in keep], fit.sizes[keep])
        settle(fit, white=white)
    return fit


def _gain_apart(fit: Fit, larger: Fit, runs: Sequence[RunModel]) -> float | None:
    """What a larger model gains on windows apart, in the log-likelihood; None where that cannot be said."""
    if not runs:
        return None
    try:
        return held_out(fit, runs).cost - held_out(larger, runs).cost
    except OffroadError:
        return None


def search(
    nominal: Fit, library: Sequence[str], rate: float, apart: Sequence[RunModel] = (), *, white: bool = False
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
        Windows on which every effect must gain too, or it is refused and the search ends.
    white
        Take all noise for white.
    """
    candidates = candidates_for(nominal, library)
    first = last = screen(nominal, candidates)
    threshold = chance_threshold(first, rate)
    fit, bar, gate = nominal, threshold, []
    while len(fit.candidates) < _MOST:
        larger = _forward(fit, last, bar)
        if larger is None:
            break
        settle(larger, white=white)
        names = {candidate.effect for candidate in fit.candidates}
        larger = _pruned(larger, bar, white=white)
        if {candidate.effect for candidate in larger.candidates} == names:
            break
        if (gain := _gain_apart(fit, larger, apart)) is not None:
            gate.append(gain)
            if gain <= 0.0:
                break
        fit = larger
        last = screen(fit, _outside(fit, candidates))
        bar = chance_threshold(last, rate)
    causes = []
    for k in range(len(fit.candidates)):
        fit, cause = _cause(fit, last, k, first)
        causes.append(cause)
    return Search(
        nominal=nominal,
        extended=fit,
        first=first,
        last=last,
        threshold=threshold,
        gate=tuple(gate),
        causes=tuple(causes),
    )


def _looks(fit: Fit, last: Screen, k: int) -> tuple[np.ndarray, np.ndarray]:
    """First look at every candidate in the place of effect ``k``: (what it would lack, its size)."""
    inside = len(fit.sizes)
    order = [i for i in range(inside) if i != k] + [k] + list(range(inside, len(last.joint)))
    joint, _ = projected(last.joint[np.ix_(order, order)], np.zeros(len(order)), inside - 1)
    own, cross, theirs = joint[0, 0], joint[0, 1:], np.diag(joint)[1:]
    seen = np.diag(last.information) > 0.0
    theirs = np.where(seen, theirs, 1.0)
    size = fit.sizes[k]
    push = np.where(seen, cross * size, 0.0)
    return size * size * own - push * push / theirs, push / theirs


def _cause(fit: Fit, last: Screen, k: int, first: Screen) -> tuple[Fit, Cause]:
    """All effects that can stand in the place of effect ``k``; the best of them takes it."""
    cost = fit.cost_of(fit.residual())
    loss, sizes = _looks(fit, last, k)
    own = (fit.sizes[k] / fit.deviations()[-len(fit.sizes) + k]) ** 2
    rivals = [(cost, fit.candidates[k], fit)]
    inside = {candidate.effect for candidate in fit.candidates}
    for i in _best_by_effect(-loss, last.candidates)[:_REFITS]:
        if loss[i] > max(_FIRST_LOOK, 0.1 * own) or last.candidates[i].effect in inside:
            continue
        names, values = list(fit.candidates), fit.sizes.copy()
        names[k], values[k] = last.candidates[i], sizes[i]
        done = refit(fit, names, values, k)
        if done is not None:
            rivals.append((done[1], last.candidates[i], done[0]))
    rivals.sort(key=lambda rival: rival[0])
    lowest = rivals[0][0]
    # Where healthy runs scatter more than the likelihood says, so do its differences.
    wide = 1.0 if fit.drawn is None else float(fit.widenings()[len(NUISANCES) + k])
    near = [rival for rival in rivals if 2.0 * (rival[0] - lowest) <= wide * ALIKE]
    cause = Cause(
        rivals=tuple(_rival(trial, candidate, 2.0 * (c - lowest)) for c, candidate, trial in near),
        delta=float(own + 2.0 * (cost - lowest)),
        chance=_chance(first, np.sqrt(own)),
    )
    return rivals[0][2], cause


def _rival(fit: Fit, candidate: Candidate, loss: float) -> Rival:
    i = fit.candidates.index(candidate)
    deviations = fit.deviations()
    return Rival(
        candidate=candidate,
        size=float(fit.sizes[i]),
        deviation=float(deviations[-len(fit.sizes) + i]),
        loss=float(loss),
        ground=float(fit.nuisances[0]),
        ground_deviation=float(deviations[0]),
    )


def _chance(first: Screen, strength: float) -> float:
    """At most this share of null logs has so large a score: by the normal law for all candidates together."""
    from scipy.stats import norm

    return float(min(len(first.candidates) * 2.0 * norm.sf(strength), 1.0))
