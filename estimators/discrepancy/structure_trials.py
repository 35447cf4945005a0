"""Replays of runs by structure: errors of windows, each structure with the n that suits it best.

Half of the windows decide on n; the others are predicted only where a structure is compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from estimators.discrepancy.checks.holdout_gain import ChannelGain, channel_gain
from estimators.discrepancy.corrected_log import corrected_log
from estimators.discrepancy.model.run_model import RunModel
from estimators.logs.log import Log
from estimators.replay.replay import WindowReplay
from estimators.replay.structures import Case, plant_for
from offroad_env.effects.protocol import Setup
from offroad_env.errors import OffroadError
from offroad_env.physics.axle import Plant

__all__ = ["FLOORS", "StructureTrial", "Trials"]

#: Length of the windows [s].
_WINDOW = 3.0
#: Compared channels: errors below which differences do not count, and one that counts as a failure.
FLOORS: Mapping[str, float] = MappingProxyType(
    {"v_x": 0.02, "v_y": 0.02, "yaw_rate": 0.008, "omega_f": 0.15, "omega_r": 0.15, "a_y": 0.08}
)
_FAILED = 50.0
#: Search of n: over all that soils have, since a stated n may be far off, closer around the stated one.
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.05, 1.2, 1.4, 1.6)
_STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
_LEAST, _MOST = _GRID[0], _GRID[-1]
#: Values of the grid this near to one that is tried anyway are left out; accuracy of n; steps from a known n.
_APART, _ACCURACY, _BESIDE = 0.06, 0.004, 0.05
#: Values of n that are tried in all windows: those that cost least in every fifth.
_KEPT = 4
_SEED = 0


@dataclass(frozen=True, kw_only=True)
class StructureTrial:
    """One structure, with the n that suits it best."""

    case: Case
    change: float  #: of n, against the stated one [-]
    errors: np.ndarray  #: (W, C) root mean square errors by window and channel of `FLOORS`

    @staticmethod
    def channels() -> tuple[str, ...]:
        """Compared channels, the columns of ``errors``."""
        return tuple(FLOORS)

    @property
    def pooled(self) -> list[float | None]:
        """Root mean square over the windows by channel; None where one is missing or a window failed."""
        squares = np.mean(self.errors**2, axis=0)
        return [float(np.sqrt(value)) if math.isfinite(value) else None for value in squares]

    @property
    def misfit(self) -> float:
        """Errors over `FLOORS`, geometric mean over windows and channels."""
        return float(np.exp(np.nanmean(self.logarithms() - np.log([*FLOORS.values()]))))

    def logarithms(self) -> np.ndarray:
        """Logarithms of the errors with their floors, (W, C)."""
        known = np.where(np.isinf(self.errors), _FAILED, self.errors)
        return np.asarray(np.log(np.hypot(known, np.array([*FLOORS.values()]))))


def _steps(stated: float) -> list[float]:
    """Changes of a stated n that are tried first; the first and last reach the ends of the range."""
    near = [step for step in _STEPS if _LEAST < stated + step < _MOST]
    ends = (_LEAST - stated, _MOST - stated)
    far = [n - stated for n in _GRID[1:-1] if all(abs(n - stated - step) > _APART for step in near)]
    inner = [step for step in near + far if ends[0] + _APART < step < ends[1] - _APART or step == 0.0]
    return sorted({*inner, *ends})


def _portions(windows: np.ndarray) -> list[np.ndarray]:
    """Windows (W,) in portions, every fifth, the rest of every other, and what is left."""
    place = np.arange(len(windows))
    early, middle = place % 5 == 0, place % 2 == 0
    return [windows[early], windows[middle & ~early], windows[~middle & ~early]]


class Trials:
    """Replays of several runs of one vehicle on one soil, by structure."""

    def __init__(self, logs: Sequence[Log]) -> None:
        self.prepared = [WindowReplay(log, _WINDOW, references=False) for log in logs]
        self.stated = float(logs[0].config.soil.n)
        count = sum(one.shape[0] for one in self.prepared)
        #: Windows to which n is fitted; the others are apart.
        self.fitted = np.arange(count) % 2 == 0
        #: The same in portions: what costs too much in some needs no others.
        self._portions = [np.isin(np.arange(count), part) for part in _portions(np.flatnonzero(self.fitted))]
        self._changes = _steps(self.stated)
        #: Errors of the windows to which n is fitted, and of those apart.
        self._known: dict[tuple[Case, float, bool], np.ndarray] = {}
        #: Errors of each portion of the former.
        self._early: dict[tuple[Case, float, int], np.ndarray] = {}

    def errors(self, case: Case, change: float) -> np.ndarray:
        """Root mean square errors (W, C) with n changed by so much; infinite where a window fails."""
        found = np.empty((len(self.fitted), len(FLOORS)))
        for fitted in (True, False):
            found[self.fitted == fitted] = self._part(case, change, fitted=fitted)
        return found

    def _cost_up_to(self, case: Case, change: float, most: float) -> float:
        """The cost in the fitted windows, or infinity once some of them alone cost more than ``most``."""
        key = (case, round(change, 6), True)
        if key not in self._known:
            found = np.zeros((len(self.fitted), len(FLOORS)))
            for place, rows in enumerate(self._portions):
                found[rows] = self._portion(case, change, place)
                if self._cost(found[self.fitted]) > most:
                    return math.inf
            self._known[key] = found[self.fitted]
        return self._cost(self._known[key])

    def _portion(self, case: Case, change: float, place: int) -> np.ndarray:
        """The rows of one portion of the windows to which n is fitted."""
        key = (case, round(change, 6), place)
        if key not in self._early:
            self._early[key] = self._in(case, change, self._portions[place])
        return self._early[key]

    def _least(self, case: Case, changes: Sequence[float]) -> float:
        """The change of n among ``changes`` that costs least."""
        found = self._below(case, changes, math.inf)
        return changes[0] if found is None else found

    def _below(self, case: Case, changes: Sequence[float], most: float) -> float | None:
        """The change of n among ``changes`` that costs least; of many, one that costs little at once.

        None where all cost ``most`` or more.
        """
        best: float | None = None
        if len(changes) > _KEPT and self._portions[0].any():
            changes = sorted(changes, key=lambda change: self._cost(self._portion(case, change, 0)))[:_KEPT]
        for change in sorted(changes, key=abs):
            cost = self._cost_up_to(case, change, most)
            if cost < most:
                best, most = change, cost
        return best

    def _part(self, case: Case, change: float, *, fitted: bool) -> np.ndarray:
        """The rows of the windows to which n is fitted, or of those apart: one needs no other."""
        key = (case, round(change, 6), fitted)
        if key not in self._known:
            self._known[key] = self._in(case, change, self.fitted == fitted)
        return self._known[key]

    def _in(self, case: Case, change: float, wanted: np.ndarray) -> np.ndarray:
        """The rows of the windows that are ``wanted`` (W,)."""
        ends = np.cumsum([one.shape[0] for one in self.prepared])[:-1]
        parts = zip(self.prepared, np.split(wanted, ends), strict=True)
        return np.concatenate([self._of(one, case, change, rows) for one, rows in parts])

    @staticmethod
    def _of(prepared: WindowReplay, case: Case, change: float, wanted: np.ndarray) -> np.ndarray:
        try:
            plant = plant_for(prepared.log, case)
        except OffroadError:
            return np.full((int(wanted.sum()), len(FLOORS)), math.inf)
        soil = plant.soil._replace(n=float(np.clip(plant.soil.n + change, _LEAST, _MOST)))
        return _errors_by_window(prepared, plant._replace(soil=soil), wanted)

    def with_effects(self, case: Case, setups: Sequence[Setup]) -> StructureTrial:
        """The nominal structure with effects, of which those of inputs and sensors are undone in the logs."""
        errors = []
        for prepared, setup in zip(self.prepared, setups, strict=True):
            stated = RunModel(prepared.log).setup
            corrected = WindowReplay(corrected_log(prepared.log, setup, stated), _WINDOW, references=False)
            errors.append(_errors_by_window(corrected, setup.plant))
        return StructureTrial(
            case=case, change=setups[0].plant.soil.n - self.stated, errors=np.concatenate(errors)
        )

    def best(self, case: Case, start: float | None = None) -> StructureTrial:
        """The structure with the n that suits the fitted windows, sought near ``start`` where it is given."""

        def cost(change: float) -> float:
            return self._cost(self._part(case, change, fitted=True))

        ends = (_LEAST - self.stated, _MOST - self.stated)
        near = [] if start is None else np.clip([start - _BESIDE, start, start + _BESIDE], *ends).tolist()
        changes = near or self._changes
        at = changes.index(self._least(case, changes))
        low, high = changes[max(at - 1, 0)], changes[min(at + 1, len(changes) - 1)]
        options = {"xatol": _ACCURACY, "maxiter": 8 if start is None else 5}
        minimize_scalar(cost, bounds=(low, high), method="bounded", options=options)
        known = (change for own, change, fitted in self._known if own == case and fitted)
        return self.near(case, min(known, key=cost))

    def near(self, case: Case, change: float) -> StructureTrial:
        """The structure with this change of n."""
        return StructureTrial(case=case, change=change, errors=self.errors(case, change))

    def inside(self, trial: StructureTrial) -> bool:
        """Whether the n of a structure is an optimum and not just an end of the range that was searched."""
        return _LEAST + 2.0 * _ACCURACY < self.stated + trial.change < _MOST - 2.0 * _ACCURACY

    def coarse(self, case: Case) -> StructureTrial:
        """The structure with the best of a few n."""
        return self.near(case, self._least(case, self._changes))

    def reaches(self, case: Case, most: float, change: float | None = None) -> bool:
        """Whether the structure costs less than ``most``, with any of a few n or the one that is given."""
        return self._below(case, self._changes if change is None else [change], most) is not None

    def cost(self, trial: StructureTrial) -> float:
        """Sum of the logarithms of the errors in the fitted windows."""
        return self._cost(trial.errors[self.fitted])

    @staticmethod
    def _cost(errors: np.ndarray) -> float:
        squares = np.mean(np.where(np.isinf(errors), _FAILED, errors) ** 2, axis=0)
        return float(np.nansum(np.log(np.sqrt(squares + np.array([*FLOORS.values()]) ** 2))))

    def apart(
        self, worse: StructureTrial, better: StructureTrial, *, everywhere: bool = False
    ) -> tuple[float, float]:
        """Mean logarithm of the ratio of errors over the windows apart, and its one-sided p-value."""
        change = np.nanmean(worse.logarithms() - better.logarithms(), axis=1)
        change = change if everywhere else change[~self.fitted]
        spread = float(np.std(change, ddof=1)) / math.sqrt(len(change)) if len(change) > 1 else math.inf
        mean = float(np.mean(change))
        if spread <= 0.0:
            return mean, 0.5 if mean <= 0.0 else 0.0
        return mean, float(student.sf(mean / spread, max(len(change) - 1, 1)))

    def gains(self, nominal: StructureTrial, best: StructureTrial) -> tuple[ChannelGain, ...]:
        """Errors by channel on the windows apart."""
        rng = np.random.default_rng(_SEED)
        found = []
        for k, name in enumerate(FLOORS):
            pair = [one.errors[~self.fitted, k] for one in (nominal, best)]
            both = np.isfinite(pair[0]) & np.isfinite(pair[1])
            if both.any():
                before, after = (values[both] ** 2 for values in pair)
                found.append(channel_gain(name, before, after, int(both.sum()), rng))
        return tuple(found)


def _errors_by_window(prepared: WindowReplay, plant: Plant, wanted: np.ndarray | None = None) -> np.ndarray:
    """Root mean square errors (W, C) of a model; infinite where a window fails.

    ``wanted`` (W,): in these windows alone.
    """
    try:
        errors = prepared.errors(plant, wanted)
    except OffroadError:
        count = prepared.shape[0] if wanted is None else int(wanted.sum())
        return np.full((count, len(FLOORS)), math.inf)
    failed = ~np.isfinite(errors["v_x"]).all(axis=1)
    roots = [np.sqrt(np.mean(errors[name] ** 2, axis=1)) for name in FLOORS]
    return np.stack([np.where(failed, math.inf, values) for values in roots], axis=1)
