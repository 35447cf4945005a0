"""``offroad reproduce adaptation``: prediction on unseen soils, by physical and learned models.

Units are a drive with all physical methods, or one training of a learned method with its predictions on all
drives. What is chosen - the soil that nominal model and filter for n assume, size and width of the networks -
is chosen on the tuning drives, four candidates each; errors are those of the test drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.learning.learners import MissingExtraError
from agents.reports.output import Results, console, say, table
from agents.studies.adaptation.results import (
    FITTED,
    ONLINE,
    Comparison,
    MethodLine,
    comparisons,
    method_lines,
    plain_errors,
)
from agents.studies.runner import Key, run_units, stamp_of
from estimators.experiments.adaptation import (
    believed,
    filtered_n,
    fitted,
    nominal_plant,
    predicted,
    true_plant,
)
from estimators.experiments.motion_sequences import (
    AT,
    DriveSequence,
    drive_of,
    prediction_error,
    sequence_of,
)
from estimators.experiments.unknown_soils import SoilRun
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.simulator import Plant

__all__ = ["Adaptation", "run_unit"]

#: Soils of the nominal model and of the filter for n; widths of the networks and their numbers of a soil.
_SOILS = ("population", "dry_sand", "clay", "lete_sand")
_CHOICES = ((64, 8), (64, 4), (128, 8), (64, 16))
#: Soils of training among which the networks are chosen.
_CHOSEN_AT = 100
LEARNED = {"function_encoder": "function encoder", "meta_kalman": "meta-learned, Kalman filter"}
_TUNING, _TEST, _TRAINING = "tuning", "test", "training"
#: Halves of the fitted belief with the truth of the other half.
_ITS_VEHICLE, _ITS_SOIL = f"{FITTED}'s vehicle, true soil", f"{FITTED}'s soil, true vehicle"
#: What a fitted unit has, in the order of the tables.
_OF_THE_FIT = (
    FITTED,
    _ITS_VEHICLE,
    _ITS_SOIL,
    "oracle of the soil alone",
    "oracle",
)
#: Kinds of units.
_PHYSICAL, _FITTED, _NETWORK = "physical", "fitted", "network"


class _Size(NamedTuple):
    """How much is done."""

    tuning: int  #: drives
    test: int
    rounds: int  #: of training


def _physical_unit(seed: int, split: str) -> dict[str, Any]:
    """Errors (times, 2) of every physical method on a drive."""
    run = drive_of(seed, split)
    models = {ONLINE: believed(run)}
    for soil in _SOILS:
        models[f"nominal {soil}"] = [[nominal_plant(soil)]] * len(AT)
        models[f"filter for n {soil}"] = filtered_n(run, soil)
    return _errors_on(run, models)


def _fitted_unit(seed: int) -> dict[str, Any]:
    """The same of the fitted belief, with the truth for either half of it, and of who knows the truth."""
    run = drive_of(seed, _TEST)
    truth, known = true_plant(run), [fit.plant for fit in fitted(run)]
    models = {
        FITTED: [[plant] for plant in known],
        _ITS_VEHICLE: [[plant._replace(soil=truth.soil)] for plant in known],
        _ITS_SOIL: [[plant._replace(vehicle=truth.vehicle)] for plant in known],
        "oracle of the soil alone": [[nominal_plant("population")._replace(soil=truth.soil)]] * len(AT),
        "oracle": [[truth]] * len(AT),
    }
    return _errors_on(run, models)


def _errors_on(run: SoilRun, models: Mapping[str, Sequence[Sequence[Plant]]]) -> dict[str, Any]:
    """Errors (times, 2) of methods on a drive, from the models that each has at `AT`."""
    found = {}
    for name, plants in models.items():
        ends = [predicted(plants[i], run, at) for i, at in enumerate(AT)]
        found[name] = plain_errors(np.array([prediction_error(run, at, ends[i]) for i, at in enumerate(AT)]))
    return found


@cache
def _sequence(seed: int, split: str) -> DriveSequence:
    return sequence_of(drive_of(seed, split))


def _network_unit(
    method: str, soils: int, choice: int, tuning: int, test: int, rounds: int
) -> dict[str, Any]:
    """Errors (drives, times, 2) of a learned method on the tuning and on the test drives."""
    import torch

    from agents.studies.adaptation.learned import Choice, final_states, tensors_of, train

    torch.set_num_threads(1)
    width, size = _CHOICES[choice]
    data = tensors_of([_sequence(seed, _TRAINING) for seed in range(soils)])
    check = tensors_of([_sequence(seed, _TUNING) for seed in range(tuning)])
    model = train(Choice(width=width, size=size), method, data, check, rounds=rounds, seed=soils)
    found = {}
    for split, count in ((_TUNING, tuning), (_TEST, test)):
        drives = tensors_of([_sequence(seed, split) for seed in range(count)])
        ends = np.stack([final_states(model, drives, method, at) for at in AT], axis=1)
        found[split] = plain_errors(
            np.array(
                [
                    [prediction_error(drive_of(seed, split), at, ends[seed, i]) for i, at in enumerate(AT)]
                    for seed in range(count)
                ]
            )
        )
    return found


_WORK: dict[str, Callable[..., dict[str, Any]]] = {
    _PHYSICAL: _physical_unit,
    _FITTED: _fitted_unit,
    _NETWORK: _network_unit,
}


def run_unit(kind: str, *key: Any) -> dict[str, Any]:
    """A unit of the study by its key."""
    return _WORK[kind](*key)


def _check_torch() -> None:
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"the learned models need torch ({error}): pip install offroad-bekker[rl]"
        ) from error


def _best(scores: Mapping[Any, np.ndarray]) -> Any:
    """The candidate with the least mean error of position after 5 s on the tuning drives."""
    return min(scores, key=lambda name: float(np.mean(scores[name][:, 1, 0])))


@dataclass(kw_only=True)
class Adaptation(Results):
    """Position and speed 3 s ahead on unseen soils, after 2, 5 and 10 s of driving on them.

    Nominal model, filter for n, beliefs over whole soils on line and fitted to all samples, two learned
    models by soils of training, and an oracle (needs the extra rl). Writes adaptation.png, and
    adaptation.jsonl with the result of every unit: a unit that is there is not repeated.
    """

    fitted: bool = False  #: only the fitted belief and the oracles, without a figure
    quick: bool = False  #: 6 tuning and 8 test drives, networks hardly trained
    soils: tuple[int, ...] = (30, 100, 300)  #: of training, for the learned models
    test: int = 200  #: test drives
    tuning: int = 40  #: tuning drives
    rounds: int = 1500  #: of training
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.adaptation.figure import adaptation_figure

        if not self.fitted:
            _check_torch()
        if self.quick:
            self.test, self.tuning, self.rounds, self.soils = 8, 6, 20, self.soils[:1]
        if min(self.test, self.tuning, self.rounds, *self.soils) < 1 or not self.soils:
            raise InvalidParameter("test, tuning, rounds and soils must be 1 or more")
        errors, chosen = ({}, {}) if self.fitted else self._physical()
        errors |= self._fitted()
        learned: dict[int, tuple[str, ...]] = {}
        for method in () if self.fitted else LEARNED:
            found, chosen[LEARNED[method]] = self._networks(method)
            for soils, result in found.items():
                name = f"{LEARNED[method]}, {soils} soils"
                errors[name] = np.array(result[_TEST])
                learned[soils] = (*learned.get(soils, ()), name)
        lines, ratios = method_lines(errors), comparisons(errors, learned)
        _show(lines, ratios, chosen)
        if not self.fitted:
            self.save_figure(
                adaptation_figure(lines, self.soils, tuple(LEARNED.values())),
                "adaptation",
                "Errors 3 s ahead with 95 % intervals over the drives, logarithmic: lower is better.",
            )
        self.save_numbers({"methods": lines, "comparisons": ratios, "chosen": chosen, "drives": self.test})

    def _run(self, units: dict[Key, str]) -> dict[Key, dict[str, Any]]:
        return run_units(
            self.out / "adaptation.jsonl", run_unit, units, label="adaptation", n_jobs=self.n_jobs
        )

    def _physical(self) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Errors on the test drives by method, and the soils that were chosen."""
        stamp = stamp_of("estimators.experiments.adaptation")
        counts = {_TUNING: self.tuning, _TEST: self.test}
        found = self._run(
            {(_PHYSICAL, seed, split): stamp for split, count in counts.items() for seed in range(count)}
        )

        def errors(name: str, split: str) -> np.ndarray:
            return np.array([found[_PHYSICAL, seed, split][name] for seed in range(counts[split])])

        chosen = {}
        for method in ("nominal", "filter for n"):
            chosen[method] = _best({soil: errors(f"{method} {soil}", _TUNING) for soil in _SOILS})
        return {
            "nominal": errors(f"nominal {chosen['nominal']}", _TEST),
            "filter for n": errors(f"filter for n {chosen['filter for n']}", _TEST),
            ONLINE: errors(ONLINE, _TEST),
        }, chosen

    def _fitted(self) -> dict[str, np.ndarray]:
        """Errors on the test drives of the fitted belief and the oracles."""
        stamp = stamp_of("estimators.experiments.adaptation")
        found = self._run({(_FITTED, seed): stamp for seed in range(self.test)})
        return {name: np.array([unit[name] for unit in found.values()]) for name in _OF_THE_FIT}

    def _networks(self, method: str) -> tuple[dict[int, dict[str, Any]], str]:
        """Results by soils of training, and the network that was chosen."""
        stamp = stamp_of("agents.studies.adaptation.learned")
        size = _Size(self.tuning, self.test, self.rounds)
        first = _CHOSEN_AT if _CHOSEN_AT in self.soils else self.soils[0]
        candidates = range(1 if self.quick else len(_CHOICES))
        found = self._run({(_NETWORK, method, first, i, *size): stamp for i in candidates})
        best = _best({i: np.array(found[_NETWORK, method, first, i, *size][_TUNING]) for i in candidates})
        units = {(_NETWORK, method, soils, best, *size): stamp for soils in self.soils}
        results = self._run(units)
        width, numbers = _CHOICES[best]
        return {
            key[2]: result for key, result in results.items()
        }, f"width {width}, {numbers} numbers of a soil"


