"""Which manoeuvre to drive next: what the data would say if it were added to them.

Fisher information adds over runs. For every manoeuvre of the menu the fitted model says what its sensors
would tell of the sizes in question; ground, wheel radius and timing are the same in both runs, the biases of
the IMU are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import norm

from estimators.discrepancy.diagnosis import Diagnosis
from estimators.discrepancy.fit import Candidate, Fit
from estimators.discrepancy.manoeuvres import MENU, Manoeuvre, driven
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.screen import DETECTABLE, projected
from estimators.discrepancy.search import ALIKE
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at

__all__ = ["Advice", "Trial", "advise"]

#: Effects whose limits are looked at besides those that are not testable.
_ASKED = 6
#: Usual speeds that a menu can be driven at [m/s].
_SLOWEST, _FASTEST = 1.0, 12.0
_OWN = tuple(i for i, nuisance in enumerate(NUISANCES) if nuisance.name.startswith("bias"))
_COMMON = tuple(i for i in range(len(NUISANCES)) if i not in _OWN)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One manoeuvre, added to the data at hand."""

    name: str
    sentence: str
    power: float | None  #: chance that it leaves one cause of the set; None where no set is in question
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

    @property
    def sentence(self) -> str:
        """Advice with its number."""
        text = f"to {self.question}: {self.best.sentence}"
        if self.best.power is not None:
            return f"{text} (succeeds in {100.0 * self.best.power:.0f} % of cases)"
        now, then = _amount(self.effect, self.limits), _amount(self.effect, self.best.limits)
        return f"{text} (would show it from {then} on instead of {now})"


def _amount(effect: str, limits: dict[str, float]) -> str:
    return f"{limits[effect]:.2g} {EFFECTS[effect].size.unit}".removesuffix(" -")


def advise(diagnosis: Diagnosis) -> Advice | None:
    """The manoeuvre that would settle what the diagnosis leaves open; None where nothing was fitted.

    The question is the first of: which of a set it is; what the data cannot show at any plausible size; what
    they show only when it is large.
    """
    if diagnosis.search is None:
        return None
    fit = diagnosis.model
    open_set = next((cause for cause in diagnosis.causes if len(cause.rivals) > 1), None)
    asked = _asked(diagnosis)
    usual = _usual_speed(fit)
    try:
        own = _information(fit, asked)
    except OffroadError:
        return None
    trials = []
    for manoeuvre in MENU:
        try:
            more = _information(driven(fit, manoeuvre, usual=usual), asked)
        except (OffroadError, np.linalg.LinAlgError):
            continue
        trials.append(_trial(diagnosis, manoeuvre, (own, _added(own, more)), asked))
    if not trials:
        return None
    before = _limits(diagnosis, own, own, asked)
    if open_set is not None:
        names = [rival.candidate.effect for rival in open_set.rivals]
        order = sorted(trials, key=lambda trial: -trial.power)
        effect, power = names[0], _power(diagnosis, own, asked)
        question = f"tell {effect} from {' and '.join(names[1:])}"
    else:
        hidden = [name for name in before if name in diagnosis.not_testable]
        order = sorted(trials, key=lambda trial: _worth(trial, before, hidden, fit))
        effect = min(hidden or before, key=lambda name: order[0].limits[name] / before[name])
        question, power = f"{'make visible' if hidden else 'see a smaller'} {effect}", None
    return Advice(
        question=question, effect=effect, best=order[0], power=power, limits=before, trials=tuple(order)
    )


def _usual_speed(fit: Fit) -> float:
    fit.residual()
    speeds = np.concatenate([records.states[:, at.V_X] for records in fit._records])
    return float(np.clip(np.median(speeds), _SLOWEST, _FASTEST))


def _asked(diagnosis: Diagnosis) -> list[Candidate]:
    """Effects outside the model that are in question, each at its best place."""
    first, fit = diagnosis.search.first, diagnosis.model
    inside = {candidate.effect for candidate in fit.candidates}
    strength = np.diag(first.information)
    best: dict[str, int] = {}
    for i, candidate in enumerate(first.candidates):
        if candidate.effect not in best or strength[i] > strength[best[candidate.effect]]:
            best[candidate.effect] = i
    vehicle = fit.runs[0].setup.plant.vehicle
    rivals = {rival.candidate.effect: rival.candidate for c in diagnosis.causes for rival in c.rivals}
    wanted = [name for name in rivals if name not in inside]
    share = {
        name: diagnosis.limits.get(name, math.inf) / EFFECTS[name].plausible(vehicle)
        for name in best
        if name not in inside and name not in wanted
    }
    wanted += sorted(share, key=lambda name: -share[name])[: max(_ASKED - len(wanted), 2)]
    return [rivals.get(name, first.candidates[best[name]]) for name in wanted]


