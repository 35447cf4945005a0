"""Which effects together explain a log: forward, backward and swap steps with full refits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.discrepancy.fit import Candidate, Fit, settle
from estimators.discrepancy.gate import Gate, Word
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.screen import Screen, candidates_for, chance_threshold, closely, projected, screen
from estimators.discrepancy.together import gain_of, guesses
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["Cause", "Rival", "Search", "search"]

#: Most effects that are named together.
_MOST = 4
#: Causes within this of the best, in twice the log-likelihood, are as good: 99 % of one parameter.
ALIKE = 6.63
#: Rivals that are refitted, and how alike a first look must find them.
_REFITS, _FIRST_LOOK = 4, 3.0 * ALIKE
#: Windows of the search and those apart together must show what chance does in this share of the logs in
#: which the first screen may find something.
_CONFIRMED = 0.4
#: Models as good as the best that may try the windows apart.
_GATED = 3
#: Rivals of the first step: scores that are this share of the best.
_NEAR_BEST = 0.8
#: Effects whose scores exceed so many thresholds, which chance does not, are sought closely along the route.
_LARGE = 2.0


@dataclass(frozen=True, kw_only=True)
class Rival:
    """An effect that explains the data about as well as another."""

    candidate: Candidate
    size: float
    deviation: float
    loss: float  #: twice the log-likelihood that it lacks
    ground: float  #: what the fit then makes of the ground's parameter (see `NUISANCES`)
    ground_deviation: float

    @classmethod
    def of(cls, fit: Fit, candidate: Candidate, loss: float) -> Rival:
        """An effect of a fitted model, which lacks ``loss``."""
        i, deviations = fit.candidates.index(candidate), fit.deviations()
        return cls(
            candidate=candidate,
            size=float(fit.sizes[i]),
            deviation=float(deviations[-len(fit.sizes) + i]),
            loss=float(loss),
            ground=float(fit.nuisances[0]),
            ground_deviation=float(deviations[0]),
        )


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


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """A model fitted with the noise as it is."""

    cost: float
    fit: Fit


@dataclass(kw_only=True)
class Search:
    """What a search found."""

    nominal: Fit
    extended: Fit
    first: Screen  #: scores against the nominal model
    last: Screen  #: scores against the extended model
    threshold: float  #: of the first screen
    gate: tuple[float, ...] = ()  #: what each model gains on the gate's windows, in the log-likelihood
    refused: bool = (
        False  #: whether the windows of the search ask for more, beyond chance, and those of the gate refuse
    )
    causes: tuple[Cause, ...] = field(default=())

    def score_of(self, change: np.ndarray) -> np.ndarray:
        """By how many standard deviations a change of the residuals (M,) moves the last scores."""
        return self.last.scores(self.extended, change)

    def solver_error(self) -> float:
        """How far a finer solver moves a score, at most [standard deviations]; infinite if it breaks down."""
        fine = self.extended.branch()
        fine.runs = tuple(run.refined() for run in fine.runs)
        before = self.extended.residual()
        try:
            after = fine.residual()
        except OffroadError:
            return float("inf")
        return float(np.abs(self.score_of(after - before)).max(initial=0.0))


def _starts(fit: Fit, candidate: Candidate, size: float) -> list[float]:
    """Sizes to descend from: timing has several valleys."""
    effect = EFFECTS[candidate.effect]
    reach = effect.plausible(fit.runs[0].setup.plant.vehicle)
    size = float(np.clip(size, -2.0 * reach, 2.0 * reach))
    if effect.family != "timing":
        return [size]
    return [size, *(share * reach for share in (0.2, 0.4, 0.7, 1.0))]


def refit(
    fit: Fit, candidates: Sequence[Candidate], sizes: Sequence[float], new: int = -1, enough: float = np.inf
) -> tuple[Fit, float] | None:
    """The model with these effects fitted, the noise as it is; None if it breaks down.

    ``new`` is the place of the effect whose size is least known; what cannot cost less than ``enough`` is not
    fitted to the end.
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
        return best[1], best[1].descend(fresh=False, enough=enough)
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


