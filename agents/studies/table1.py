"""``offroad reproduce table1``: the eight rows of the paper's table, for three sources of the state.

A unit is one seed of one row with one filter. Of the first seed of every row the estimate over time
is kept as well, for the figures.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from agents.benchmark.statistics import bootstrap_interval
from agents.commands.output import Results, console, say, table
from agents.studies.units import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.bank import BankSettings
from estimators.bounds import mean_bound
from estimators.consistency import coverage
from estimators.paper import CHOICES, KNOWN_SETTINGS, ROWS, SETTINGS, SWEEP, row_truth, run_row
from estimators.parameter import ParameterSettings
from estimators.protocol_runs import REPORT_SEEDS, TUNING_SEEDS, run_bank_row
from estimators.scores import SETTLED, late_rmse, time_to_5pct
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at

__all__ = ["CASES", "SweepPoint", "Table1", "TableLine", "choose", "run_unit", "sweep_unit", "table_lines"]

#: (source, model of the filter). The joint filter runs the half-car: a bicycle in its place would
#: have to explain a vertical motion that it does not model.
CASES: tuple[tuple[str, str], ...] = (
    ("propagated", "half_car"),
    ("propagated", "bicycle"),
    ("known", "half_car"),
    ("known", "bicycle"),
    ("joint", "half_car"),
)
#: Samples between two values that are kept for figures, and of the bound.
_EVERY = 20
#: Soils of the rows.
_SOILS = ("clay", "dry_sand")
#: Speeds in which the model means something [m/s].
_LOWEST_SPEED, _HIGHEST_SPEED = 0.5, 25.0


class TableLine(NamedTuple):
    """One filter on one row, over the seeds."""

    row: int
    soil: str
    H0: float  #: amplitude of the terrain [m]
    steering: str
    source: str
    model: str
    seeds: int
    mse_median: float  #: over 100 s [-]
    mse_low: float  #: 95 % interval of the median, bootstrap over the seeds
    mse_high: float
    paper_mse: float  #: the paper's value for this row and model [-]
    rmse_after_20s: float  #: over all seeds [-]
    time_to_5pct: float  #: median [s]; infinite where the error does not stay below 5 %
    coverage: float  #: of the 95 % interval, over time and seeds
    bound_rmse_after_20s: float  #: the least possible without knowing the state, with process noise [-]
    v_min: float  #: over all seeds [m/s]
    v_max: float
    valid: float  #: share of the time that the flag is up; NaN for a filter without one
    coverage_valid: float  #: coverage while the flag is up
    wrong_with_flag: int  #: seeds that vouch for another soil at the end


class SweepPoint(NamedTuple):
    """One setting of the paper's filter on all rows."""

    model: str
    alpha: float
    drift: float  #: sqrt(R_n) [-]
    mse: tuple[float, ...]  #: median over the tuning seeds, by row [-]
    reached: int  #: rows at or below the paper's value
    median_log_mse: float  #: over the rows, of log10


@cache
def _truth(row: int, duration: float):
    return row_truth(ROWS[row - 1], duration=duration)


