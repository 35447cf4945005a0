"""Half-car against bicycle, and the paths of vehicles whose soils differ in n alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.experiments.buzhardt_tallapragada import ForwardComparison, Sweep
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import Trajectory

__all__ = ["exponent_figure", "forces_figure", "motion_figure"]

#: Okabe & Ito's colours, for colour-blind readers too. The bicycle lies on top of the livelier half-car.
_HALF_CAR: dict[str, Any] = {"color": "#0072B2", "lw": 0.8, "label": "half-car"}
_BICYCLE: dict[str, Any] = {"color": "#D55E00", "lw": 1.6, "label": "bicycle"}


def forces_figure(comparison: ForwardComparison) -> Figure:
    """Vertical, longitudinal and lateral force of both axles over time, 3 x 2 panels."""
    figure = Figure(figsize=(12.0, 7.2), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True, sharey="row")
    rows = ((at.N, "vertical $F_z$"), (at.F_L, "along the wheel $F_x$"), (at.F_C, "across the wheel $F_y$"))
    for row, (index, label) in enumerate(rows):
        for column, (axle, shift) in enumerate((("front", 0), ("rear", at.AXLE))):
            panel = axes[row, column]
            for run, style in ((comparison.half_car, _HALF_CAR), (comparison.bicycle, _BICYCLE)):
                panel.plot(comparison.t, run.readings[:, shift + index] / 1e3, **style)
            _tidy(panel)
            if row == 0:
                panel.set_title(f"{axle} axle (both wheels)", loc="left", fontsize=11)
        axes[row, 0].set_ylabel(f"{label} [kN]")
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, frameon=False)
    return figure


def motion_figure(comparison: ForwardComparison) -> Figure:
    """Ground and vertical motion over time; path and distance between the two models."""
    figure = Figure(figsize=(12.0, 6.6), layout="constrained")
    left, right = list(figure.subfigures(1, 2, width_ratios=(1.35, 1.0)))  # type: ignore[arg-type]  # two: an array
    ground, heave, pitch = left.subplots(3, 1, sharex=True)
    path, apart = right.subplots(2, 1, height_ratios=(1.6, 1.0))
    t, x = comparison.t, comparison.half_car.states
    ground.plot(t, 100.0 * comparison.half_car.readings[:, at.HEIGHT], color="0.35", lw=0.8)
    ground.set_ylabel("ground under the\nfront wheel [cm]")
    heave.plot(t, 100.0 * (x[:, at.Z] - x[0, at.Z]), **_HALF_CAR)
    heave.set_ylabel("heave from\nthe start [cm]")
    pitch.plot(t, np.degrees(x[:, at.PITCH]), **_HALF_CAR)
    pitch.set_ylabel("pitch, nose up\npositive [deg]")
    pitch.set_xlabel("time [s]")
    _draw_path(path, comparison.half_car, {**_HALF_CAR, "lw": 2.6})
    _draw_path(path, comparison.bicycle, {**_BICYCLE, "ls": "--"})
    _frame_path(path)
    path.legend(frameon=False)
    apart.plot(t, comparison.distance, color="0.2", lw=1.3)
    apart.set_ylabel("half-car to bicycle\nat equal times [m]")
    apart.set_xlabel("time [s]")
    apart.set_ylim(bottom=0.0)
    for panel in (ground, heave, pitch, apart):
        _tidy(panel)
    return figure


def exponent_figure(*sweeps: Sweep) -> Figure:
    """Paths for several sinkage exponents, one panel a sweep, dots at the end points."""
    figure = Figure(figsize=(12.0, 5.0), layout="constrained")
    headings = {"speed": "speed prescribed", "force": "drive force prescribed"}
    panels = figure.subplots(1, len(sweeps), squeeze=False)[0]
    for panel, sweep in zip(panels, sweeps, strict=True):
        shades = colormaps["viridis"](np.linspace(0.0, 0.88, len(sweep.n)))
        for n, run, shade in zip(sweep.n, sweep.runs, shades, strict=True):
            _draw_path(panel, run, {"color": shade, "lw": 1.6, "label": f"{n:g}"})
            panel.plot(*run.states[-1, [at.X, at.Y]], "o", color=shade, ms=6)
        panel.set_title(
            f"{headings[sweep.mode]}: end points up to {sweep.spread:.1f} m apart", loc="left", fontsize=11
        )
        _frame_path(panel)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        title="sinkage exponent n",
        loc="outside lower center",
        ncols=len(labels),
        frameon=False,
    )
    return figure


def _draw_path(axes: Axes, run: Trajectory, style: dict[str, Any]) -> None:
    axes.plot(run.states[:, at.X], run.states[:, at.Y], **style)


def _frame_path(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("X [m]")
    axes.set_ylabel("Y [m]")
    _tidy(axes)


def _tidy(axes: Axes) -> None:
    axes.grid(alpha=0.25)
    axes.margins(x=0.01)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