def _forward(fit: Fit, result: Screen, threshold: float) -> list[_Trial]:
    """Models with one effect more, best first."""
    strength = np.abs(result.z)
    order = _best_by_effect(strength, result.candidates)
    top = strength[order[0]] if order else 0.0
    if not top > threshold:
        return []
    order = [i for i in order if strength[i] > max(threshold, _NEAR_BEST * top)][:_REFITS]
    return _refitted(
        fit, [((*fit.candidates, result.candidates[i]), (*fit.sizes, result.size[i])) for i in order]
    )


def _refitted(fit: Fit, guesses: Sequence[tuple[Sequence[Candidate], Sequence[float]]]) -> list[_Trial]:
    """The models of these effects and sizes fitted, best first; what breaks down is left out."""
    trials = []
    for candidates, sizes in guesses:
        late = [i for i, candidate in enumerate(candidates) if EFFECTS[candidate.effect].family == "timing"]
        done = refit(fit, candidates, sizes, late[-1] if late else -1)
        if done is not None:
            trials.append(_Trial(cost=done[1], fit=done[0]))
    return sorted(trials, key=lambda trial: trial.cost)


def _together(fit: Fit, result: Screen, threshold: float, most: float) -> list[_Trial]:
    """Models with one effect more (two, if there is none yet) in which one that stood alone may be gone.

    Parameters
    ----------
    most
        What the best model with so many effects less one gains, in twice the log-likelihood.
    """
    inside = range(len(fit.sizes))
    bases = [[i for i in inside if i != k] for k in inside] or [[]]
    found = [guess for base in bases for guess in guesses(fit, result, base, _REFITS)]
    found = [guess for guess in found if guess.gain > most + threshold**2]
    best = max((guess.gain for guess in found), default=0.0)
    near = sorted((g for g in found if g.gain > best - _FIRST_LOOK), key=lambda guess: -guess.gain)
    return _refitted(fit, [(guess.candidates, guess.sizes) for guess in near[:_REFITS]])


def _larger(fit: Fit, result: Screen, threshold: float, gate: Gate) -> list[_Trial]:
    """Models that explain more by as much as an effect must: the best, and those as good, best first."""
    single = _forward(fit, result, threshold)
    if not single and not fit.candidates:
        return []
    most = gain_of(fit, result) if fit.candidates else float(np.max(result.z**2, initial=0.0))
    joint = _together(fit, result, threshold, most)
    if not fit.candidates and joint:
        # A second effect must earn its place, here and on the windows apart.
        if 2.0 * (single[0].cost - joint[0].cost) <= threshold**2:
            return single
        word = gate.word(joint[0].fit, single[0].fit)
        return joint if word is None or word.gain > 0.0 else single
    names = {frozenset(candidate.effect for candidate in trial.fit.candidates) for trial in single}
    new = [t for t in joint if frozenset(c.effect for c in t.fit.candidates) not in names]
    trials = sorted([*single, *new], key=lambda trial: trial.cost)
    return [trial for trial in trials if 2.0 * (trial.cost - trials[0].cost) <= ALIKE]


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


def _support(fit: Fit, larger: Fit, gain: float) -> tuple[float, float]:
    """(What the windows of the search say for the new effects, how much more than that scatters there).

    In the log-likelihood: the ``gain`` with the noise as it was, or what the least of the new effects is
    worth, if that is less.
    """
    names = {candidate.effect for candidate in fit.candidates}
    new = [i for i, candidate in enumerate(larger.candidates) if candidate.effect not in names]
    places = len(NUISANCES) + np.array(new, dtype=np.int64)
    least = np.min(np.abs(larger.sizes[new]) / larger.deviations()[places], initial=np.inf)
    wide = 1.0 if fit.drawn is None else np.max(larger.widenings()[places], initial=1.0)
    return float(min(gain / wide, 0.5 * least**2)), float(wide)


