"""``offroad reproduce mismatch``: filters on vehicles, grounds and sensors that they do not believe in.

Units are one filter on one seed of one row under one mismatch; what any filter with the robust
bank's doubts could know along the truth without mismatch is a unit of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.commands.output import Results, console, say, table
from agents.studies.units import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.mismatch import MISMATCHES, mismatched_twin
from estimators.mismatch_runs import (
    FILTERS,
    MismatchSummary,
    Verdict,
    in_doubt,
    judge,
    run_filter,
    summarise_verdicts,
)
from estimators.nuisances import CHANNELS, bound_with_doubt, doubt_model
from estimators.paper import ROWS
from estimators.protocol_runs import REPORT_SEEDS, TUNING_SEEDS, row_plant
from estimators.robust import RobustSettings
from offroad_env.errors import InvalidParameter

__all__ = ["BARS", "BoundLine", "Mismatches", "bounds_of", "run_unit", "summaries_of"]

_BOUND = "bound"
#: What the robust bank shall keep: largest median error, alone and all together, and least coverage
#: while the flag is up; least share of the excited time with the flag up, in the twin and under one
#: mismatch.
BARS = {"error": 0.05, "error_all": 0.1, "coverage": 0.9, "flag_twin": 0.9, "flag": 0.6}


class BoundLine(NamedTuple):
    """The least standard deviation of n on a row without mismatch, by the robust bank's sensors, over n."""

    row: int
    doubting: float  #: with every doubt of the robust bank, at the end [-]
    moduli_only: float  #: where the moduli alone are uncertain [-]
    certain: float  #: where everything but n is known [-]


def _bounds(row: int, seed: int, duration: float) -> dict:
    """Bounds on sd(n)/n at the end, along the truth without mismatch."""
    settings = RobustSettings()
    names = ("mass", "lag", "place", "acceleration_bias", "rate_bias", "misalignment", "rim")
    sure = dict.fromkeys(names, 1e-06)
    none = {"process": (1e-9,) * 5, "error": (1e-9,) * CHANNELS}
    doubts = {
        "doubting": settings.doubt,
        "moduli_only": type(settings.doubt)(**sure, **none),
        "certain": type(settings.doubt)(stiffness=1e-6, slip_sinkage=(1e-6, 1e-6), **sure, **none),
    }
    twin = mismatched_twin(ROWS[row - 1], "none", seed, settings.joint, duration=duration)
    seen = twin.readings(FILTERS["robust"].sensors)
    result = {}
    for name, doubt in doubts.items():
        model = doubt_model(row_plant(twin.row), twin.dt, settings.joint, doubt)
        prior = (settings.n_prior_sd, settings.bump)
        bound, _ = bound_with_doubt(model, prior, twin.truth, twin.inputs, seen)
        result[name] = float(bound[-1] / twin.n[-1])
    return result


def run_unit(name: str, mismatch: str, row: int, seed: int, duration: float) -> dict:
    """Verdicts on one filter (or the bounds) on one seed of a row under a mismatch, as plain numbers.

    ``doubted``: with a second opinion, as reported; ``alone``: by the filter's own word.
    """
    if name == _BOUND:
        return _bounds(row, seed, duration)
    twin = mismatched_twin(ROWS[row - 1], mismatch, seed, duration=duration)
    alone = run_filter(name, twin)
    doubted = in_doubt(name, twin, alone)
    return {"doubted": judge(name, twin, doubted)._asdict(), "alone": judge(name, twin, alone)._asdict()}


def summaries_of(results: Mapping[Key, Mapping], word: str = "doubted") -> list[MismatchSummary]:
    """A line for every filter and mismatch from the results by (filter, mismatch, row, seed, duration).

    ``word`` : "doubted" or "alone", see `run_unit`.
    """
    groups: dict[tuple, list[Verdict]] = {}
    for key, result in results.items():
        if key[0] != _BOUND:
            groups.setdefault(key[:2], []).append(Verdict(**result[word]))
    return [summarise_verdicts(verdicts) for verdicts in groups.values()]


def bounds_of(results: Mapping[Key, Mapping]) -> list[BoundLine]:
    """A line for every row: medians over the seeds."""
    found: dict[int, list[Mapping]] = {}
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
    first_seed: int = 0  #: how many of those to leave out: seeds that nobody has looked at
    tuning: bool = False  #: use the seeds on which settings were chosen instead
    only: tuple[str, ...] = ()  #: these filters (robust bank embedded propagated)
    under: tuple[str, ...] = ()  #: these mismatches
    duration: float = 60.0  #: of a run [s]
    n_jobs: int = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.figures.mismatch import mismatch_figure

        if self.quick:
            self.rows, self.seeds, self.duration = (3, 7), 1, 20.0
        if not 5.0 <= self.duration <= 1000.0:
            raise InvalidParameter(f"duration must be in [5, 1000] s, got {self.duration:g}")
        results = run_units(
            self.out / "mismatch.jsonl", run_unit, self._units(), label="mismatch", n_jobs=self.n_jobs
        )
        summaries, alone, bounds = summaries_of(results), summaries_of(results, "alone"), bounds_of(results)
        _show("with the model in doubt", summaries)
        own = [line for line in alone if FILTERS[line.filter].exact]
        if own:
            _show("by the filter's own word, given its model", own)
        say(
            "error, 90 %, covers: while the flag is up; flag up: of the time that steering or roughness acts;"
        )
        say("silent: runs that vouched for 2 s or more for an error above 20 % outside of their own interval")
        _show_worst(summaries)
        _show_bounds(bounds)
        self.save_figure(mismatch_figure(summaries, alone, BARS), "mismatch")
        runs = [result for key, result in results.items() if key[0] != _BOUND]
        self.save_numbers(
            {
                "summaries": summaries,
                "alone": alone,
                "bounds": bounds,
                "bars": BARS,
                "mismatches": MISMATCHES,
                "runs": runs,
                "duration": self.duration,
            }
        )

    def _units(self) -> dict[Key, str]:
        names = _chosen("only", self.only, tuple(FILTERS))
        under = _chosen("under", self.under, tuple(MISMATCHES))
        known = TUNING_SEEDS if self.tuning else REPORT_SEEDS
        if not 0 <= self.first_seed < len(known):
            raise InvalidParameter(f"first_seed must be in [0, {len(known) - 1}], got {self.first_seed}")
        seeds = checked_seeds(self.seeds, known[self.first_seed :])
        stamps = {name: stamp_of(FILTERS[name].module, *_sources(name)) for name in names}
        bound = stamp_of("estimators.nuisances", "estimators.mismatch")
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
    second = ("estimators.second_opinion",) if FILTERS[name].exact else ()
    return ("estimators.mismatch", *second)


def _chosen(name: str, asked: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [value for value in asked if value not in known]
    if unknown:
        raise InvalidParameter(f"{name} must name some of {', '.join(known)}, got {unknown[0]!r}")
    return asked or known


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f}" if math.isfinite(value) else "-"


def _show(word: str, summaries: Sequence[MismatchSummary]) -> None:
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
    console().print(table(f"{word}: in per cent; errors relative to the true n", heading, body, texts=2))


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
            say(f"{FILTERS[name].title}: {MISMATCHES[line.mismatch].title} hurts most")


def _show_bounds(bounds: Sequence[BoundLine]) -> None:
    body = [
        (str(b.row), _percent(b.doubting), _percent(b.moduli_only), _percent(b.certain, 2)) for b in bounds
    ]
    heading = ("row", "all in doubt", "moduli in doubt", "only n unknown")
    console().print(table("least sd of n at the end, in per cent of n (Cramer-Rao)", heading, body))
