"""Which manoeuvre to drive next: the information that it would add to the data.

Fisher information adds over runs. For every manoeuvre of the menu the fitted model gives the information of
its sensors about the sizes in question; ground, wheel radius and timing are the same in both runs, the
biases of the IMU are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from estimators.discrepancy.manoeuvres import MENU, Manoeuvre, driven
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian
from estimators.discrepancy.model.normal_equations import projected
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.result import EQUIVALENT, Cause, SearchResult
from estimators.discrepancy.search.score_test import DETECTABLE
from estimators.discrepancy.verdict import Diagnosis
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at

__all__ = ["Advice", "Trial", "advise"]

#: Effects whose limits are looked at besides those that are not testable.
_ASKED = 6
#: Usual speeds that a menu can be driven at [m/s].
_SLOWEST, _FASTEST = 1.0, 12.0


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One manoeuvre, added to the data at hand."""

    name: str
    sentence: str
    power: float | None  #: probability that it leaves one cause of the set; None where no set is in question
    limits: dict[str, float] = field(default_factory=dict)  #: smallest size that both would show


@dataclass(frozen=True, kw_only=True)
class Advice:
    """The manoeuvre that answers the open question best."""

    question: str  #: what is open, as the end of "to ..."
    effect: str  #: what is in question most
    best: Trial
    power: float | None  #: with the data at hand alone
    limits: dict[str, float]  #: the same
    trials: tuple[Trial, ...]  #: the whole menu, best first
    most: float = math.inf  #: largest plausible size of the effect that is in question most

    @property
    def sentence(self) -> str:
        """Advice with its number."""
        text = f"to {self.question}: {self.best.sentence}"
        if self.best.power is not None:
            return f"{text} (succeeds in {100.0 * self.best.power:.0f} % of cases)"
        return f"{text} ({self._gain})"

    @property
    def _gain(self) -> str:
        """What the manoeuvre adds about the effect in question; a limit beyond the plausible is no number."""
        now, then = self.limits[self.effect], self.best.limits[self.effect]
        if now <= self.most:
            return f"detectable from {_amount(self.effect, then)} instead of {_amount(self.effect, now)}"
        most = f"at any plausible size, up to {_amount(self.effect, self.most)}"
        if then > self.most:
            return f"even then not detectable {most}"
        return f"detectable from {_amount(self.effect, then)}; these data alone do not show it {most}"


def _amount(effect: str, size: float) -> str:
    return f"{size:.2g} {EFFECTS[effect].size.unit}".removesuffix(" -")


@dataclass(frozen=True, kw_only=True)
class _Question:
    """What a diagnosis leaves open, and the model with which manoeuvres are compared."""

    fit: FitResult
    search: SearchResult
    causes: tuple[Cause, ...]
    asked: tuple[Candidate, ...]  #: effects outside the model that are in question
    stated: Mapping[str, float]  #: effect -> detection limit of the log
    hidden: frozenset[str]  #: effects that the log cannot test

    @property
    def open_set(self) -> Cause | None:
        """The first cause that has alternatives."""
        return next((cause for cause in self.causes if len(cause.alternatives) > 1), None)


def advise(diagnosis: Diagnosis) -> Advice | None:
    """The manoeuvre that would settle what the diagnosis leaves open; None where nothing was fitted.

    The question is the first of: which of a set it is; what the data cannot show at any plausible size; what
    they show only when it is large.
    """
    question = _question(diagnosis)
    if question is None:
        return None
    usual = _usual_speed(question.fit)
    try:
        own = _information(question.fit, question.asked)
    except OffroadError:
        return None
    trials, spreads = [], _common_spreads(question.fit)
    for manoeuvre in MENU:
        try:
            more = _information(driven(question.fit, manoeuvre, usual=usual), question.asked)
        except (OffroadError, np.linalg.LinAlgError):
            continue
        trials.append(_trial(question, manoeuvre, own, _added(own, more, spreads)))
    return _best(question, own, trials) if trials else None