def _accepted(
    gate: Gate, trials: Sequence[_Trial], bars: tuple[float, float], *, white: bool
) -> tuple[Fit | None, list[float], bool]:
    """The first of the models that the windows apart confirm, settled; what each gained; was one refused?

    ``bars`` are the least sizes of an effect, in standard deviations: in the windows of the search, and in
    those and the windows apart together. What does not reach the second one in the windows of the search is
    chance, and its refusal leaves nothing open.
    """
    fit, gains, refused = gate.fit, [], False
    names = {candidate.effect for candidate in fit.candidates}
    before = fit.cost_of(fit.residual())

    enough = 0.5 * bars[1] ** 2
    for trial in trials[:_GATED]:
        larger = trial.fit
        # After a refusal, only what is confirmed with the noise as it is gets the work of a noise of its own.
        if gains and not _confirmed(gate.word(larger), _support(fit, larger, before - trial.cost), enough):
            continue
        settle(larger, white=white)
        larger = _pruned(larger, bars[0], white=white)
        if {candidate.effect for candidate in larger.candidates} == names:
            break
        word, support = gate.word(larger), _support(fit, larger, before - trial.cost)
        if word is None:
            return larger, gains, False
        gains.append(word.gain)
        if _confirmed(word, support, enough):
            return larger, gains, False
        refused |= support[0] > enough
    return None, gains, refused


def _confirmed(word: Word | None, support: tuple[float, float], enough: float) -> bool:
    """Whether windows of the search and those apart together show enough, and the latter do not object."""
    if word is None or word.contradicts:
        return False
    return support[0] + word.gain / support[1] > enough


def _onward(
    gate: Gate, last: Screen, limits: tuple[float, float], *, white: bool
) -> tuple[Fit | None, list[float], bool]:
    """The next larger model, see `_accepted`. ``limits``: least score, and rate of the first screen."""
    fit, (bar, rate) = gate.fit, limits
    last = closely(fit, last, _LARGE * bar, _NEAR_BEST)
    while True:
        trials = _larger(fit, last, bar, gate)
        # The first name is the best or none; later ones may be any that explain as much.
        tried = trials if fit.candidates else trials[:1]
        bars = (bar, chance_threshold(last, _CONFIRMED * rate))
        larger, gains, refused = _accepted(gate, tried, bars, white=white)
        if larger is not None or gains or not trials:
            return larger, gains, refused
        # What looked best does not hold when it is fitted to the end; what stood in its shade may.
        inside = {candidate.effect for candidate in fit.candidates}
        gone = {c.effect for trial in trials for c in trial.fit.candidates} - inside
        last = screen(fit, [c for c in last.candidates if c.effect not in gone])


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
        Windows that may refuse an effect, with which the search ends.
    white
        Take all noise for white.
    """
    candidates = candidates_for(nominal, library)
    first = last = screen(nominal, candidates)
    threshold = chance_threshold(first, rate)
    fit, bar, gate, told, refused = nominal, threshold, Gate(nominal, apart), [], False
    while len(fit.candidates) < _MOST:
        larger, gains, refused = _onward(gate, last, (bar, rate), white=white)
        told += gains
        if larger is None:
            break
        fit, gate = larger, gate.onward(larger)
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
        gate=tuple(told),
        refused=refused,
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
    # Where healthy runs scatter more than the likelihood says, so do its differences.
    wide = 1.0 if fit.drawn is None else float(fit.widenings()[len(NUISANCES) + k])
    for i in _best_by_effect(-loss, last.candidates)[:_REFITS]:
        if loss[i] > max(_FIRST_LOOK, 0.1 * own) or last.candidates[i].effect in inside:
            continue
        names, values = list(fit.candidates), fit.sizes.copy()
        names[k], values[k] = last.candidates[i], sizes[i]
        lowest = min(rival[0] for rival in rivals)
        done = refit(fit, names, values, k, lowest + 0.5 * wide * ALIKE)
        if done is not None:
            rivals.append((done[1], last.candidates[i], done[0]))
    rivals.sort(key=lambda rival: rival[0])
    lowest = rivals[0][0]
    near = [rival for rival in rivals if 2.0 * (rival[0] - lowest) <= wide * ALIKE]
    cause = Cause(
        rivals=tuple(Rival.of(trial, candidate, 2.0 * (c - lowest)) for c, candidate, trial in near),
        delta=float(own + 2.0 * (cost - lowest)),
        chance=_chance(first, np.sqrt(own)),
    )
    return rivals[0][2], cause


def _chance(first: Screen, strength: float) -> float:
    """At most this share of null logs has so large a score: by the normal law for all candidates together."""
    from scipy.stats import norm

    return float(min(len(first.candidates) * 2.0 * norm.sf(strength), 1.0))
