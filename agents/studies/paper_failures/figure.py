"""Why the paper's filter fails on some rows: the experiments of `agents.studies.paper_failures.study` as
pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.experiments.imu_sensitivity import ForceCurve

if TYPE_CHECKING:
    from agents.studies.paper_failures.records import Drifting, ForwardCell, Information, PhaseError, Start

__all__ = ["forward_map_figure", "information_figure", "phase_figure", "roots_figure"]

#: Okabe & Ito.
_BLUE, _ORANGE, _GREEN, _RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
_TRUE_N = 0.5


def _tidy(axes: Axes) -> None:
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def phase_figure(phases: Sequence[PhaseError], drifting: Sequence[Drifting]) -> Figure:
    """Left: error over the shift of the place alone. Right: row 1 with the state propagated and known."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    shift = [p.shift for p in phases]
    left.plot(shift, [p.trusting for p in phases], "o-", color=_RED, label="assumes the sensors' noise")
    left.plot(shift, [p.table for p in phases], "o-", color=_BLUE, label="assumes little about a_z and pitch")
    left.set_yscale("log")
    left.set_ylim(bottom=2e-7)  # room for the legend
    left.set_xlabel("place at which the map is read, off along X [m]")
    left.set_ylabel("mean square error of n [-]")
    left.set_title("row 3, state known but for the place", loc="left", fontsize=11)
    left.legend(frameon=False)
    distance = right.twinx()
    for run, colour in zip(drifting, (_RED, "0.35"), strict=True):
        right.plot(run.t, run.n, color=colour, lw=1.0, label=f"n, state {run.source}")
    distance.plot(drifting[0].t, drifting[0].distance, color=_ORANGE, lw=1.4, ls="--")
    distance.set_ylabel("propagated place off by [m] (dashed)", color=_ORANGE)
    distance.spines["top"].set_visible(False)
    right.axhline(_TRUE_N, color="0.1", lw=1.0, ls=":")
    right.set_xlabel("time [s]")
    right.set_ylabel("sinkage exponent n [-]")
    right.set_title("row 1, the sensors' noise assumed", loc="left", fontsize=11)
    right.legend(frameon=False)
    for axes in (left, right):
        _tidy(axes)
    return figure


def roots_figure(curve: ForceCurve, tracks: Sequence[Start]) -> Figure:
    """F_x over n beside the estimates of both filters from several first guesses."""
    models = list(dict.fromkeys(track.model for track in tracks))
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    force, *panels = figure.subplots(
        1, 1 + len(models), sharey=True, width_ratios=(0.8, *(1.3 for _ in models))
    )
    force.plot(curve.acceleration, curve.n, color=_BLUE, lw=1.6)
    level = float(np.interp(_TRUE_N, curve.n, curve.acceleration))
    force.plot([level] * len(curve.roots), curve.roots, "o", color=_BLUE, label="pulls like the truth")
    turns = np.interp(curve.turning_points, curve.n, curve.acceleration)
    force.plot(turns, curve.turning_points, "^", color=_RED, label="slope vanishes")
    force.set_xlabel("wheel force along x / mass [m/s$^2$]")
    force.set_ylabel("sinkage exponent n [-]")
    force.legend(frameon=False)
    for axes, model in zip(panels, models, strict=True):
        for track in tracks:
            if track.model == model:
                axes.plot(track.t, track.n, color=_BLUE if model == "half_car" else _ORANGE, lw=0.8)
        axes.set_title(f"{model.replace('_', '-')}, row 2", loc="left", fontsize=11)
        axes.set_xlabel("time [s]")
    for axes in (force, *panels):
        for n in curve.roots:
            axes.axhline(n, color="0.4", lw=0.8)
        for n in curve.turning_points:
            axes.axhline(n, color=_RED, lw=0.8, ls=":")
        axes.set_ylim(0.3, 1.4)
        _tidy(axes)
    return figure


def information_figure(curves: Sequence[Information], force: ForceCurve) -> Figure:
    """sd of n that ten seconds allow, over the true n, and the vertical share of the information."""
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for curve, colour in zip(curves, (_RED, _ORANGE, _GREEN, _BLUE), strict=True):
        left.plot(curve.n, curve.sd, color=colour, label=curve.name)
        right.plot(curve.n, 100.0 * curve.vertical, color=colour)
    for n in force.turning_points:
        left.axvline(n, color="0.4", lw=0.8, ls=":")
    left.set_yscale("log")
    left.set_ylabel("sd of n after 10 s, state known [-]")
    right.set_ylabel("information in a_z and pitch rate [%]")
    for axes in (left, right):
        axes.set_xlabel("true n [-]")
        _tidy(axes)
    left.legend(frameon=False)
    return figure


def forward_map_figure(cells: Sequence[ForwardCell]) -> Figure:
    """Largest distance between the models over slip, one line a start speed."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for speed, colour in zip(
        dict.fromkeys(c.speed for c in cells), (_BLUE, _GREEN, _ORANGE, _RED), strict=False
    ):
        own = [cell for cell in cells if cell.speed == speed]
        label = f"start at {speed:g} m/s"
        axes.plot([c.slip for c in own], [c.distance for c in own], "o-", color=colour, label=label)
    axes.axhline(15.0, color="0.4", lw=1.0, ls="--", label="the paper's largest")
    axes.set_yscale("log")
    axes.set_xlabel("constant slip [-]")
    axes.set_ylabel("half-car to bicycle, largest in 50 s [m]")
    axes.legend(frameon=False)
    _tidy(axes)
    return figure