def run_unit(source: str, model: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """Score of one filter on one seed of a row, as plain numbers."""
    if source == "joint":
        score = run_bank_row(ROWS[row - 1], seed, duration=duration)
        run, t, n = score.run, score.twin.t, score.twin.n
        v, valid, bound = score.twin.truth[:, at.V_X], run.valid, score.bound
        extra = {
            "bound": bound[t >= SETTLED][::_EVERY].tolist(),
            "valid": float(valid.mean()),
            "coverage_valid": coverage(run.low, run.high, n, valid),
            "wrong": int(score.ends_wrong),
            "real_time": float(t[-1]) / score.seconds,
        }
    else:
        result = run_row(ROWS[row - 1], model, source=source, seed=seed, truth=_truth(row, duration))
        run, t = result.filter, result.t
        n = np.full(len(t), result.truth.n)
        v = result.truth.run.states[:, at.V_X]
        apart = np.hypot(*(run.states[:, [at.X, at.Y]] - result.truth.run.states[:, [at.X, at.Y]]).T)
        extra = {"skipped": run.skipped, "repairs": run.repairs, "drift": float(apart.max())}
    score = {
        "mse": float(np.mean((run.n - n) ** 2)),
        "late_rmse": late_rmse(t, run.n, n),
        "time_to_5pct": time_to_5pct(t, run.n, n),
        "coverage": coverage(run.low, run.high, n),
        "v_min": float(v.min()),
        "v_max": float(v.max()),
    }
    if seed == REPORT_SEEDS[0]:
        kept = {"t": t, "n": run.n, "low": run.low, "high": run.high}
        extra["series"] = {name: np.round(values[::_EVERY], 5).tolist() for name, values in kept.items()}
    return score | extra


def sweep_unit(model: str, alpha: float, drift: float, row: int, seed: int) -> dict[str, float]:
    """Mean square error of one setting of the propagated filter on one tuning seed of a row."""
    settings = replace(SETTINGS[model], alpha=alpha, drift=drift)
    run = run_row(ROWS[row - 1], model, seed=seed, settings=settings, truth=_truth(row, 100.0))
    return {"mse": run.mse}


def _steering(row: int) -> str:
    amplitude, frequency = ROWS[row - 1].steer_amplitude, ROWS[row - 1].steer_frequency
    if amplitude == 0.0:
        return "0"
    return f"{amplitude:g} sin {'' if frequency == 1.0 else f'{frequency:g} '}t"


def _bound(scores: Sequence[Mapping]) -> float:
    kept = [np.array(score["bound"]) for score in scores]
    return float(np.sqrt(np.mean(mean_bound(kept) ** 2))) if kept and kept[0].size else math.nan


def _line(case: tuple[str, str], row: int, scores: Sequence[Mapping], bound: float) -> TableLine:
    source, model = case
    record = ROWS[row - 1]
    mse = np.array([score["mse"] for score in scores])
    low = high = float(mse[0])
    if len(mse) > 1:
        interval = bootstrap_interval((mse,), np.median, method="percentile")
        low, high = interval.low, interval.high
    joint = source == "joint"
    up = sum(score["valid"] for score in scores) if joint else 0.0
    inside = sum(score["valid"] * score["coverage_valid"] for score in scores if joint and score["valid"] > 0)
    return TableLine(
        row=row,
        soil=record.soil,
        H0=record.H0,
        steering=_steering(row),
        source=source,
        model=model,
        seeds=len(scores),
        mse_median=float(np.median(mse)),
        mse_low=low,
        mse_high=high,
        paper_mse=record.paper_half_car if model == "half_car" else record.paper_bicycle,
        rmse_after_20s=math.sqrt(np.mean([score["late_rmse"] ** 2 for score in scores])),
        time_to_5pct=float(np.median([score["time_to_5pct"] for score in scores])),
        coverage=float(np.mean([score["coverage"] for score in scores])),
        bound_rmse_after_20s=bound,
        v_min=min(score["v_min"] for score in scores),
        v_max=max(score["v_max"] for score in scores),
        valid=up / len(scores) if joint else math.nan,
        coverage_valid=inside / up if up > 0.0 else math.nan,
        wrong_with_flag=sum(score["wrong"] for score in scores) if joint else 0,
    )


def table_lines(results: Mapping[Key, Mapping]) -> list[TableLine]:
    """A line for every row and case from the results by (source, model, row, seed, duration)."""
    lines = []
    for row in sorted({key[2] for key in results}):
        groups = {
            case: [result for key, result in results.items() if key[:3] == (*case, row)] for case in CASES
        }
        bound = _bound(groups["joint", "half_car"])
        lines += [_line(case, row, scores, bound) for case, scores in groups.items() if scores]
    return lines


def sweep_points(results: Mapping[Key, Mapping]) -> list[SweepPoint]:
    """A point for every setting from the results by (model, alpha, drift, row, seed)."""
    points = []
    for model, alpha, drift in dict.fromkeys(key[:3] for key in results):
        mse = []
        for row in ROWS:
            place = (model, alpha, drift, row.number)
            mse.append(float(np.median([r["mse"] for key, r in results.items() if key[:4] == place])))
        paper = [row.paper_half_car if model == "half_car" else row.paper_bicycle for row in ROWS]
        reached = sum(value <= limit for value, limit in zip(mse, paper, strict=True))
        points.append(SweepPoint(model, alpha, drift, tuple(mse), reached, float(np.median(np.log10(mse)))))
    return points


def choose(points: Sequence[SweepPoint]) -> SweepPoint:
    """The setting with the most rows at or below the paper's, of several that with the lowest median."""
    return max(points, key=lambda point: (point.reached, -point.median_log_mse))


@dataclass(kw_only=True)
class Table1(Results):
    """The eight rows of the paper's table of results, with three sources of the filter's state.

    propagated: the filter's own model carries the state (the paper's filter); known: a perfect
    navigation system hands it over; joint: one bank of filters estimates state and n from the
    inertial unit alone. Medians with 95 % intervals over noise seeds beside the paper's values and
    the Cramer-Rao bound. Writes table1.png, table1_sensitivity.png and table1_forward.png, and
    table1.jsonl with the result of every run: a run that is there is not repeated.
    """

    quick: bool = False  #: 2 seeds: the whole table in some minutes
    seeds: int = 20  #: noise seeds a row, of those set aside for reporting
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    sources: tuple[str, ...] = ("propagated", "known", "joint")  #: where the filter's state comes from
    sweep: bool = False  #: repeat the choice of alpha and R_n on the tuning seeds instead, draw its map
    sweep_seeds: int = 4  #: tuning seeds of the sweep
    n_jobs: int = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        if self.sweep:
            self._sweep()
        else:
            self._table()

    def _table(self) -> None:
        from agents.figures.forward import motion_figure
        from agents.figures.table1 import estimates_figure, sensitivity_figure
        from estimators.paper import forward_comparison
        from estimators.sensitivity import sensitivity_curves

        seeds = checked_seeds(2 if self.quick else self.seeds, REPORT_SEEDS)
        results = run_units(
            self.out / "table1.jsonl", run_unit, self._units(seeds), label="table 1", n_jobs=self.n_jobs
        )
        lines = table_lines(results)
        _show(lines)
        series = {key[:3]: result["series"] for key, result in results.items() if "series" in result}
        self.save_figure(estimates_figure(series), "table1")
        self.save_figure(
            sensitivity_figure([sensitivity_curves(soil) for soil in _SOILS]), "table1_sensitivity"
        )
        self.save_figure(motion_figure(forward_comparison()), "table1_forward")
        self.save_numbers({"rows": lines, "settings": _settings(), "choices": CHOICES})

    def _units(self, seeds: Sequence[int]) -> dict[Key, str]:
        unknown = set(self.sources) - {source for source, _ in CASES}
        if unknown or not self.sources:
            raise InvalidParameter(f"sources must be some of propagated, known, joint, got {self.sources}")
        return {
            (source, model, row, seed, 100.0): _stamp(_setting(source, model))
            for seed in seeds
            for row in checked_rows(self.rows)
            for source, model in CASES
            if source in self.sources
        }

    def _sweep(self) -> None:
        from agents.figures.table1 import sweep_figure

        seeds = checked_seeds(self.sweep_seeds, TUNING_SEEDS)
        units = {
            (model, alpha, drift, row.number, seed): _stamp(
                replace(SETTINGS[model], alpha=alpha, drift=drift)
            )
            for model in SETTINGS
            for alpha in SWEEP["alpha"]
            for drift in SWEEP["drift"]
            for row in ROWS
            for seed in seeds
        }
        results = run_units(
            self.out / "table1_sweep.jsonl", sweep_unit, units, label="sweep", n_jobs=self.n_jobs
        )
        points = sweep_points(results)
        chosen = {model: choose([p for p in points if p.model == model]) for model in SETTINGS}
        _show_sweep(points, chosen)
        self.save_figure(sweep_figure(points, chosen), "table1_sweep")
        self.save_numbers({"points": points, "chosen": chosen, "seeds": seeds})


def _setting(source: str, model: str) -> ParameterSettings | BankSettings:
    if source == "joint":
        return BankSettings()
    return (SETTINGS if source == "propagated" else KNOWN_SETTINGS)[model]


def _stamp(setting: ParameterSettings | BankSettings) -> str:
    """Changes with the sources of the filter, its setting, and what the rows are."""
    joint = isinstance(setting, BankSettings)
    sources = stamp_of("estimators.bank", "estimators.bounds") if joint else stamp_of("estimators.parameter")
    values = {name: choice.value for name, choice in CHOICES.items()}
    digest = hashlib.sha256(repr((setting, values, ROWS)).encode()).hexdigest()[:10]
    return f"{sources}-{digest}"


def _settings() -> dict[str, Any]:
    return {"propagated": SETTINGS, "known": KNOWN_SETTINGS, "joint": BankSettings()}


def _show(lines: Sequence[TableLine]) -> None:
    cases = [case for case in CASES if any(line[4:6] == case for line in lines)]
    rows = sorted({line.row for line in lines})
    by_place = {(line.source, line.model, line.row): line for line in lines}
    heading = ("row", "soil", "H0", "steering", "half-car", "bicycle", *map(_case_name, cases), "speed [m/s]")
    body = []
    for row in rows:
        record = ROWS[row - 1]
        own = [by_place[(*case, row)] for case in cases]
        speeds = f"{min(line.v_min for line in own):.1f}-{max(line.v_max for line in own):.1f}"
        cells = [f"{x.mse_median:.1e}{' ' if x.mse_median <= x.paper_mse else '*'}" for x in own]
        first = (str(row), record.soil, f"{record.H0:g}", _steering(row))
        body.append((*first, f"{record.paper_half_car:.1e}", f"{record.paper_bicycle:.1e}", *cells, speeds))
    title = (
        f"Mean square error of n over 100 s: the paper's half-car and bicycle, then medians of "
        f"{lines[0].seeds} seeds (*: above the paper)"
    )
    console().print(table(title, heading, body, texts=4))
    ordered = sorted(lines, key=lambda line: (CASES.index((line.source, line.model)), line.row))
    heading = (
        "filter",
        "row",
        "MSE",
        "95 % of the median",
        "late RMSE",
        "bound",
        "ratio",
        "to 5 %",
        "covers",
    )
    heading += ("flag up", "then", "wrong")
    title = "Every filter on every row (late: from 20 s on; wrong: seeds that vouch for another soil)"
    console().print(table(title, heading, [_cells(line) for line in ordered]))
    for case in cases:
        say(_verdict([by_place[(*case, row)] for row in rows]))
    slow, fast = min(line.v_min for line in lines), max(line.v_max for line in lines)
    inside = "within" if slow >= _LOWEST_SPEED and fast <= _HIGHEST_SPEED else "NOT within"
    say(f"speeds {slow:.2f} ... {fast:.2f} m/s, {inside} {_LOWEST_SPEED:g} ... {_HIGHEST_SPEED:g} m/s")


def _case_name(case: tuple[str, str]) -> str:
    source, model = case
    return f"{source} {model.replace('_', '-')}"


def _cells(line: TableLine) -> tuple[str, ...]:
    """A line of the second table."""
    flag = ("-", "-", "-")
    if line.source == "joint":
        flag = (f"{line.valid:.0%}", f"{line.coverage_valid:.1%}", str(line.wrong_with_flag))
    return (
        _case_name((line.source, line.model)),
        str(line.row),
        f"{line.mse_median:.2e}",
        f"{line.mse_low:.1e}-{line.mse_high:.1e}",
        f"{line.rmse_after_20s:.1e}",
        f"{line.bound_rmse_after_20s:.1e}",
        f"{line.rmse_after_20s / line.bound_rmse_after_20s:.2f}",
        f"{line.time_to_5pct:.1f}" if math.isfinite(line.time_to_5pct) else "never",
        f"{line.coverage:.1%}",
        *flag,
    )


def _verdict(lines: Sequence[TableLine]) -> str:
    """One sentence about a filter over its rows."""
    reached = sum(line.mse_median <= line.paper_mse for line in lines)
    gain = np.exp(np.mean([math.log(line.paper_mse / line.mse_median) for line in lines]))
    covered = np.mean([line.coverage for line in lines])
    name = _case_name((lines[0].source, lines[0].model))
    return (
        f"{name}: {reached} of {len(lines)} rows at or below the paper's value, {gain:.1f} times below it in "
        f"geometric mean; the 95 % interval covers {covered:.1%}"
    )


def _show_sweep(points: Sequence[SweepPoint], chosen: Mapping[str, SweepPoint]) -> None:
    for model, best in chosen.items():
        own = sorted((p for p in points if p.model == model), key=lambda p: (-p.reached, p.median_log_mse))
        heading = (
            "alpha",
            "sqrt R_n",
            "rows reached",
            "median log10 MSE",
            *(f"row {r.number}" for r in ROWS),
        )
        body = [
            (
                f"{p.alpha:g}",
                f"{p.drift:g}",
                str(p.reached),
                f"{p.median_log_mse:.2f}",
                *(f"{m:.1e}" for m in p.mse),
            )
            for p in own[:8]
        ]
        console().print(table(f"{model.replace('_', '-')}: the best settings", heading, body, texts=0))
        used = SETTINGS[model]
        same = (best.alpha, best.drift) == (used.alpha, used.drift)
        agree = "as used" if same else f"NOT what is used, which is {used.alpha:g} and {used.drift:g}"
        say(f"chosen: alpha {best.alpha:g}, sqrt R_n {best.drift:g}: {agree}")
