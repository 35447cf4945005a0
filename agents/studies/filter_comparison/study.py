"""``offroad reproduce filters``: every filter under one protocol, on the same simulated rows.

Units are one filter on one seed of one row; the bound is a unit of its own, along the same truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.analysis.consistency import Band, chi_square_band
from estimators.analysis.cramer_rao import mean_bound
from estimators.analysis.scores import SETTLED
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.filter_comparison import COMPARED, row_bound, scored
from estimators.experiments.simulated_rows import REPORT_SEEDS, simulate_row
from estimators.filters.registry import FILTERS, filter_id
from estimators.models.half_car_on_map import JointSettings
from offroad_env.errors import InvalidParameter

__all__ = ["FilterLine", "FilterTotal", "Filters", "lines_of", "run_unit", "totals_of"]

_BOUND = "bound"
#: Samples between two values of the bound that are kept.
_EVERY = 50


class FilterLine(NamedTuple):
    """One filter on one row."""

    filter: str
    row: int
    seeds: int
    mse_median: float  #: over the whole run [-]
    mse_low: float  #: 2.5 % quantile over the seeds
    mse_high: float  #: 97.5 % quantile
    rmse_after_20s: float  #: over all seeds [-]
    bound_rmse_after_20s: float  #: the least possible [-]
    ratio: float  #: of the two
    coverage: float  #: of the 95 % interval, over time and seeds
    coverage_valid: float  #: while the flag is up
    valid: float  #: share of the time that the flag is up
    nis: float  #: mean
    nis_band: Band  #: 95 % chi-square band of that mean
    microseconds: float  #: processor time of an update, median over the seeds
    time_to_5pct: float  #: median [s]
    wrong_with_flag: int  #: runs that end with the flag up for another soil
    repairs: int
    lost: int  #: samples or particles without a contact solution
    stopped: int  #: runs that could not go on


class FilterTotal(NamedTuple):
    """One filter over all rows."""

    filter: str
    title: str
    runs: int
    ratio: float  #: geometric mean over the rows of RMSE after 20 s / bound
    ratio_best: float
    ratio_worst: float
    coverage: float
    coverage_valid: float
    valid: float
    nis: float
    nis_band: Band
    microseconds: float
    real_time: float  #: simulated over processor time
    time_to_5pct: float  #: median over all runs [s]
    wrong_with_flag: int
    repairs: int
    lost: int
    stopped: int


def run_unit(name: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """Score of one filter (or the bound) on one seed of a row, as plain numbers."""
    drive = simulate_row(ROWS[row - 1], seed, JointSettings(), duration=duration)
    if name == _BOUND:
        return {"bound": row_bound(drive)[drive.t >= SETTLED][::_EVERY].tolist()}
    return scored(name, drive)._asdict()


def _mean(values: Sequence[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else math.nan


def _nis(scores: Sequence[Mapping[str, Any]]) -> tuple[float, Band]:
    """Mean NIS of all updates with its band."""
    count = sum(score["nis_count"] for score in scores)
    if count == 0:
        return math.nan, Band(math.nan, math.nan)
    total = sum(score["nis"] * score["nis_count"] for score in scores if score["nis_count"])
    return total / count, chi_square_band(scores[0]["channels"], count)


def _line(
    name: str, row: int, scores: Sequence[Mapping[str, Any]], bounds: Sequence[Mapping[str, Any]]
) -> FilterLine:
    mse = np.array([score["mse"] for score in scores])
    rmse = math.sqrt(np.mean([score["late_mse"] for score in scores]))
    kept = [np.array(bound["bound"]) for bound in bounds]
    bound = float(np.sqrt(np.mean(mean_bound(kept) ** 2))) if kept[0].size else math.nan
    nis, band = _nis(scores)
    return FilterLine(
        filter=name,
        row=row,
        seeds=len(scores),
        mse_median=float(np.median(mse)),
        mse_low=float(np.quantile(mse, 0.025, method="lower")),
        mse_high=float(np.quantile(mse, 0.975, method="higher")),
        rmse_after_20s=rmse,
        bound_rmse_after_20s=bound,
        ratio=rmse / bound,
        coverage=_mean([score["coverage"] for score in scores]),
        coverage_valid=_weighted_coverage(scores),
        valid=_mean([score["valid"] for score in scores]),
        nis=nis,
        nis_band=band,
        microseconds=1e6 * float(np.median([score["seconds"] / score["updates"] for score in scores])),
        time_to_5pct=float(np.median([score["time_to_5pct"] for score in scores])),
        wrong_with_flag=sum(score["wrong"] for score in scores),
        repairs=sum(score["repairs"] for score in scores),
        lost=sum(score["lost"] for score in scores),
        stopped=sum(not math.isfinite(score["mse"]) for score in scores),
    )


def _weighted_coverage(scores: Sequence[Mapping[str, Any]]) -> float:
    """Coverage over all the time that the flag is up."""
    up = [(score["valid"], score["coverage_valid"]) for score in scores if score["valid"] > 0.0]
    return sum(v * c for v, c in up) / sum(v for v, _ in up) if up else math.nan


def lines_of(results: Mapping[Key, Mapping[str, Any]]) -> list[FilterLine]:
    """A line for every filter and row from the results by (filter, row, seed, duration)."""
    names = list(dict.fromkeys(key[0] for key in results if key[0] != _BOUND))
    lines = []
    for row in sorted({key[1] for key in results}):
        bounds = [result for key, result in results.items() if key[:2] == (_BOUND, row)]
        for name in names:
            scores = [result for key, result in results.items() if key[:2] == (name, row)]
            lines.append(_line(name, row, scores, bounds))
    return lines


def totals_of(
    results: Mapping[Key, Mapping[str, Any]], lines: Sequence[FilterLine], dt: float
) -> list[FilterTotal]:
    """A line for every filter over all rows."""
    totals = []
    for name in dict.fromkeys(line.filter for line in lines):
        own = [line for line in lines if line.filter == name]
        scores = [result for key, result in results.items() if key[0] == name]
        nis, band = _nis(scores)
        ratios = np.array([line.ratio for line in own])
        micro = float(np.median([line.microseconds for line in own]))
        totals.append(
            FilterTotal(
                filter=name,
                title=FILTERS[name].title,
                runs=len(scores),
                ratio=float(np.exp(np.mean(np.log(ratios)))),
                ratio_best=float(ratios.min()),
                ratio_worst=float(ratios.max()),
                coverage=_mean([score["coverage"] for score in scores]),
                coverage_valid=_weighted_coverage(scores),
                valid=_mean([score["valid"] for score in scores]),
                nis=nis,
                nis_band=band,
                microseconds=micro,
                real_time=1e6 * dt / micro,
                time_to_5pct=float(np.median([score["time_to_5pct"] for score in scores])),
                wrong_with_flag=sum(line.wrong_with_flag for line in own),
                repairs=sum(line.repairs for line in own),
                lost=sum(line.lost for line in own),
                stopped=sum(line.stopped for line in own),
            )
        )
    return totals


@dataclass(kw_only=True)
class Filters(Results):
    """All filters on the same simulated rows of the paper's table, IMU alone.

    RMSE after 20 s against the Cramer-Rao bound, coverage of the 95 % interval, mean NIS with its
    chi-square band, cost, time to 5 %, and how often the flag is up for a wrong soil. Writes
    filters.png, and filters.jsonl with the result of every run: a run that is there is not repeated.
    """

    quick: bool = False  #: one seed and 30 s: to see that it works
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    seeds: int = 20  #: noise seeds a row, of those set aside for reporting
    only: tuple[str, ...] = ()  #: these filters: ids, or propagated known joint ekf particle bank smoother
    duration: float = 100.0  #: of a run [s]
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.filter_comparison.figure import filters_figure

        if self.quick:
            self.seeds, self.duration = 1, 30.0
        if not 25.0 <= self.duration <= 1000.0:
            raise InvalidParameter(
                f"duration must be in [25, 1000] s, got {self.duration:g}: scores begin at 20 s"
            )
        results = run_units(
            self.out / "filters.jsonl", run_unit, self._units(), label="filters", n_jobs=self.n_jobs
        )
        lines = lines_of(results)
        totals = totals_of(results, lines, 0.01)
        _show(lines, totals)
        self.save_figure(
            filters_figure(lines, totals),
            "filters",
            "At 1 on the left an estimate is as good as the bound allows; in the grey band an "
            "interval covers as stated.",
        )
        self.save_numbers({"rows": lines, "filters": totals, "duration": self.duration})

    def _units(self) -> dict[Key, str]:
        names = tuple(filter_id(name, COMPARED, label="only") for name in self.only or COMPARED)
        stamps = {_BOUND: stamp_of("estimators.analysis.cramer_rao", "estimators.experiments.simulated_rows")}
        stamps |= {
            name: stamp_of(FILTERS[name].module, "estimators.experiments.simulated_rows") for name in names
        }
        return {
            (name, row, seed, float(self.duration)): stamp
            for seed in checked_seeds(self.seeds, REPORT_SEEDS)
            for row in checked_rows(self.rows)
            for name, stamp in stamps.items()
        }


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _show(lines: Sequence[FilterLine], totals: Sequence[FilterTotal]) -> None:
    rows = sorted({line.row for line in lines})
    by_place = {(line.filter, line.row): line for line in lines}
    heading = ("filter", *(f"row {row}" for row in rows))
    names = [total.filter for total in totals]
    body = [(name, *(f"{by_place[name, row].rmse_after_20s:.1e}" for row in rows)) for name in names]
    least = [f"{by_place[names[0], row].bound_rmse_after_20s:.1e}" for row in rows]
    console().print(table("RMSE of n after 20 s [-]", heading, [("least possible", *least), *body]))
    body = [(name, *(_number(by_place[name, row].ratio, 1) for row in rows)) for name in names]
    console().print(table("the same over the Cramer-Rao bound", heading, body))
    heading = (
        "filter",
        "runs",
        "ratio",
        "worst row",
        "to 5 % [s]",
        "µs/update",
        "x real time",
        "repairs",
        "lost",
    )
    body = [
        (
            total.filter,
            str(total.runs),
            _number(total.ratio),
            _number(total.ratio_worst, 1),
            _number(total.time_to_5pct, 1),
            f"{total.microseconds:.0f}",
            f"{total.real_time:.0f}",
            str(total.repairs),
            f"{total.lost} ({total.stopped} stopped)" if total.stopped else str(total.lost),
        )
        for total in totals
    ]
    console().print(table("all rows: error and cost", heading, body))
    heading = (
        "filter",
        "covers",
        "flag up",
        "covers then",
        "NIS",
        "95 % band of its mean",
        "wrong with flag",
    )
    body = [
        (
            total.filter,
            f"{total.coverage:.1%}",
            f"{total.valid:.0%}",
            "-" if math.isnan(total.coverage_valid) else f"{total.coverage_valid:.1%}",
            _number(total.nis, 3),
            f"{_number(total.nis_band.low, 3)} - {_number(total.nis_band.high, 3)}",
            f"{total.wrong_with_flag} of {total.runs}",
        )
        for total in totals
    ]
    console().print(table("all rows: consistency", heading, body))
    say("ratio: geometric mean over the rows; wrong: runs whose flag is up at the end for another soil")
