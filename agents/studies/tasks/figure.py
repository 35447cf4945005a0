"""What the soil changes, task by task: the physics behind the benchmark."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.studies.tasks.study import TaskCurves

__all__ = ["tasks_figure"]

_BLUE, _RED, _GREEN, _GREY = "#0072B2", "#D55E00", "#009E73", "0.45"


def tasks_figure(curves: TaskCurves) -> Figure:
    """Six panels over n, one a task.

    Parameters
    ----------
    curves
        From `agents.studies.tasks.study.task_curves`.

    Returns
    -------
    Figure
        Slip angles that a bend takes, corner speed, pull over slip, stopping distance, shaking, and what
        an estimate makes of patches.
    """
    figure = Figure(figsize=(13.0, 7.4), layout="constrained")
    track, speed, climb, brake, ride, patches = figure.subplots(2, 3).ravel()
    n = curves.n
    for angles, label, colour in zip(curves.slip_angle, ("front", "rear"), (_BLUE, _RED), strict=True):
        track.plot(n, np.degrees(angles), color=colour, lw=2, label=label)
    _finish(track, "track: in a bend of 12 m radius at 4 m/s", "slip angle [deg]", legend=True)
    speed.plot(n, curves.corner_speed, color=_BLUE, lw=2)
    _finish(speed, "speed: what a bend of 20 m radius holds at 17 deg", "corner speed [m/s]")
    climb.plot(n, curves.best_pull, color="k", lw=2.5, label="best slip for each n")
    for (slip, pull), colour in zip(curves.fixed_pull.items(), (_GREEN, _BLUE, _RED), strict=True):
        climb.plot(n, pull, color=colour, lw=1.6, ls="--", label=f"slip {slip:g}")
    for i in range(0, n.size, 4):
        climb.annotate(
            f"{curves.best_slip[i]:.2f}", (n[i], curves.best_pull[i]), (0, 5), textcoords="offset points"
        )
    climb.set_xlim(right=1.06 * float(n[-1]))  # room for the last number
    climb.set_ylim(0.0, 1.2 * float(curves.best_pull.max()))
    _finish(
        climb,
        "climb: largest pull; numbers: its slip",
        "drawbar pull over weight [-]",
        legend=True,
    )
    brake.plot(n, curves.stopping, color=_BLUE, lw=2)
    brake.set_ylim(bottom=0.0)
    _finish(brake, "brake: from 10 m/s under full brakes", "stopping distance [m]")
    ride.plot(curves.ride_n, curves.shake, "o-", color=_BLUE, lw=2)
    ride.set_ylim(0.0, 1.1 * float(curves.shake.max()))
    _finish(ride, "ride: at 5 m/s on ground of class D", "vertical acceleration, r.m.s. [m/s²]")
    _draw_patches(patches, curves.patches)
    figure.suptitle("What the soil changes in each task", fontsize=12.5, x=0.01, ha="left")
    return figure


def _draw_patches(axes: Axes, drive: dict[str, np.ndarray]) -> None:
    s, mean, sd = drive["distance"], drive["mean"], drive["sd"]
    axes.fill_between(s, mean - sd, mean + sd, color=_GREEN, alpha=0.25, lw=0, label="estimate, one sd")
    axes.plot(s, mean, color=_GREEN, lw=1.6)
    axes.plot(s, drive["n"], color="k", lw=1.6, label="n under the front wheels")
    _finish(axes, "patches: the estimate on changing soil, at 4 m/s", "sinkage exponent n [-]", legend=True)
    axes.set_xlabel("way along the course [m]")


def _finish(axes: Axes, title: str, label: str, *, legend: bool = False) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_xlabel("sinkage exponent n [-]")
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
    if legend:
        axes.legend(frameon=False, fontsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