# ------------------------------------------------------------------ information


def _information(fit: Fit, asked: list[Candidate]) -> np.ndarray:
    """Fisher information of the common nuisances, sizes in the model and sizes asked for."""
    residual = fit.residual()
    fit.linearise()
    columns = []
    for candidate in asked:
        column = fit.effect_column(candidate)
        columns.append(np.zeros(len(residual)) if column is None else column)
    shared = fit.whitener(np.column_stack([fit.columns(), *columns]))
    shares, _ = fit.reduce(np.zeros(len(residual)), fit.whitener(fit._states), shared)
    others = [i for i in range(len(shares.normal)) if i not in _OWN]
    order = [*_OWN, *others]
    normal, _ = projected(shares.normal[np.ix_(order, order)], np.zeros(len(order)), len(_OWN))
    return normal


def _added(own: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Both runs together; what is believed of the common nuisances counts once."""
    both = own + more
    for place, i in enumerate(_COMMON):
        both[place, place] -= 1.0 / NUISANCES[i].spread ** 2
    return both


def _sizes(information: np.ndarray) -> np.ndarray:
    """Information of the sizes alone."""
    normal, _ = projected(information, np.zeros(len(information)), len(_COMMON))
    return 0.5 * (normal + normal.T)


def _trial(diagnosis: Diagnosis, manoeuvre: Manoeuvre, pair: tuple, asked: list[Candidate]) -> Trial:
    own, both = pair
    return Trial(
        name=manoeuvre.name,
        sentence=manoeuvre.sentence,
        power=_power(diagnosis, both, asked),
        limits=_limits(diagnosis, own, both, asked),
    )


def _limits(
    diagnosis: Diagnosis, own: np.ndarray, both: np.ndarray, asked: list[Candidate]
) -> dict[str, float]:
    """Smallest size of every effect asked for that would be seen, with the causes in the model."""
    inside = len(diagnosis.model.sizes)
    limits = {}
    for k, candidate in enumerate(asked, inside):
        before, after = (_alone(_sizes(information), k, inside) for information in (own, both))
        limit = DETECTABLE / math.sqrt(max(after, 1e-300))
        stated = diagnosis.limits.get(candidate.effect, math.inf)
        # An unknown road tells less than its whitened channels say: the log's own limit knows by how much.
        if before > 0.0 and math.isfinite(stated):
            limit *= max(stated * math.sqrt(before) / DETECTABLE, 1.0)
        limits[candidate.effect] = limit
    return limits


def _alone(sizes: np.ndarray, k: int, inside: int) -> float:
    """Information of size ``k`` with those in the model eliminated."""
    rows = [*range(inside), k]
    rest, _ = projected(sizes[np.ix_(rows, rows)], np.zeros(len(rows)), inside)
    return max(float(rest[0, 0]), 0.0)


def _power(diagnosis: Diagnosis, information: np.ndarray, asked: list[Candidate]) -> float | None:
    """Chance that the best cause of the first open set leaves its rivals behind; None without a set."""
    fit = diagnosis.model
    cause = next((c for c in diagnosis.causes if len(c.rivals) > 1), None)
    if cause is None:
        return None
    names = [candidate.effect for candidate in (*fit.candidates, *asked)]
    sizes = _sizes(information)
    k = names.index(cause.best.candidate.effect)
    # An unknown road tells less than its whitened channels say.
    wide = 1.0 if fit.drawn is None else float(fit.widenings()[len(NUISANCES) + k])
    others = [j for j in range(len(fit.sizes)) if j != k]
    chances = []
    for rival in cause.rivals[1:]:
        rows = [*others, k, names.index(rival.candidate.effect)]
        pair, _ = projected(sizes[np.ix_(rows, rows)], np.zeros(len(rows)), len(others))
        # What the rival cannot take over of the true cause's trace, squared.
        apart = pair[0, 0] - pair[0, 1] ** 2 / max(pair[1, 1], 1e-300)
        distance = max(float(cause.best.size**2 * apart) / wide, 1e-12)
        chances.append(float(norm.cdf((distance - ALIKE) / (2.0 * math.sqrt(distance)))))
    return min(chances)


def _worth(trial: Trial, before: dict[str, float], hidden: list[str], fit: Fit) -> tuple[int, float]:
    """Effects that stay hidden, then the mean logarithm of what is left of the limits: better if less."""
    vehicle = fit.runs[0].setup.plant.vehicle
    still = sum(trial.limits[name] > EFFECTS[name].plausible(vehicle) for name in hidden)
    return still, float(np.mean([math.log(trial.limits[name] / before[name]) for name in hidden or before]))
