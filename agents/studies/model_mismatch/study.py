"""``offroad reproduce mismatch``: filters on vehicles, grounds and sensors that differ from their model.

Units are one filter on one seed of one row under one mismatch. The Cramer-Rao bound with the model
uncertainty of the augmented bank, along the truth without mismatch, is a unit of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.analysis.scores import Score
from estimators.analysis.uncertain_bound import uncertain_bound
from estimators.experiments.buzhardt_tallapragada import ROWS, row_plant
from estimators.experiments.mismatch_comparison import (
    COMPARED,
    MismatchScore,
    MismatchSummary,
    robust_history,
    run_filter,
    score_mismatch,
    summarise_scores,
)
from estimators.experiments.model_mismatch import MISMATCHES, mismatched_row
from estimators.experiments.simulated_rows import REPORT_SEEDS, TUNING_SEEDS
from estimators.filters.augmented_ekf_bank import AugmentedBankSettings
from estimators.filters.registry import FILTERS, filter_id
from estimators.models.uncertain_half_car import ModelUncertainty, uncertain_model
from offroad_env.errors import InvalidParameter

__all__ = ["BARS", "BoundLine", "Mismatches", "bounds_of", "run_unit", "summaries_of"]

_BOUND = "bound"
#: Requirements on the augmented bank: largest median error, under one mismatch and under all together, and
#: least coverage while the flag is up; least share of the excited time with the flag up, with a matched model
#: and under one mismatch.
BARS = {"error": 0.05, "error_all": 0.1, "coverage": 0.9, "flag_matched": 0.9, "flag": 0.6}


class BoundLine(NamedTuple):
    """Least standard deviation of n on a row without mismatch, with the augmented bank's sensors, over n."""

    row: int
    all_uncertain: float  #: with the whole model uncertainty of the augmented bank, at the end [-]
    moduli_only: float  #: where the moduli alone are uncertain [-]
    certain: float  #: where everything but n is known [-]


def _bounds(row: int, seed: int, duration: float) -> dict[str, float]:
    """Bounds on sd(n)/n at the end, along the truth without mismatch."""
    settings = AugmentedBankSettings()
    no_noise = (1e-9, 1e-9, 1e-9, 1e-9, 1e-9)
    no_error = (*no_noise, 1e-9, 1e-9)
    exact_but_moduli = ModelUncertainty(
        mass=1e-6,
        lag=1e-6,
        place=1e-6,
        acceleration_bias=1e-6,
        rate_bias=1e-6,
        misalignment=1e-6,
        rim=1e-6,
        process=no_noise,
        error=no_error,
    )
    uncertainties = {
        "all_uncertain": settings.uncertainty,
        "moduli_only": exact_but_moduli,
        "certain": replace(exact_but_moduli, stiffness=1e-6, slip_sinkage=(1e-6, 1e-6)),
    }
    drive = mismatched_row(ROWS[row - 1], "none", seed, settings.joint, duration=duration)
    z = drive.readings(FILTERS["augmented_ekf_bank"].sensors)
    result = {}
    for name, uncertainty in uncertainties.items():
        model = uncertain_model(row_plant(drive.row), drive.dt, settings.joint, uncertainty)
        prior = (settings.n_prior_sd, settings.bump)
        bound, _ = uncertain_bound(model, prior, drive.truth, drive.inputs, z)
        result[name] = float(bound[-1] / drive.n[-1])
    return result


