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
from typing import Any

import numpy as np

from agents.benchmark.statistics import bootstrap_interval
from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.paper_table.results import BANK, SweepPoint, TableLine, gain_over_paper_filter
from agents.studies.runner import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.analysis.cramer_rao import mean_bound
from estimators.analysis.scores import SETTLED, score
from estimators.experiments.buzhardt_tallapragada import (
    CHOICES,
    KNOWN_SETTINGS,
    ROWS,
    SETTINGS,
    SWEEP,
    RowTruth,
    row_truth,
    run_row,
)
from estimators.experiments.filter_comparison import row_bound, run_filter
from estimators.experiments.simulated_rows import REPORT_SEEDS, TUNING_SEEDS, simulate_row
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.joint_bank import BankSettings
from estimators.filters.parameter_ukf import ParameterSettings
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at

__all__ = [
    "CASES",
    "Table1",
    "choose",
    "run_reference_unit",
    "run_unit",
    "sweep_unit",
    "table_lines",
    "verdict_of",
]

#: (source of the state, model of the filter). The bank runs the half-car: a bicycle in its place would have
#: to explain a vertical motion that it does not model.
CASES: tuple[tuple[str, str], ...] = (
    ("propagated", "half_car"),
    ("propagated", "bicycle"),
    ("known", "half_car"),
    ("known", "bicycle"),
    (BANK, "half_car"),
)
_OTHER_NAMES = {"joint": BANK, "bank": BANK}  #: alias
#: Samples between two values that are kept for figures, and of the bound.
_EVERY = 20
#: Soils of the rows.
_SOILS = ("clay", "dry_sand")
#: Speeds in which the model means something [m/s].
_LOWEST_SPEED, _HIGHEST_SPEED = 0.5, 25.0
#: Columns of the table with the printed values.
_PAPER = ("paper half-car", "paper bicycle")


@cache
def _truth(row: int, duration: float) -> RowTruth:
    return row_truth(ROWS[row - 1], duration=duration)


