"""One episode on one page: where it went, how fast, on which soil, and what the driver did."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from agents.driving.recording import EpisodeLog

__all__ = ["drive_figure"]

# Colours of Okabe & Ito, as in the rendered pictures: front blue, rear vermilion, estimate green.
_FRONT, _REAR, _ESTIMATE, _EDGE, _GREY = "#0072B2", "#D55E00", "#009E73", "#7A4A1E", "0.4"

_ENDINGS = {
    "": "not ended",
    "goal": "goal reached",
    "left_corridor": "left the corridor",
    "overran": "crossed the line",
    "too_rough": "shaken too much",
    "rollover": "rolled over",
    "immobilised": "immobilised",
    "diverged": "simulation diverged",
}


def drive_figure(log: EpisodeLog, *, title: str | None = None) -> Figure:
    """Path and corridor from above, and six panels over time.

    Parameters
    ----------
    log
        Of an episode, finished or not, with at least two rows.
    title
        Heading; default: scenario, true n, how it ended and how long it took.

    Returns
    -------
    Figure
        Above: the corridor with the true path of the vehicle, coloured by speed. Below, over time [s]:
        speed, cross-track error, commands; slip, sinkage, and n with its estimate (or its prior, if
        no estimator ran).
    """
    columns = log.columns()
    figure = Figure(figsize=(13.0, 9.2), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=(1.35, 1.0, 1.0))
    _draw_course(figure, figure.add_subplot(grid[0, :]), log, columns)
    panels = [figure.add_subplot(grid[1 + i // 3, i % 3]) for i in range(6)]
    draws = (_draw_speed, _draw_error, _draw_commands, _draw_slip, _draw_sinkage, _draw_exponent)
    for axes, draw in zip(panels, draws, strict=True):
        draw(axes, log, columns)
        _tidy(axes)
        axes.set(xlabel="time [s]", xlim=(0.0, max(float(columns["time"][-1]), 1e-3)))
    figure.suptitle(title or _headline(log, columns), fontsize=13, x=0.01, ha="left")
    return figure


def _headline(log: EpisodeLog, columns: dict[str, np.ndarray]) -> str:
    time, done = columns["time"][-1], columns["progress"][-1]
    ending = _ENDINGS.get(log.ending, log.ending)
    return (
        f"{log.scenario}, true n = {columns['n_front'][0]:.2f}: {ending} "
        f"after {time:.1f} s and {done:.0f} of {log.path.length:.0f} m"
    )


def _tidy(axes: Axes) -> None:
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _legend(axes: Axes) -> None:
    """One line above the plot, where it hides nothing."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        frameon=False,
        fontsize=8.5,
        borderpad=0.1,
        borderaxespad=0.1,
        handlelength=1.4,
        columnspacing=1.2,
    )


def _draw_course(figure: Figure, axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    line, yaw = log.path.xy, log.path.yaw
    left = log.corridor * np.column_stack((-np.sin(yaw), np.cos(yaw)))
    axes.fill(*np.concatenate((line + left, (line - left)[::-1])).T, color="#EFE6D6", lw=0.0)
    for edge in (line + left, line - left):
        axes.plot(*edge.T, color=_EDGE, lw=0.8)
    axes.plot(*line.T, color="0.2", lw=0.8, ls=(0, (6, 5)))
    points = np.column_stack((columns["X"], columns["Y"]))
    driven = LineCollection(
        list(np.stack((points[:-1], points[1:]), axis=1)), cmap="viridis", lw=2.6, capstyle="round"
    )
    driven.set_array(columns["speed"][1:])
    axes.add_collection(driven)
    axes.plot(*line[-1], "s", color=_ESTIMATE, ms=7)
    axes.plot(*points[-1], "o", color="black", mfc="white", ms=7, mew=1.8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set(xlabel="X [m]", ylabel="Y [m]")
    axes.set_title(
        f"From above: path, corridor of \u00b1{log.corridor:g} m, and where the vehicle went (circle: end)",
        loc="left",
        fontsize=10,
    )
    _tidy(axes)
    figure.colorbar(driven, ax=axes, label="speed [m/s]", pad=0.01, aspect=14)


def _draw_speed(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    if log.target_speed > 0.0:
        axes.axhline(log.target_speed, color=_GREY, ls="--", lw=1.2, label="target")
    axes.plot(columns["time"], columns["speed"], color="black", lw=1.4, label="vehicle")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("speed [m/s]")
    _legend(axes)


def _draw_error(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    axes.axhline(0.0, color=_GREY, lw=0.8)
    for side in (-log.corridor, log.corridor):
        axes.axhline(side, color=_EDGE, ls="--", lw=1.2, label="corridor" if side > 0.0 else None)
    axes.plot(columns["time"], columns["cross_track_error"], color="black", lw=1.4, label="vehicle")
    axes.set_ylabel("left of the path [m]")
    _legend(axes)


def _draw_commands(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    axes.axhline(0.0, color=_GREY, lw=0.8)
    axes.plot(
        columns["time"], columns["steer"] / log.steer_max, color="#CC79A7", lw=1.2, label="steer, left +"
    )
    axes.plot(columns["time"], columns["drive"], color="black", lw=1.2, label="drive, brake \u2212")
    axes.set_ylim(-1.06, 1.06)
    axes.set_ylabel("commands [-]")
    _legend(axes)


def _draw_axles(axes: Axes, columns: dict[str, np.ndarray], name: str, scale: float) -> None:
    for axle, colour in (("rear", _REAR), ("front", _FRONT)):
        axes.plot(columns["time"], scale * columns[f"{name}_{axle}"], color=colour, lw=1.2, label=axle)
    _legend(axes)


def _draw_slip(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    axes.axhline(0.0, color=_GREY, lw=0.8)
    _draw_axles(axes, columns, "slip", 1.0)
    axes.set_ylabel("slip [-]")


def _draw_sinkage(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    _draw_axles(axes, columns, "sinkage", 1e3)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("sinkage [mm]")


def _draw_exponent(axes: Axes, log: EpisodeLog, columns: dict[str, np.ndarray]) -> None:
    time, mean, sd = columns["time"], columns["n_estimate"], columns["n_estimate_sd"]
    low, high = log.n_range
    if log.estimating:
        axes.fill_between(time, mean - 2.0 * sd, mean + 2.0 * sd, color=_ESTIMATE, alpha=0.25, lw=0.0)
        axes.plot(time, mean, color=_ESTIMATE, lw=1.6, label="estimate \u00b1 2 sd")
    else:
        axes.fill_between(time, low, high, color="0.88", lw=0.0, label="prior (no estimator)")
    axes.plot(time, columns["n_front"], color="black", lw=1.4, ls=(0, (4, 3)), label="true")
    margin = max(0.12 * (high - low), 0.05)
    axes.set_ylim(low - margin, high + margin)
    axes.set_ylabel("sinkage exponent n [-]")
    _legend(axes)