def run_unit(name: str, mismatch: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """Scores of one filter (or the bounds) on one seed of a row under a mismatch, as plain numbers.

    ``robust``: with an interval and a flag that are robust to model errors; ``stated``: as stated by the
    filter, given its model.
    """
    if name == _BOUND:
        return dict(_bounds(row, seed, duration))
    drive = mismatched_row(ROWS[row - 1], mismatch, seed, duration=duration)
    stated = run_filter(name, drive)
    robust = robust_history(name, drive, stated)
    return {
        "robust": _plain(score_mismatch(name, drive, robust)),
        "stated": _plain(score_mismatch(name, drive, stated)),
    }


def _plain(run: MismatchScore) -> dict[str, Any]:
    return {**run._asdict(), "score": run.score._asdict()}


def _read(numbers: Mapping[str, Any]) -> MismatchScore:
    return MismatchScore(**{**numbers, "score": Score(**numbers["score"])})


def summaries_of(results: Mapping[Key, Mapping[str, Any]], part: str = "robust") -> list[MismatchSummary]:
    """A line for every filter and mismatch from the results by (filter, mismatch, row, seed, duration).

    ``part`` : "robust" or "stated", see `run_unit`.
    """
    groups: dict[Key, list[MismatchScore]] = {}
    for key, result in results.items():
        if key[0] != _BOUND:
            groups.setdefault(key[:2], []).append(_read(result[part]))
    return [summarise_scores(runs) for runs in groups.values()]


def bounds_of(results: Mapping[Key, Mapping[str, Any]]) -> list[BoundLine]:
    """A line for every row: medians over the seeds."""
    found: dict[int, list[Mapping[str, Any]]] = {}
    for key, result in results.items():
        if key[0] == _BOUND:
            found.setdefault(key[2], []).append(result)
    names = BoundLine._fields[1:]
    return [
        BoundLine(row, *(float(np.median([result[name] for result in own])) for name in names))
        for row, own in sorted(found.items())
    ]


@dataclass(kw_only=True)
class Mismatches(Results):
    """Filters whose model is wrong: mass, map, soil moduli, sensors, steering, slip sinkage.

    Median error of n, coverage of the 95 % interval and the validity flag for every filter, each
    mismatch alone and all together. Writes mismatch.png, and mismatch.jsonl with the result of every
    run: a run that is there is not repeated.
    """

    quick: bool = False  #: two rows, one seed and 20 s: to see that it works
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    seeds: int = 5  #: noise seeds a row, of those set aside for reporting
    first_seed: int = 0  #: how many of those to leave out: seeds on which no result was seen before
    tuning: bool = False  #: use the seeds on which settings were chosen instead
    only: tuple[str, ...] = ()  #: these filters: ids, or robust bank embedded propagated
    under: tuple[str, ...] = ()  #: these mismatches
    duration: float = 60.0  #: of a run [s]
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.model_mismatch.figure import mismatch_figure

        if self.quick:
            self.rows, self.seeds, self.duration = (3, 7), 1, 20.0
        if not 5.0 <= self.duration <= 1000.0:
            raise InvalidParameter(f"duration must be in [5, 1000] s, got {self.duration:g}")
        results = run_units(
            self.out / "mismatch.jsonl", run_unit, self._units(), label="mismatch", n_jobs=self.n_jobs
        )
        summaries, stated, bounds = summaries_of(results), summaries_of(results, "stated"), bounds_of(results)
        _show("robust to model errors", summaries)
        own = [line for line in stated if FILTERS[line.filter].exact_model]
        if own:
            _show("as stated by the filter, given its model", own)
        say(
            "error, 90 %, covers: while the flag is up; flag up: of the time that steering or roughness acts;"
        )
        say("silent: runs with the flag up for 2 s or more at an error above 20 %, outside of their interval")
        _show_worst(summaries)
        _show_bounds(bounds)
        self.save_figure(
            mismatch_figure(summaries, stated, BARS),
            "mismatch",
            "Bars: robust to model errors; ticks: as stated by the filter, given its model; dashed: "
            "required.",
        )
        runs = [result for key, result in results.items() if key[0] != _BOUND]
        self.save_numbers(
            {
                "summaries": summaries,
                "stated": stated,
                "bounds": bounds,
                "bars": BARS,
                "mismatches": MISMATCHES,
                "runs": runs,
                "duration": self.duration,
            }
        )

    def _units(self) -> dict[Key, str]:
        names = tuple(filter_id(name, COMPARED, label="only") for name in self.only or COMPARED)
        under = _chosen("under", self.under, tuple(MISMATCHES))
        known = TUNING_SEEDS if self.tuning else REPORT_SEEDS
        if not 0 <= self.first_seed < len(known):
            raise InvalidParameter(f"first_seed must be in [0, {len(known) - 1}], got {self.first_seed}")
        seeds = checked_seeds(self.seeds, known[self.first_seed :])
        stamps = {name: stamp_of(FILTERS[name].module, *_sources(name)) for name in names}
        bound = stamp_of("estimators.models.uncertain_half_car", "estimators.experiments.model_mismatch")
        units: dict[Key, str] = {}
        for seed in seeds:
            for row in checked_rows(self.rows):
                units[_BOUND, "none", row, seed, float(self.duration)] = bound
                for name, stamp in stamps.items():
                    for mismatch in under:
                        units[name, mismatch, row, seed, float(self.duration)] = stamp
        return units


def _sources(name: str) -> tuple[str, ...]:
    """What the results of a filter depend on besides the filter."""
    evidence = ("estimators.filters.model_evidence",) if FILTERS[name].exact_model else ()
    return ("estimators.experiments.model_mismatch", *evidence)


def _chosen(name: str, asked: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [value for value in asked if value not in known]
    if unknown:
        raise InvalidParameter(f"{name} must name some of {', '.join(known)}, got {unknown[0]!r}")
    return asked or known


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f}" if math.isfinite(value) else "-"


def _show(title: str, summaries: Sequence[MismatchSummary]) -> None:
    heading = (
        "mismatch", "filter", "runs", "error", "90 %", "covers", "flag up", "error, any flag", "covers",
        "silent", "x real time",
    )  # fmt: skip
    order = {name: i for i, name in enumerate(MISMATCHES)}
    body = [
        (
            MISMATCHES[line.mismatch].title,
            FILTERS[line.filter].title,
            str(line.runs),
            _percent(line.error),
            _percent(line.error_high),
            _percent(line.coverage),
            _percent(line.flag, 0),
            _percent(line.error_all),
            _percent(line.coverage_all),
            str(line.silent),
            f"{line.real_time_factor:.0f}",
        )
        for line in sorted(summaries, key=lambda line: order[line.mismatch])
    ]
    console().print(table(f"{title}: in per cent; errors relative to the true n", heading, body, texts=2))


def _show_worst(summaries: Sequence[MismatchSummary]) -> None:
    worst = {
        name: max(
            (line for line in summaries if line.filter == name and line.mismatch not in ("none", "all")),
            key=lambda line: line.error_all,
            default=None,
        )
        for name in dict.fromkeys(line.filter for line in summaries)
    }
    for name, line in worst.items():
        if line is not None:
            say(f"{FILTERS[name].title}: {MISMATCHES[line.mismatch].title} costs most accuracy")


def _show_bounds(bounds: Sequence[BoundLine]) -> None:
    body = [
        (str(b.row), _percent(b.all_uncertain), _percent(b.moduli_only), _percent(b.certain, 2))
        for b in bounds
    ]
    heading = ("row", "whole model uncertain", "moduli uncertain", "only n unknown")
    console().print(table("least sd of n at the end, in per cent of n (Cramer-Rao)", heading, body))