def run_unit(source: str, model: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """Score of one filter on one seed of a row, as plain numbers."""
    if source == BANK:
        return _bank_unit(row, seed, duration)
    return _parameter_unit(source, model, row, seed, duration, reference=False)


def run_reference_unit(source: str, model: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """`run_unit` with the filterpy reference in place of the compiled parameter filter."""
    if source == BANK:
        return _bank_unit(row, seed, duration)
    return _parameter_unit(source, model, row, seed, duration, reference=True)


def _parameter_unit(
    source: str, model: str, row: int, seed: int, duration: float, *, reference: bool
) -> dict[str, Any]:
    """The paper's filter with one source of the state."""
    result = run_row(
        ROWS[row - 1],
        model,
        source=source,
        seed=seed,
        truth=_truth(row, duration),
        reference=reference,
    )
    history, truth = result.filter.belief, result.truth.run.states
    apart = np.hypot(*(result.filter.states[:, [at.X, at.Y]] - truth[:, [at.X, at.Y]]).T)
    extra = {"skipped": history.lost, "repairs": history.repairs, "drift": float(apart.max())}
    return _plain(history, result.truth.n, truth[:, at.V_X], seed) | extra


def _bank_unit(row: int, seed: int, duration: float) -> dict[str, Any]:
    """The bank on a simulated row, with the bound along the same truth."""
    drive = simulate_row(ROWS[row - 1], seed, BankSettings().joint, duration=duration)
    history, bound = run_filter(BANK, drive), row_bound(drive)
    found = score(history, drive.n)
    extra = {
        "bound": bound[drive.t >= SETTLED][::_EVERY].tolist(),
        "valid": found.valid,
        "coverage_valid": found.coverage_valid,
        "wrong": int(found.wrong),
        "real_time": history.real_time_factor,
    }
    return _plain(history, drive.n, drive.truth[:, at.V_X], seed) | extra


def _plain(history: BeliefHistory, truth: np.ndarray | float, speed: np.ndarray, seed: int) -> dict[str, Any]:
    """The numbers of a line, and of the first seed the estimate over time."""
    found = score(history, truth)
    numbers: dict[str, Any] = {
        "mse": found.mse,
        "late_mse": found.late_mse,
        "time_to_5pct": found.time_to_5pct,
        "coverage": found.coverage,
        "v_min": float(speed.min()),
        "v_max": float(speed.max()),
    }
    if seed == REPORT_SEEDS[0]:
        kept = {"t": history.t, "n": history.n, "low": history.low, "high": history.high}
        numbers["series"] = {name: np.round(values[::_EVERY], 5).tolist() for name, values in kept.items()}
    return numbers


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


def _bound(scores: Sequence[Mapping[str, Any]]) -> float:
    kept = [np.array(result["bound"]) for result in scores]
    return float(np.sqrt(np.mean(mean_bound(kept) ** 2))) if kept and kept[0].size else math.nan


def _line(case: tuple[str, str], row: int, scores: Sequence[Mapping[str, Any]], bound: float) -> TableLine:
    source, model = case
    record = ROWS[row - 1]
    mse = np.array([result["mse"] for result in scores])
    low = high = float(mse[0])
    if len(mse) > 1:
        interval = bootstrap_interval((mse,), np.median, method="percentile")
        low, high = interval.low, interval.high
    bank = source == BANK
    up = sum(result["valid"] for result in scores) if bank else 0.0
    inside = sum(r["valid"] * r["coverage_valid"] for r in scores if bank and r["valid"] > 0)
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
        rmse_after_20s=math.sqrt(np.mean([result["late_mse"] for result in scores])),
        time_to_5pct=float(np.median([result["time_to_5pct"] for result in scores])),
        coverage=float(np.mean([result["coverage"] for result in scores])),
        bound_rmse_after_20s=bound,
        v_min=min(result["v_min"] for result in scores),
        v_max=max(result["v_max"] for result in scores),
        valid=up / len(scores) if bank else math.nan,
        coverage_valid=inside / up if up > 0.0 else math.nan,
        wrong_with_flag=sum(result["wrong"] for result in scores) if bank else 0,
    )


def table_lines(results: Mapping[Key, Mapping[str, Any]]) -> list[TableLine]:
    """A line for every row and case from the results by (source, model, row, seed, duration)."""
    lines = []
    for row in sorted({key[2] for key in results}):
        groups = {
            case: [result for key, result in results.items() if key[:3] == (*case, row)] for case in CASES
        }
        bound = _bound(groups[BANK, "half_car"])
        lines += [_line(case, row, scores, bound) for case, scores in groups.items() if scores]
    return lines


def sweep_points(results: Mapping[Key, Mapping[str, Any]]) -> list[SweepPoint]:
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

    propagated: the filter's own model propagates the state (the paper's filter); known: the true state;
    map_ukf_bank: one bank of filters estimates state and n from the inertial unit alone. Medians with 95 %
    intervals over noise seeds beside the paper's values and the Cramer-Rao bound. Writes table1.png,
    table1_sensitivity.png and table1_forward.png, and table1.jsonl with the result of every run: a run that
    is there is not repeated.
    """

    quick: bool = False  #: 1 seed: the whole table in some minutes
    seeds: int = 20  #: noise seeds a row, of those set aside for reporting
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    sources: tuple[str, ...] = ("propagated", "known", BANK)  #: where the filter's state comes from
    reference: bool = False  #: run the paper's filter by its filterpy reference: the same table, slowly
    sweep: bool = False  #: repeat the choice of alpha and R_n on the tuning seeds instead, draw its map
    sweep_seeds: int = 4  #: tuning seeds of the sweep
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        if self.sweep:
            self._sweep()
        else:
            self._table()

    def _table(self) -> None:
        from agents.reports.figures.forward import motion_figure
        from agents.studies.paper_table.figure import estimates_figure, sensitivity_figure
        from estimators.experiments.buzhardt_tallapragada import forward_comparison
        from estimators.experiments.imu_sensitivity import sensitivity_curves

        seeds = checked_seeds(1 if self.quick else self.seeds, REPORT_SEEDS)
        work, name = (run_reference_unit, "table1_reference") if self.reference else (run_unit, "table1")
        results = run_units(
            self.out / f"{name}.jsonl", work, self._units(seeds), label="table 1", n_jobs=self.n_jobs
        )
        lines = table_lines(results)
        _show(lines)
        gain = gain_over_paper_filter(results)
        if gain is not None:
            say(
                f"{BANK} against the paper's filter as run here (propagated, half-car, same rows): mean "
                f"square error {gain.value:.1f} times lower in geometric mean, 95 % interval "
                f"{gain.low:.1f} to {gain.high:.1f}"
            )
        series = {key[:3]: result["series"] for key, result in results.items() if "series" in result}
        self.save_figure(
            estimates_figure(series),
            "table1",
            "One noise seed of each row with 95 % intervals; dashed: the true n.",
        )
        self.save_figure(
            sensitivity_figure([sensitivity_curves(soil) for soil in _SOILS]),
            "table1_sensitivity",
            "Left: soils that pull like the true one (dots). Right: how much each channel of the "
            "inertial unit differs.",
        )
        self.save_figure(
            motion_figure(forward_comparison()),
            "table1_forward",
            "Half-car and bicycle on the same inputs: vertical motion, path, and their distance.",
        )
        self.save_numbers(
            {"rows": lines, "gain_over_paper_filter": gain, "settings": _settings(), "choices": CHOICES}
        )

    def _units(self, seeds: Sequence[int]) -> dict[Key, str]:
        sources = {_OTHER_NAMES.get(source, source) for source in self.sources}
        if sources - {source for source, _ in CASES} or not sources:
            raise InvalidParameter(f"sources must be some of propagated, known, {BANK}, got {self.sources}")
        return {
            (source, model, row, seed, 100.0): _stamp(_setting(source, model), self.reference)
            for seed in seeds
            for row in checked_rows(self.rows)
            for source, model in CASES
            if source in sources
        }

    def _sweep(self) -> None:
        from agents.studies.paper_table.figure import sweep_figure

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
        self.save_figure(
            sweep_figure(points, chosen),
            "table1_sweep",
            "Numbers: rows at or below the paper; framed: the setting that is used.",
        )
        self.save_numbers({"points": points, "chosen": chosen, "seeds": seeds})


def _setting(source: str, model: str) -> ParameterSettings | BankSettings:
    if source == BANK:
        return BankSettings()
    return (SETTINGS if source == "propagated" else KNOWN_SETTINGS)[model]


def _stamp(setting: ParameterSettings | BankSettings, reference: bool = False) -> str:
    """Changes with the sources of the filter, its setting, and what the rows are."""
    bank = isinstance(setting, BankSettings)
    one = "estimators.filters.parameter_ukf_reference" if reference else "estimators.filters.parameter_ukf"
    sources = (
        stamp_of("estimators.filters.joint_bank", "estimators.analysis.cramer_rao") if bank else stamp_of(one)
    )
    values = {name: choice.value for name, choice in CHOICES.items()}
    digest = hashlib.sha256(repr((setting, values, ROWS)).encode()).hexdigest()[:10]
    return f"{sources}-{digest}"


def _settings() -> dict[str, Any]:
    return {"propagated": SETTINGS, "known": KNOWN_SETTINGS, BANK: BankSettings()}


def _show(lines: Sequence[TableLine]) -> None:
    cases = [case for case in CASES if any(line[4:6] == case for line in lines)]
    rows = sorted({line.row for line in lines})
    by_place = {(line.source, line.model, line.row): line for line in lines}
    heading = ("row", "soil", "H0 [m]", "steering [rad]", *_PAPER, *map(_case_name, cases), "speed [m/s]")
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
        f"{lines[0].seeds} {'seed' if lines[0].seeds == 1 else 'seeds'} (*: above the paper)"
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
    title = "Every filter on every row (late: from 20 s on; wrong: flag up for another soil at the end)"
    console().print(table(title, heading, [_cells(line) for line in ordered]))
    for case in cases:
        say(verdict_of([by_place[(*case, row)] for row in rows]))
    slow, fast = min(line.v_min for line in lines), max(line.v_max for line in lines)
    inside = "within" if slow >= _LOWEST_SPEED and fast <= _HIGHEST_SPEED else "NOT within"
    say(f"speeds {slow:.2f} ... {fast:.2f} m/s, {inside} {_LOWEST_SPEED:g} ... {_HIGHEST_SPEED:g} m/s")


def _case_name(case: tuple[str, str]) -> str:
    source, model = case
    return f"{source} {model.replace('_', '-')}"


def _cells(line: TableLine) -> tuple[str, ...]:
    """A line of the second table."""
    flag = ("-", "-", "-")
    if line.source == BANK:
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


def verdict_of(lines: Sequence[TableLine]) -> str:
    """One sentence about a filter over its rows."""
    reached = sum(line.mse_median <= line.paper_mse for line in lines)
    gain = np.exp(np.mean([math.log(line.paper_mse / line.mse_median) for line in lines]))
    covered = np.mean([line.coverage for line in lines])
    name = _case_name((lines[0].source, lines[0].model))
    factor = f"{gain:.1f} times below it" if gain >= 1.0 else f"{1.0 / gain:.1f} times above it"
    return (
        f"{name}: {reached} of {len(lines)} rows at or below the paper's value, {factor} in geometric mean; "
        f"the 95 % interval contains n for {100.0 * covered:.1f} % of the time"
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
