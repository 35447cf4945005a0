"""``offroad reproduce sensors``: what wheel speeds and satellite fixes add to the inertial unit.

The bank of joint UKFs on the same simulated rows of the paper's table, with three sets of sensors. The bound
is what each set can add at best; the error of the filter is what it adds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.analysis.cramer_rao import mean_bound
from estimators.analysis.scores import SETTLED
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.filter_comparison import row_bound, scored
from estimators.experiments.simulated_rows import REPORT_SEEDS, simulate_row
from estimators.filters.registry import SENSORS
from estimators.models.half_car_on_map import JointSettings

__all__ = ["SensorLine", "Sensors", "run_unit", "sensor_lines"]

_EVERY = 50


class SensorLine(NamedTuple):
    """The bank with one set of sensors on one row, over all seeds."""

    sensors: str
    row: int
    rmse_after_20s: float  #: [-]
    bound_rmse_after_20s: float  #: [-]
    coverage: float  #: of the 95 % interval
    time_to_5pct: float  #: median [s]
    wrong_with_flag: int  #: runs that end with the flag up for another soil
    seeds: int


def run_unit(sensors: str, row: int, seed: int, duration: float) -> dict[str, Any]:
    """Score of the bank and the bound on one seed of a row with one set of sensors."""
    drive = simulate_row(ROWS[row - 1], seed, JointSettings(), duration=duration)
    bound = row_bound(drive, sensors=sensors)[drive.t >= SETTLED][::_EVERY]
    return {"bound": bound.tolist(), "score": scored("map_ukf_bank", drive, sensors=sensors)._asdict()}


def sensor_lines(results: Mapping[Key, Mapping[str, Any]]) -> list[SensorLine]:
    """A line for every set of sensors and row from the results by (sensors, row, seed, duration)."""
    return [
        _line(sensors, row, [result for key, result in results.items() if key[:2] == (sensors, row)])
        for sensors, row in dict.fromkeys(key[:2] for key in results)
    ]


def _line(sensors: str, row: int, units: Sequence[Mapping[str, Any]]) -> SensorLine:
    scores = [unit["score"] for unit in units]
    bound = mean_bound([np.array(unit["bound"]) for unit in units])
    return SensorLine(
        sensors=sensors,
        row=row,
        rmse_after_20s=math.sqrt(np.mean([score["late_mse"] for score in scores])),
        bound_rmse_after_20s=float(np.sqrt(np.mean(bound**2))),
        coverage=float(np.mean([score["coverage"] for score in scores])),
        time_to_5pct=float(np.median([score["time_to_5pct"] for score in scores])),
        wrong_with_flag=sum(score["wrong"] for score in scores),
        seeds=len(scores),
    )


@dataclass(kw_only=True)
class Sensors(Results):
    """Inertial unit alone, with wheel speeds, with satellite fixes: error of the bank and its bound.

    Writes sensors.png, and sensors.jsonl with the result of every run: a run that is there is not
    repeated.
    """

    quick: bool = False  #: one seed and 30 s
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    seeds: int = 10  #: noise seeds a row, of those set aside for reporting
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.sensors.figure import sensors_figure

        duration = 60.0
        if self.quick:
            self.seeds, duration = 1, 30.0
        stamp = stamp_of(
            "estimators.filters.joint_bank",
            "estimators.experiments.simulated_rows",
            "estimators.analysis.cramer_rao",
        )
        units: dict[Key, str] = {
            (sensors, row, seed, duration): stamp
            for seed in checked_seeds(self.seeds, REPORT_SEEDS)
            for row in checked_rows(self.rows)
            for sensors in SENSORS
        }
        results = run_units(self.out / "sensors.jsonl", run_unit, units, label="sensors", n_jobs=self.n_jobs)
        lines = sensor_lines(results)
        _show(lines)
        self.save_figure(
            sensors_figure(lines),
            "sensors",
            "Bars: the Cramér-Rao bound; points: error of the bank. What further sensors add is the "
            "step from left to right.",
        )
        self.save_numbers({"lines": lines, "duration": duration})


def _show(lines: Sequence[SensorLine]) -> None:
    rows = sorted({line.row for line in lines})
    by_place = {(line.sensors, line.row): line for line in lines}
    heading = ("sensors", *(f"row {row}" for row in rows))
    columns: tuple[tuple[str, Callable[[SensorLine], str]], ...] = (
        ("Cramer-Rao bound of n after 20 s [-]", lambda line: f"{line.bound_rmse_after_20s:.1e}"),
        ("RMSE of the bank after 20 s [-]", lambda line: f"{line.rmse_after_20s:.1e}"),
        ("time to 5 % [s]", lambda line: f"{line.time_to_5pct:.1f}"),
    )
    for title, value in columns:
        body = [(name, *(value(by_place[name, row]) for row in rows)) for name in SENSORS]
        console().print(table(title, heading, body))
    wrong = sum(line.wrong_with_flag for line in lines)
    say(f"{wrong} of {sum(line.seeds for line in lines)} runs end with the flag up for another soil")