def _best(question: _Question, own: np.ndarray, trials: list[Trial]) -> Advice:
    """The trial that answers the question, with the answer of the data at hand."""
    before, open_set = _limits(question, own, own), question.open_set
    power = None
    if open_set is not None:
        effect, *others = (one.candidate.effect for one in open_set.alternatives)
        order = sorted(trials, key=lambda trial: -(trial.power or 0.0))
        power = _power(question, open_set, own)
        aim = f"distinguish {effect} from {' and '.join(others)}"
    else:
        hidden = [name for name in before if name in question.hidden]
        order = sorted(trials, key=lambda trial: _worth(trial, before, hidden, question.fit))
        effect = min(hidden or before, key=lambda name: order[0].limits[name] / before[name])
        aim = f"{'detect' if hidden else 'detect a smaller'} {effect}"
    return Advice(
        question=aim,
        effect=effect,
        best=order[0],
        power=power,
        limits=before,
        trials=tuple(order),
        most=EFFECTS[effect].plausible(question.fit.runs[0].setup.plant.vehicle),
    )


def _usual_speed(fit: FitResult) -> float:
    """Median speed of the log, within what a menu can be driven at [m/s]."""
    speeds = np.concatenate([records.states[:, at.V_X] for records in fit.records])
    return float(np.clip(np.median(speeds), _SLOWEST, _FASTEST))


def _question(diagnosis: Diagnosis) -> _Question | None:
    """What is open; None where nothing was fitted."""
    search = diagnosis.search
    if search is None:
        return None
    # Causes that are not named are in question, too.
    fit = search.extended if diagnosis.causes else search.nominal
    return _Question(
        fit=fit,
        search=search,
        causes=diagnosis.causes,
        asked=tuple(_asked(diagnosis, fit, search)),
        stated=diagnosis.limits,
        hidden=frozenset(diagnosis.not_testable),
    )


def _asked(diagnosis: Diagnosis, fit: FitResult, search: SearchResult) -> list[Candidate]:
    """Effects outside the model that are in question, each at its best place."""
    first = search.first
    inside = {candidate.effect for candidate in fit.candidates}
    strength = np.diag(first.information)
    best: dict[str, int] = {}
    for i, candidate in enumerate(first.candidates):
        if candidate.effect not in best or strength[i] > strength[best[candidate.effect]]:
            best[candidate.effect] = i
    vehicle = fit.runs[0].setup.plant.vehicle
    alternatives = {
        one.candidate.effect: one.candidate for cause in diagnosis.causes for one in cause.alternatives
    }
    wanted = [name for name in alternatives if name not in inside]
    share = {
        name: diagnosis.limits.get(name, math.inf) / EFFECTS[name].plausible(vehicle)
        for name in best
        if name not in inside and name not in wanted
    }
    wanted += sorted(share, key=lambda name: -share[name])[: max(_ASKED - len(wanted), 2)]
    return [alternatives.get(name, first.candidates[best[name]]) for name in wanted]


# ------------------------------------------------------------------ information


def _information(fit: FitResult, asked: Sequence[Candidate]) -> np.ndarray:
    """Fisher information of the common nuisances, sizes in the model and sizes asked for."""
    there = fit.linearisation
    fit = replace(fit, jacobian=Jacobian().renewed(there))
    columns = []
    for candidate in asked:
        column = there.effect_column(candidate)
        columns.append(np.zeros(fit.problem.rows) if column is None else column)
    shared = fit.noise.whiten(np.column_stack([fit.jacobian.shared(fit.candidates), *columns]))
    equations = fit.reduced(np.zeros(fit.problem.rows), shared)
    own = _own(fit)
    order = [*own, *(i for i in range(len(equations.normal)) if i not in own)]
    normal, _ = projected(equations.normal[np.ix_(order, order)], np.zeros(len(order)), len(own))
    return normal


def _own(fit: FitResult) -> list[int]:
    """Nuisances that every run has for itself, by their place in a fit."""
    nuisances = fit.problem.nuisances
    return [i for i, one in enumerate(nuisances) if one.log or one.name.startswith("bias")]