def _show(lines: Sequence[MethodLine], ratios: Sequence[Comparison], chosen: Mapping[str, str]) -> None:
    for quantity, unit in (("position", "m"), ("speed", "m/s")):
        body: dict[str, list[str]] = {}
        for line in lines:
            values = (getattr(line, f"{quantity}{part}") for part in ("", "_low", "_high", "_median"))
            mean, low, high, median = values
            body.setdefault(line.method, []).append(f"{mean:.2f} [{low:.2f}, {high:.2f}] {median:.2f}")
        heading = ("method", *(f"after {at:g} s" for at in AT))
        title = f"error of {quantity} 3 s ahead [{unit}]: mean, its 95 % interval, median"
        console().print(table(title, heading, [(name, *cells) for name, cells in body.items()]))
    rows = [
        (
            f"{found.methods[0]} / {found.methods[1]}",
            found.quantity,
            f"{found.at:g} s",
            f"{found.ratio:.2f} [{found.low:.2f}, {found.high:.2f}]",
            f"{found.bar:g}",
            "met" if found.met else "missed",
        )
        for found in ratios
    ]
    heading = ("ratio of mean errors", "of", "after", "ratio", "at most", "")
    console().print(table("requirements", heading, rows, texts=2))
    if chosen:
        say("chosen on the tuning drives: " + "; ".join(f"{name}: {value}" for name, value in chosen.items()))
