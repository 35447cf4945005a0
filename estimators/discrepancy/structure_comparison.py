"""Structure as a cause: other laws of wheel and soil, or four wheels with roll, on windows kept apart.

A structure has no size that could be fitted, so none is a small step from the nominal model, and single steps
can make a fit worse (shear that stays in the soil without ruts to carry it). Presets are therefore tried
whole, each with its own n; the best is pruned by putting its laws back one by one. Everything is judged by
the open-loop errors of `estimators.replay` on every second window, while n is fitted to the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

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
from offroad_env.errors import DataError, OffroadError
from offroad_env.physics.axle import Plant
from offroad_env.world.structures import STRUCTURES

__all__ = [
    "STRUCTURAL_CAUSES",
    "StructuralCause",
    "StructureComparison",
    "StructureTrial",
    "compare_structures",
    "gains_with",
]

#: Structural causes: what the vehicle or the soil does that the nominal model does not.
STRUCTURAL_CAUSES: Mapping[str, str] = MappingProxyType(
    {
        "pressure_direction": "pressure acts along the ground's normal, so that compaction loads the torque",
        "pressure_distribution": "contact ends where the soil's own sinkage has it, not at angles after Wong",
        "soil_frame_shear": "shear grows along the path of the wheel in the soil",
        "ruts": "rear wheels run in ruts that the front wheels have compacted and sheared",
        "effective_width": "pressure follows the width of the whole contact patch",
        "slip_sinkage": "slip digs wheels in",
        "shaft_torque": "torques act on the wheels without a reaction on the body",
        "four_wheels_and_roll": "four wheels bear their own loads, and the body rolls",
    }
)
#: Law by cause, and what must go with it where the law is put back.
_LAWS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "pressure_direction": {"pressure_direction": "rim_normal"},
        "pressure_distribution": {"pressure_from": "wong_reece", "ruts": "none"},
        "soil_frame_shear": {"shear": "wheel_frame", "ruts": "pressure"},
        "ruts": {"ruts": "none"},
        "effective_width": {"width": "rim"},
        "slip_sinkage": {"slip_sinkage": "none"},
        "shaft_torque": {"shaft_torque": "reacted"},
    }
)
#: Presets that are tried whole, besides the nominal structure, and models of the vehicle.
_PRESETS, _VEHICLES = ("grid", "field"), ("half_car", "four_wheel")
_FOUR = "four_wheels_and_roll"
#: Length of the windows [s].
_WINDOW = 3.0
#: Compared channels: errors below which differences do not count, and one that counts as a failure.
_FLOORS: Mapping[str, float] = MappingProxyType(
    {"v_x": 0.02, "v_y": 0.02, "yaw_rate": 0.008, "omega_f": 0.15, "omega_r": 0.15, "a_y": 0.08}
)
_FAILED = 50.0
#: Search of n: over all that soils have, since a stated n may be far off, closer around the stated one.
_GRID = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.05, 1.2, 1.4, 1.6)
_STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
_LEAST, _MOST = _GRID[0], _GRID[-1]
#: Values of the grid this near to one that is tried anyway are left out; accuracy of n; steps from a known n.
_APART, _ACCURACY, _BESIDE = 0.06, 0.004, 0.05
#: A preset is looked at closely if it costs this much less than the nominal structure.
_WORTH = 0.3
#: A structure is named if errors fall by this share of themselves at least (mean logarithm over channels),
#: with this p-value over the windows apart, of which there must be so many.
_GAIN, _P_VALUE, _WINDOWS = 0.35, 1e-2, 3
#: A law stays if errors grow by this mean logarithm without it, and is named with this p-value.
_LOSS, _LOSS_P = 0.03, 0.01
#: Errors that differ by less than this share (mean logarithm over channels) do not decide between a structure
#: and effects.
_AS_GOOD = 0.1
_SEED = 0


@dataclass(frozen=True, kw_only=True)
class StructureTrial:
    """One structure, with the n that suits it best."""

    case: Case
    change: float  #: of n, against the stated one [-]
    errors: np.ndarray  #: (W, C) root mean square errors by window and channel of `_FLOORS`

    @staticmethod
    def channels() -> tuple[str, ...]:
        """Compared channels, the columns of ``errors``."""
        return tuple(_FLOORS)

    @property
    def pooled(self) -> list[float | None]:
        """Root mean square over the windows by channel; None where one is missing or a window failed."""
        squares = np.mean(self.errors**2, axis=0)
        return [float(np.sqrt(value)) if math.isfinite(value) else None for value in squares]

    def logarithms(self) -> np.ndarray:
        """Logarithms of the errors with their floors, (W, C)."""
        known = np.where(np.isinf(self.errors), _FAILED, self.errors)
        return np.asarray(np.log(np.hypot(known, np.array([*_FLOORS.values()]))))


@dataclass(frozen=True, kw_only=True)
class StructuralCause:
    """A part of the structure that the nominal model lacks."""

    id: str  #: of `STRUCTURAL_CAUSES`
    gain: float  #: share by which errors grow without it
    p_value: float

    @property
    def sentence(self) -> str:
        """What it is."""
        return STRUCTURAL_CAUSES[self.id]


@dataclass(frozen=True, kw_only=True)
class StructureComparison:
    """Outcome of the comparison of structures."""

    nominal: StructureTrial
    best: StructureTrial
    trials: tuple[StructureTrial, ...]  #: presets, best first
    equals: tuple[Case, ...]  #: presets that are as good
    causes: tuple[StructuralCause, ...]  #: empty where the nominal structure is adequate
    gain: float  #: share by which the errors fall
    p_value: float
    n: float  #: with the best structure [-]
    gains: tuple[ChannelGain, ...]  #: by channel, on windows apart
    #: Share by which errors fall from those of the nominal structure with effects; None without effects.
    gain_over_effects: float | None = None

    @property
    def found(self) -> bool:
        """Whether another structure is named: effects of the nominal one do not predict better."""
        return bool(self.causes) and (self.gain_over_effects is None or self.gain_over_effects > -_AS_GOOD)

    @property
    def tied(self) -> bool:
        """Whether the nominal structure with effects predicts as well, so that neither is certain."""
        return self.found and self.gain_over_effects is not None and self.gain_over_effects < _AS_GOOD

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {
            "found": self.found,
            "tied": self.tied,
            "structure": self.best.case.structure,
            "vehicle_model": self.best.case.vehicle_model,
            "n": self.n,
            "n_nominal": self.n - self.best.change + self.nominal.change,
            "gain": self.gain,
            "gain_over_effects": self.gain_over_effects,
            "p": self.p_value,
            "causes": [
                {"id": one.id, "gain": one.gain, "p": one.p_value, "sentence": one.sentence}
                for one in self.causes
            ],
            "equally_good": [
                {"structure": c.structure, "vehicle_model": c.vehicle_model} for c in self.equals
            ],
            "trials": [
                {
                    "structure": one.case.structure,
                    "vehicle_model": one.case.vehicle_model,
                    "change_of_n": one.change,
                    "error": dict(zip(_FLOORS, one.pooled, strict=True)),
                }
                for one in (self.nominal, *self.trials)
            ],
        }


def _steps(stated: float) -> list[float]:
    """Changes of a stated n that are tried first; the first and last reach the ends of the range."""
    near = [step for step in _STEPS if _LEAST < stated + step < _MOST]
    ends = (_LEAST - stated, _MOST - stated)
    far = [n - stated for n in _GRID[1:-1] if all(abs(n - stated - step) > _APART for step in near)]
    inner = [step for step in near + far if ends[0] + _APART < step < ends[1] - _APART or step == 0.0]
    return sorted({*inner, *ends})


class _Trials:
    """Replays of several runs of one vehicle on one soil, by structure."""

    def __init__(self, logs: Sequence[Log]) -> None:
        self.prepared = [WindowReplay(log, _WINDOW, references=False) for log in logs]
        self.stated = float(logs[0].config.soil.n)
        count = sum(one.shape[0] for one in self.prepared)
        #: Windows to which n is fitted; the others are apart.
        self.fitted = np.arange(count) % 2 == 0
        self._changes = _steps(self.stated)
        #: Errors of the windows to which n is fitted, and of those apart.
        self._known: dict[tuple[Case, float, bool], np.ndarray] = {}

    def errors(self, case: Case, change: float) -> np.ndarray:
        """Root mean square errors (W, C) with n changed by so much; infinite where a window fails."""
        found = np.empty((len(self.fitted), len(_FLOORS)))
        for fitted in (True, False):
            found[self.fitted == fitted] = self._part(case, change, fitted=fitted)
        return found

    def _part(self, case: Case, change: float, *, fitted: bool) -> np.ndarray:
        """The rows of the windows to which n is fitted, or of those apart: one needs no other."""
        key = (case, round(change, 6), fitted)
        if key not in self._known:
            ends = np.cumsum([one.shape[0] for one in self.prepared])[:-1]
            wanted = np.split(self.fitted == fitted, ends)
            parts = zip(self.prepared, wanted, strict=True)
            self._known[key] = np.concatenate([self._of(one, case, change, rows) for one, rows in parts])
        return self._known[key]

    @staticmethod
    def _of(prepared: WindowReplay, case: Case, change: float, wanted: np.ndarray) -> np.ndarray:
        try:
            plant = plant_for(prepared.log, case)
        except OffroadError:
            return np.full((int(wanted.sum()), len(_FLOORS)), math.inf)
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
        at = int(np.argmin([cost(change) for change in changes]))
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
        return self.near(
            case, min(self._changes, key=lambda change: self._cost(self._part(case, change, fitted=True)))
        )

    def cost(self, trial: StructureTrial) -> float:
        """Sum of the logarithms of the errors in the fitted windows."""
        return self._cost(trial.errors[self.fitted])

    @staticmethod
    def _cost(errors: np.ndarray) -> float:
        squares = np.mean(np.where(np.isinf(errors), _FAILED, errors) ** 2, axis=0)
        return float(np.nansum(np.log(np.sqrt(squares + np.array([*_FLOORS.values()]) ** 2))))

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
        for k, name in enumerate(_FLOORS):
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
        return np.full((count, len(_FLOORS)), math.inf)
    failed = ~np.isfinite(errors["v_x"]).all(axis=1)
    roots = [np.sqrt(np.mean(errors[name] ** 2, axis=1)) for name in _FLOORS]
    return np.stack([np.where(failed, math.inf, values) for values in roots], axis=1)


def compare_structures(
    logs: Sequence[Log], setups: Sequence[Setup] | None = None
) -> StructureComparison | None:
    """Whether another structure predicts these runs better than the nominal one can with any n.

    None where it cannot be compared: on hard ground, by the paper's model, without torques at the wheels or
    positions, or with too few windows.

    Parameters
    ----------
    setups
        The runs with the effects that were found, as fitted: a structure must predict better than these, too.
        Default: there are no effects.
    """
    first = logs[0].config
    if first.model != "full" or first.soil.rigid > 0.5:
        return None
    try:
        trials = _Trials(logs)
    except DataError:
        return None
    if int((~trials.fitted).sum()) < _WINDOWS:
        return None
    nominal = trials.best(Case(first.structure, _VEHICLES[0]))
    found = _presets(trials, nominal)
    best = found[0]
    gain, p_value = trials.apart(nominal, best)
    causes: tuple[StructuralCause, ...] = ()
    equals: tuple[Case, ...] = ()
    if gain > _GAIN and p_value < _P_VALUE and trials.inside(best):
        equals = tuple(one.case for one in found[1:] if not _worse(trials, one, best))
        best, causes = _pruned(trials, nominal, best)
        gain, p_value = trials.apart(nominal, best)
    over: float | None = None
    if causes and setups is not None:
        over = 1.0 - math.exp(-trials.apart(trials.with_effects(nominal.case, setups), best)[0])
    return StructureComparison(
        nominal=nominal,
        best=best,
        trials=tuple(found),
        equals=equals,
        causes=causes,
        gain=1.0 - math.exp(-gain),
        p_value=p_value,
        n=trials.stated + best.change,
        gains=trials.gains(nominal, best),
        gain_over_effects=over,
    )


def _presets(trials: _Trials, nominal: StructureTrial) -> list[StructureTrial]:
    """The presets, best first; with all vehicle models where one of them looks better than the nominal."""
    half, four = _VEHICLES
    names = [name for name in _PRESETS if name != nominal.case.structure]
    found = [trials.coarse(Case(name, half)) for name in names]
    found.append(trials.near(Case(nominal.case.structure, four), nominal.change))
    if min(map(trials.cost, found)) < trials.cost(nominal) - _WORTH:
        found = [trials.best(one.case, start=one.change) for one in found]
        found += [trials.best(Case(one.case.structure, four), start=one.change) for one in found[:-1]]
    return sorted(found, key=trials.cost)


def gains_with(found: StructureComparison, log: Log) -> tuple[ChannelGain, ...]:
    """Errors of the nominal and of the other structure by channel on another run; nothing is fitted.

    Raises
    ------
    DataError
        If the run is too short or lacks inputs or pose.
    """
    trials = _Trials([log])
    pair = [replace(one, errors=trials.errors(one.case, one.change)) for one in (found.nominal, found.best)]
    trials.fitted[:] = False
    return trials.gains(pair[0], pair[1])


def _worse(trials: _Trials, one: StructureTrial, best: StructureTrial) -> bool:
    loss, p_value = trials.apart(one, best)
    return loss > _LOSS and p_value < _LOSS_P


# ------------------------------------------------------------------ pruning


def _parts(case: Case, nominal: Case) -> list[str]:
    """Structural causes by which a case departs from the nominal one."""
    own, usual = (_laws(one.structure) for one in (case, nominal))
    found = [
        cause for cause, laws in _LAWS.items() if own.get(next(iter(laws))) != usual.get(next(iter(laws)))
    ]
    return found + ([_FOUR] if case.vehicle_model != nominal.vehicle_model else [])


def _laws(structure: str) -> dict[str, str]:
    """Departures of a structure from "full", by law."""
    preset, *changes = structure.split(",")
    named = dict(change.split("=") for change in changes)
    return {
        law: option
        for law, option in {**STRUCTURES[preset], **named}.items()
        if option != _LAWS_PUT_BACK.get(law)
    }


#: Option of every law in the structure "full".
_LAWS_PUT_BACK: Mapping[str, str] = MappingProxyType(
    {law: laws[law] for cause, laws in _LAWS.items() for law in laws if law == next(iter(laws))}
)


def _without(case: Case, cause: str, nominal: Case) -> Case:
    """The case with one cause put back, and with it what needs it."""
    if cause == _FOUR:
        return Case(case.structure, nominal.vehicle_model)
    preset, *changes = case.structure.split(",")
    named = dict(change.split("=") for change in changes)
    back = dict(_LAWS[cause])
    if "ruts" in back and named.get("ruts") == "none":
        back["ruts"] = "none"
    return Case(
        ",".join([preset, *(f"{law}={option}" for law, option in {**named, **back}.items())]),
        case.vehicle_model,
    )


def _pruned(
    trials: _Trials, nominal: StructureTrial, best: StructureTrial
) -> tuple[StructureTrial, tuple[StructuralCause, ...]]:
    """The structure without the laws that the windows do not show, and those that they show."""
    causes: dict[str, StructuralCause] = {}
    for cause in reversed(_parts(best.case, nominal.case)):
        less = _without(best.case, cause, nominal.case)
        trial = trials.near(less, best.change)
        # Both have one n, so that all windows compare them fairly.
        loss, p_value = trials.apart(trial, best, everywhere=True)
        if loss > _LOSS:
            # Another n may make up for what is left out.
            trial = trials.best(less, start=best.change)
            loss, p_value = trials.apart(trial, best, everywhere=True)
        if loss > _LOSS:
            causes[cause] = StructuralCause(id=cause, gain=math.exp(loss) - 1.0, p_value=p_value)
        else:
            best = trial
    left = _parts(best.case, nominal.case)
    shown = [one for name, one in causes.items() if name in left and one.p_value < _LOSS_P]
    kept = sorted(shown, key=lambda one: -one.gain)
    return best, tuple(kept)
