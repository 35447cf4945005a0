"""``offroad reproduce prediction``: where the vehicle will be in 10 s, by what is believed about the soil.

The second claim of the paper's abstract. From a known place and speed a model is run open loop under
the known inputs: half-car or bicycle, with the first guess of n, with what a filter has found by then,
and with the true n. The truth is the half-car with process noise. What a prediction with the true n
still misses is noise, and for the bicycle the missing suspension.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, checked_rows, checked_seeds, run_units, stamp_of
from estimators.experiments.buzhardt_tallapragada import CHOICES, ROWS, SETTINGS, row_plant
from estimators.experiments.simulated_rows import REPORT_SEEDS, SimulatedRow, row_model, simulate_row
from estimators.filters.joint_bank import BankSettings, run_bank
from estimators.filters.parameter_ukf import run_parameter_filter
from estimators.models.half_car_on_map import ETA, JointSettings
from estimators.models.imu_prediction import share_horizontal
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.paper_vehicle import simulate_paper
from offroad_env.simulation.simulator import Plant, settled_state

__all__ = ["SOURCES", "Prediction", "PredictionLine", "predict", "prediction_lines", "run_unit"]

MODELS = ("half_car", "bicycle")
#: Where n comes from: the first guess, the paper's filter (with the same model), the bank, the truth.
SOURCES = ("prior", "paper's filter", "bank", "truth")
#: Predictions start here [s], and look so far ahead [s].
_STARTS = (10.0, 20.0, 30.0)
HORIZON = 10.0
_DURATION = _STARTS[-1] + HORIZON


class PredictionLine(NamedTuple):
    """Position error after 10 s over all seeds and starts of a row."""

    row: int
    model: str
    source: str
    median: float  #: [m]
    low: float  #: 2.5 % quantile [m]
    high: float  #: 97.5 % quantile [m]
    left: int  #: predictions that left the range of the model
    predictions: int


def predict(plant: Plant, state: np.ndarray, inputs: np.ndarray, dt: float) -> np.ndarray:
    """Positions (T, 2) [m] of an open-loop run from a known place and motion.

    Parameters
    ----------
    plant
        The model with its own n.
    state : array (10,)
        True state at the start. Heave and pitch are not taken from it: the model starts settled on the
        soil that it believes in.
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    dt
        [s]

    Raises
    ------
    SolverFailure
        When the model loses contact, or its soil does not carry the vehicle.
    """
    place = {"x": float(state[at.X]), "y": float(state[at.Y]), "yaw": float(state[at.YAW])}
    own, warm = settled_state(plant, v_x=float(state[at.V_X]), **place)
    full = np.zeros(at.STATE_SIZE)
    full[:ETA] = state
    share_horizontal(full, own)
    T = len(inputs) // 2 + 1
    states, readings = np.empty((T, at.STATE_SIZE)), np.empty((T, at.READINGS_SIZE))
    status, done = simulate_paper(own, warm, np.ascontiguousarray(inputs), plant, dt, states, readings)
    if done < T - 1:
        raise SolverFailure(f"the prediction failed after {done * dt:.2f} s (contact status {status:g})")
    return states[:, [at.X, at.Y]]


def _paper_estimates(drive: SimulatedRow, model: str) -> np.ndarray:
    """n over time (T,) of the paper's filter with its propagated state."""
    settings = SETTINGS[model]
    plant = row_plant(drive.row, model, n=settings.n_prior)
    start = settled_state(plant, v_x=CHOICES["start_speed"].value)
    return run_parameter_filter(plant, start, drive.inputs, drive.z[:, :5], drive.dt, settings).belief.n