def _common_spreads(fit: FitResult) -> np.ndarray:
    """Standard deviations of the priors of all other nuisances."""
    return np.delete(fit.problem.nuisance_spread, _own(fit))


def _added(own: np.ndarray, more: np.ndarray, spreads: np.ndarray) -> np.ndarray:
    """Both runs together; the prior of the common nuisances counts once."""
    both: np.ndarray = own + more
    places = np.arange(len(spreads))
    both[places, places] -= 1.0 / spreads**2
    return both


def _sizes(information: np.ndarray, common: int) -> np.ndarray:
    """Information of the sizes alone, after that of the ``common`` nuisances."""
    normal, _ = projected(information, np.zeros(len(information)), common)
    return np.asarray(0.5 * (normal + normal.T))


def _trial(question: _Question, manoeuvre: Manoeuvre, own: np.ndarray, both: np.ndarray) -> Trial:
    """A manoeuvre by the information of the log alone and with it."""
    open_set = question.open_set
    return Trial(
        name=manoeuvre.name,
        sentence=manoeuvre.sentence,
        power=None if open_set is None else _power(question, open_set, both),
        limits=_limits(question, own, both),
    )


def _limits(question: _Question, own: np.ndarray, both: np.ndarray) -> dict[str, float]:
    """Detection limit of every effect asked for, with the causes in the model."""
    inside, common = len(question.fit.sizes), len(_common_spreads(question.fit))
    limits = {}
    for k, candidate in enumerate(question.asked, inside):
        before, after = (_alone(_sizes(information, common), k, inside) for information in (own, both))
        limit = DETECTABLE / math.sqrt(max(after, 1e-300))
        stated = question.stated.get(candidate.effect, math.inf)
        # On an unknown road scores scatter more than the information predicts; the log's own limit has
        # that factor.
        if before > 0.0 and math.isfinite(stated):
            limit *= max(stated * math.sqrt(before) / DETECTABLE, 1.0)
        limits[candidate.effect] = limit
    return limits


def _alone(sizes: np.ndarray, k: int, inside: int) -> float:
    """Information of size ``k`` with those in the model eliminated."""
    rows = [*range(inside), k]
    rest, _ = projected(sizes[np.ix_(rows, rows)], np.zeros(len(rows)), inside)
    return max(float(rest[0, 0]), 0.0)


def _power(question: _Question, cause: Cause, information: np.ndarray) -> float:
    """Probability that the best alternative of a cause is preferred clearly to each of the others."""
    fit = question.fit
    names = [candidate.effect for candidate in (*fit.candidates, *question.asked)]
    sizes = _sizes(information, len(_common_spreads(fit)))
    k = names.index(cause.best.candidate.effect)
    # On an unknown road sizes scatter more than the information predicts.
    wide = float(fit.size_inflation[k])
    others = [j for j in range(len(fit.sizes)) if j != k]
    powers = []
    for other in cause.alternatives[1:]:
        rows = [*others, k, names.index(other.candidate.effect)]
        pair, _ = projected(sizes[np.ix_(rows, rows)], np.zeros(len(rows)), len(others))
        # What the other effect cannot imitate of the true cause's trace, squared.
        apart = pair[0, 0] - pair[0, 1] ** 2 / max(pair[1, 1], 1e-300)
        distance = max(float(cause.best.size**2 * apart) / wide, 1e-12)
        powers.append(float(norm.cdf((distance - EQUIVALENT) / (2.0 * math.sqrt(distance)))))
    return min(powers)


def _worth(trial: Trial, before: dict[str, float], hidden: list[str], fit: FitResult) -> tuple[int, float]:
    """Effects that stay hidden, then the mean logarithm of the limits' ratios: better if less."""
    vehicle = fit.runs[0].setup.plant.vehicle
    still = sum(trial.limits[name] > EFFECTS[name].plausible(vehicle) for name in hidden)
    return still, float(np.mean([math.log(trial.limits[name] / before[name]) for name in hidden or before]))
