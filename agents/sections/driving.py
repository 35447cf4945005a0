"""Driving in the environment, and estimating the soil meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.figures.estimate import EstimateLine, EstimatePanel, estimate_figure
from agents.report import Section, Table, figure_picture, frame_picture
from agents.sections.context import Run, Trace
from estimators.paper import ROWS, RowRun, row_truth, run_row

__all__ = ["drive_section", "estimate_section"]


def drive_section(run: Run) -> Section:
    """One episode of the arm that lives on its estimate, with a picture."""
    trace, settings = run.trace, run.settings
    info = trace.last
    sees = (
        f"The vehicle, told nothing about the soil, {_ending(info)} at {trace.speed.mean():.1f} m/s on "
        f"average and {trace.speed.max():.1f} m/s at most; the true exponent is {info['n']:.2f}."
    )
    caption = (
        "Half way: from above with path and corridor, from the side with sinkage, suspension and pitch, the "
        "exponent true and estimated over time."
    )
    pictures = () if trace.frame is None else (frame_picture(trace.frame, caption),)
    notes = () if pictures else ("The picture needs pygame-ce: pip install 'offroad-bekker[view]'.",)
    kept = ("n", "time", "progress", "path_length", "success", "failure")
    return Section(
        name="drive",
        title=f"One episode of the scenario {settings.scenario!r}",
        sees=sees,
        command=f"offroad drive --scenario {settings.scenario} --agent aware --seed {settings.seed}",
        pictures=pictures,
        notes=notes,
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
    trace, half_car = run.trace, results[0].filter
    start, end, true = _belief(trace, 0), _belief(trace, -1), float(trace.last["n"])
    sees = (
        f"On row {row.number} of the paper's table the half-car filter moves from its guess "
        f"{half_car.n[0]:.2f} to {half_car.n[-1]:.2f} (true {truth.n:g}); on board, in one episode, the "
        f"estimate moves from {start} to {end} (true {true:.2f})."
    )
    figure = estimate_figure((_row_panel(results), _trace_panel(run)))
    repairs = int(trace.last["filter_repairs"])
    return Section(
        name="estimate",
        title="Estimating n while driving",
        sees=sees,
        command="offroad demo --only estimate",
        pictures=(figure_picture(figure, "Mean and band of two standard deviations of each filter."),),
        tables=(_error_table(results, settings.row_duration),),
        notes=(
            f"The paper's errors are over 100 s, those here over {settings.row_duration:g} s and one seed of "
            f"the noise. On board, the covariance had to be repaired {repairs} times.",
        ),
        key=(("Estimate of n on board after one episode", f"{end} (true {true:.2f})"),),
        data={
            "row": row.number,
            "true_n": truth.n,
            "mse": {result.model: result.mse for result in results},
            "paper_mse": {result.model: result.paper_mse for result in results},
            "on_board": {"true_n": true, "mean": trace.mean[-1], "sd": trace.sd[-1], "repairs": repairs},
        },
    )


def _belief(trace: Trace, index: int) -> str:
    return f"{trace.mean[index]:.2f} ± {trace.sd[index]:.2f}"


def _row_panel(results: Sequence[RowRun]) -> EstimatePanel:
    truth, t = results[0].truth, results[0].t
    row = truth.row
    steering = (
        f"{row.steer_amplitude:g} sin({row.steer_frequency:g} t) rad" if row.steer_amplitude else "none"
    )
    return EstimatePanel(
        title=f"Paper, row {row.number}: {row.soil.replace('_', ' ')}, $H_0$ = {row.H0:g} m, steering {steering}",
        t=t,
        truth=np.full(t.shape, truth.n),
        lines=tuple(
            EstimateLine(label=f"{_name(result)} filter", n=result.filter.n, sd=result.filter.sd)
            for result in results
        ),
    )


def _trace_panel(run: Run) -> EstimatePanel:
    trace, settings = run.trace, run.settings
    return EstimatePanel(
        title=f"On board: scenario {settings.scenario!r}, seed {settings.seed}",
        t=trace.t,
        truth=trace.n,
        lines=(EstimateLine(label="embedded filter", n=trace.mean, sd=trace.sd),),
    )


def _name(result: RowRun) -> str:
    return result.model.replace("_", "-")


def _error_table(results: Sequence[RowRun], duration: float) -> Table:
    rows = tuple(
        (
            _name(result),
            f"{result.filter.n[-1]:.3f} ± {result.filter.sd[-1]:.3f}",
            f"{result.mse:.2e}",
            f"{result.paper_mse:.2e}",
        )
        for result in results
    )
    heading = ("filter model", f"n after {duration:g} s [-]", "mean square error [-]", "the paper's [-]")
    return Table(heading=heading, rows=rows)