def run_unit(row: int, seed: int) -> dict[str, Any]:
    """Position errors [m] after 10 s by model, source and start, of one seed of a row."""
    settings = BankSettings()
    drive = simulate_row(ROWS[row - 1], seed, JointSettings(), duration=_DURATION)
    cut = round(_STARTS[-1] / drive.dt)
    bank = run_bank(
        row_model(drive.row, settings.joint),
        settings,
        drive.inputs[: 2 * cut + 1],
        drive.readings()[: cut + 1],
        v_x=CHOICES["start_speed"].value,
    )
    errors: dict[str, Any] = {}
    for model in MODELS:
        estimates = _paper_estimates(drive, model)
        errors[model] = {source: [] for source in SOURCES}
        for start in _STARTS:
            k = round(start / drive.dt)
            beliefs = (settings.n_prior, estimates[k], bank.belief.n[k], drive.n[k])
            for source, n in zip(SOURCES, beliefs, strict=True):
                errors[model][source].append(_error(drive, k, row_plant(drive.row, model, n=float(n))))
    return errors


def _error(drive: SimulatedRow, k: int, plant: Plant) -> float:
    """Distance [m] from the truth of a prediction that starts at sample ``k``."""
    ahead = round(HORIZON / drive.dt)
    try:
        path = predict(plant, drive.truth[k, :ETA], drive.inputs[2 * k : 2 * (k + ahead) + 1], drive.dt)
    except SolverFailure:
        return math.inf
    end = drive.truth[k + ahead, [at.X, at.Y]]
    return float(np.hypot(*(path[-1] - end)))


def prediction_lines(results: Mapping[Key, Mapping[str, Any]]) -> list[PredictionLine]:
    """A line for every row, model and source from the results by (row, seed)."""
    lines = []
    for row in dict.fromkeys(key[0] for key in results):
        units = [result for key, result in results.items() if key[0] == row]
        for model in MODELS:
            for source in SOURCES:
                errors = np.array([error for unit in units for error in unit[model][source]])
                # Order statistics: some errors may be infinite.
                low, middle, high = np.quantile(errors, (0.025, 0.5, 0.975), method="closest_observation")
                left = int(np.isinf(errors).sum())
                lines.append(
                    PredictionLine(
                        row, model, source, float(middle), float(low), float(high), left, errors.size
                    )
                )
    return lines


@dataclass(kw_only=True)
class Prediction(Results):
    """Position error of a 10 s open-loop prediction with prior, estimated and true n.

    Half-car and bicycle on the rows of the paper's table, predictions from 10, 20 and 30 s. Writes
    prediction.png, and prediction.jsonl with the result of every run: a run that is there is not
    repeated.
    """

    quick: bool = False  #: one seed
    rows: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7, 8)  #: rows of the table
    seeds: int = 20  #: noise seeds a row, of those set aside for reporting
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Run what is missing, then print, draw and write."""
        from agents.studies.prediction.figure import prediction_figure

        if self.quick:
            self.seeds = 1
        stamp = stamp_of("estimators.filters.joint_bank", "estimators.experiments.simulated_rows")
        units: dict[Key, str] = {
            (row, seed): stamp
            for seed in checked_seeds(self.seeds, REPORT_SEEDS)
            for row in checked_rows(self.rows)
        }
        results = run_units(
            self.out / "prediction.jsonl", run_unit, units, label="prediction", n_jobs=self.n_jobs
        )
        lines = prediction_lines(results)
        _show(lines)
        self.save_figure(
            prediction_figure(lines),
            "prediction",
            "Median and 95 % of the runs; the nearer to the true n (grey) the better.",
        )
        self.save_numbers({"lines": lines, "horizon": HORIZON, "seeds": self.seeds})


def _show(lines: list[PredictionLine]) -> None:
    rows = list(dict.fromkeys(line.row for line in lines))
    for model in MODELS:
        body = []
        for source in SOURCES:
            own = {line.row: line for line in lines if (line.model, line.source) == (model, source)}
            body.append((source, *(f"{own[row].median:.2f}" for row in rows)))
            body.append(("", *(f"{own[row].low:.2g}-{own[row].high:.2g}" for row in rows)))
        title = f"position error after {HORIZON:g} s, {model.replace('_', '-')} [m]: median, 95 % of the runs"
        console().print(table(title, ("n from", *(f"row {row}" for row in rows)), body))
    left = sum(line.left for line in lines)
    say(f"{left} of {sum(line.predictions for line in lines)} predictions left the range of the model")
