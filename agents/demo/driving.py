"""Driving in the environment, and estimating the soil meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.demo.context import Run
from agents.driving.figure import drive_figure
from agents.driving.playback import episode_playback
from agents.driving.unwrapped import bekker_env
from agents.reports.figures.estimate import EstimateLine, EstimatePanel, estimate_figure
from agents.reports.page import Section, Table, figure_picture, frame_picture
from estimators.experiments.buzhardt_tallapragada import ROWS, RowRun, row_truth, run_row

__all__ = ["drive_section", "estimate_section"]


def drive_section(run: Run) -> Section:
    """One episode of the arm that lives on its estimate: a picture, and the plot of the command."""
    driven, settings = run.driven, run.settings
    info, log = driven.drive.info, driven.drive.log
    speed = log.columns()["speed"]
    sees = (
        f"The vehicle, whose speed is planned by the estimated soil, {_ending(info)} at {speed.mean():.1f} "
        f"m/s on average and {speed.max():.1f} m/s at most; the true exponent is {info['n']:.2f}."
    )
    caption = (
        "Half way, as --window and --video show it: from above with path and corridor, from the side with "
        "sinkage, suspension and pitch, and the exponent, true and estimated."
    )
    pictures = [figure_picture(drive_figure(log), "The whole episode, as the command plots it.")]
    if driven.frame is not None:
        pictures.insert(0, frame_picture(driven.frame, caption))
    left_out = "The picture of the environment needs pygame-ce: pip install 'offroad-bekker[view]'."
    shown = bekker_env(driven.drive.env)
    kept = ("n", "time", "progress", "path_length", "success", "failure")
    return Section(
        name="drive",
        title=f"One episode of the scenario {settings.scenario!r}",
        sees=sees,
        command=f"offroad drive --scenario {settings.scenario} --agent aware --seed {settings.seed}",
        playback=episode_playback(log, shown.briefing, shown.plant),
        pictures=tuple(pictures),
        notes=() if driven.frame is not None else (left_out,),
        data={key: info[key] for key in kept},
    )


def _ending(info: dict[str, Any]) -> str:
    if info["success"]:
        return f"reaches the goal of the {info['path_length']:.0f} m course in {info['time']:.1f} s"
    reason = (info["failure"] or "time limit").replace("_", " ")
    return f"ends ({reason}) {info['progress']:.0f} m into the {info['path_length']:.0f} m course"


def estimate_section(run: Run) -> Section:
    """The paper's filter on a row of its table, and the filter on board in the episode."""
    settings = run.settings
    row = ROWS[settings.row - 1]
    truth = row_truth(row, duration=settings.row_duration)
    results = [run_row(row, model, seed=settings.seed, truth=truth) for model in ("half_car", "bicycle")]
    run.tick(0.5)
    info, columns, half_car = run.driven.drive.info, run.driven.drive.log.columns(), results[0].filter.belief
    start, end, true = _belief(columns, 0), _belief(columns, -1), float(info["n"])
    sees = (
        f"On row {row.number} of the paper's table the half-car filter moves from its guess "
        f"{half_car.n[0]:.2f} to {half_car.n[-1]:.2f} (true {truth.n:g}); on board, in one episode, the "
        f"estimate moves from {start} to {end} (true {true:.2f})."
    )
    figure = estimate_figure((_row_panel(results), _board_panel(run)))
    repairs = int(info["filter_repairs"])
    return Section(
        name="estimate",
        title="Estimating n while driving",
        sees=sees,
        command="offroad demo --only estimate",
        pictures=(figure_picture(figure, "Mean and band of two standard deviations of each filter."),),
        tables=(_error_table(results, settings.row_duration),),
        notes=(
            f"Errors: over {settings.row_duration:g} s and one seed of the noise, the paper's over 100 s. On "
            f"board the filter's covariance had to be repaired {repairs} times.",
        ),
        key=(("Estimate of n on board after one episode", f"{end} (true {true:.2f})"),),
        data={
            "row": row.number,
            "true_n": truth.n,
            "mse": {result.model: result.mse for result in results},
            "paper_mse": {result.model: result.paper_mse for result in results},
            "on_board": {
                "true_n": true,
                "mean": info["n_estimate"],
                "sd": info["n_estimate_sd"],
                "repairs": repairs,
            },
        },
    )


def _belief(columns: dict[str, np.ndarray], index: int) -> str:
    return f"{columns['n_estimate'][index]:.2f} ± {columns['n_estimate_sd'][index]:.2f}"


def _row_panel(results: Sequence[RowRun]) -> EstimatePanel:
    truth, t = results[0].truth, results[0].t
    row = truth.row
    soil = row.soil.replace("_", " ")
    steering = (
        f"{row.steer_amplitude:g} sin({row.steer_frequency:g} t) rad" if row.steer_amplitude else "none"
    )
    return EstimatePanel(
        title=f"Paper, row {row.number}: {soil}, $H_0$ = {row.H0:g} m, steering {steering}",
        t=t,
        truth=np.full(t.shape, truth.n),
        lines=tuple(
            EstimateLine(
                label=f"{_name(result)} filter", n=result.filter.belief.n, sd=result.filter.belief.sd
            )
            for result in results
        ),
    )


def _board_panel(run: Run) -> EstimatePanel:
    columns, settings = run.driven.drive.log.columns(), run.settings
    line = EstimateLine(label="online filter", n=columns["n_estimate"], sd=columns["n_estimate_sd"])
    return EstimatePanel(
        title=f"On board: scenario {settings.scenario!r}, seed {settings.seed}",
        t=columns["time"],
        truth=columns["n_front"],
        lines=(line,),
    )


def _name(result: RowRun) -> str:
    return result.model.replace("_", "-")


def _error_table(results: Sequence[RowRun], duration: float) -> Table:
    rows = tuple(
        (
            _name(result),
            f"{result.filter.belief.n[-1]:.3f} ± {result.filter.belief.sd[-1]:.3f}",
            f"{result.mse:.2e}",
            f"{result.paper_mse:.2e}",
        )
        for result in results
    )
    heading = ("filter model", f"n after {duration:g} s [-]", "mean square error [-]", "the paper's [-]")
    return Table(heading=heading, rows=rows)
