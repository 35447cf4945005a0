"""Measured against predicted forces and sinkage of a single wheel, over slip."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimators.rig.comparison import CHANNELS, RigComparison

__all__ = ["wheel_rig_figure"]

_SHOWN_IN = {"m": ("mm", 1e3), "N": ("N", 1.0)}
_GREY = "0.35"


def wheel_rig_figure(comparison: RigComparison, *, title: str | None = None) -> Figure:
    """Measured and predicted sinkage, drawbar pull and side force over slip, residuals below.

    Parameters
    ----------
    comparison
        From `estimators.rig.comparison.compare`.
    title
        Heading; default: what was measured and how many trials are shown.

    Returns
    -------
    Figure
        2 x 3 panels, one colour per slip angle. Points: mean over the repeats of a condition, bars:
        standard deviation between repeats (often smaller than the point). Lines: the model at the
        mean load of that slip angle; residuals use the load of each trial.
    """
    figure = Figure(figsize=(13.0, 7.6), layout="constrained")
    axes = figure.subplots(2, len(CHANNELS), sharex=True, height_ratios=(3, 2))
    colours = _colours(comparison)
    for column, channel in enumerate(CHANNELS):
        unit, scale = _SHOWN_IN[channel.unit]
        _draw_forces(axes[0, column], comparison, column, scale, colours)
        axes[0, column].set_ylabel(f"{channel.title} [{unit}]")
        _draw_residuals(axes[1, column], comparison, column, scale, colours)
        axes[1, column].set_title(_score_line(comparison, channel.name, unit, scale), loc="left", fontsize=9)
        axes[1, column].set_ylabel(f"measured - predicted [{unit}]")
        axes[1, column].set_xlabel("longitudinal slip [-]  (-1 locked, 1 spinning)")
    axes[0, 0].set_ylim(bottom=0.0)
    figure.suptitle(title or _default_title(comparison), fontsize=13, x=0.01, ha="left")
    figure.legend(handles=_legend(colours), loc="outside lower center", ncols=len(colours) + 2, frameon=False)
    return figure


def _colours(comparison: RigComparison) -> dict[float, tuple[float, float, float, float]]:
    """Slip angle -> colour, light to dark with the size of the angle."""
    angles = sorted({round(abs(curve.slip_angle), 9) for curve in comparison.curves})
    shades = colormaps["plasma"](np.linspace(0.0, 0.85, len(angles)))
    return dict(zip(angles, map(tuple, shades), strict=True))


def _rows(comparison: RigComparison, angle: float) -> np.ndarray:
    rows = np.flatnonzero(np.isclose(np.abs(comparison.conditions.slip_angle), angle, atol=1e-6))
    return rows[np.argsort(comparison.conditions.slip[rows])]


def _draw_forces(
    axes: Axes, comparison: RigComparison, column: int, scale: float, colours: dict[float, Any]
) -> None:
    table = comparison.conditions
    for curve in comparison.curves:
        colour = colours[round(abs(curve.slip_angle), 9)]
        axes.plot(curve.slip, scale * curve.values[:, column], color=colour, lw=1.8)
    for angle, colour in colours.items():
        rows = _rows(comparison, angle)
        axes.errorbar(
            table.slip[rows],
            scale * table.measured[rows, column],
            yerr=scale * table.measured_sd[rows, column],
            fmt="o",
            ms=5,
            color=colour,
            mec="white",
            mew=0.6,
            capsize=2,
            ls=":",
            lw=0.9,
        )
    _tidy(axes)


def _draw_residuals(
    axes: Axes, comparison: RigComparison, column: int, scale: float, colours: dict[float, Any]
) -> None:
    table = comparison.conditions
    for angle, colour in colours.items():
        rows = _rows(comparison, angle)
        axes.errorbar(
            table.slip[rows],
            scale * table.residual[rows, column],
            yerr=scale * table.residual_sd[rows, column],
            fmt="o",
            ms=4,
            color=colour,
            capsize=2,
            ls=":",
            lw=0.9,
        )
    _tidy(axes)


def _tidy(axes: Axes) -> None:
    axes.axhline(0.0, color=_GREY, lw=0.8)
    axes.axvline(0.0, color=_GREY, lw=0.5, ls=":")
    axes.grid(alpha=0.25)
    axes.set_xlim(-1.06, 1.06)
    axes.set_xticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _score_line(comparison: RigComparison, name: str, unit: str, scale: float) -> str:
    score = comparison.scores[name]
    low, high = (scale * value for value in score.rmse_interval)
    return (
        f"residual: RMSE {scale * score.rmse:.1f} {unit} [{low:.1f}, {high:.1f}], "
        f"bias {scale * score.bias:+.1f}, repeats {scale * score.repeat_sd:.1f}"
    )


def _default_title(comparison: RigComparison) -> str:
    left_out = comparison.trials - comparison.inside
    text = f"One wheel on soil: {comparison.inside} trials, measured and predicted"
    return text + (f" ({left_out} outside the model's domain not shown)" if left_out else "")


def _legend(colours: dict[float, Any]) -> list[Line2D]:
    kinds = [
        Line2D([], [], color=_GREY, marker="o", ls=":", lw=0.9, label="measured, sd of repeats"),
        Line2D([], [], color=_GREY, lw=1.8, label="model"),
    ]
    angles = [
        Line2D([], [], color=colour, marker="o", lw=1.8, label=f"{'slip angle ' * (i == 0)}{degrees:.0f}°")
        for i, (degrees, colour) in enumerate((math.degrees(a), c) for a, c in colours.items())
    ]
    return kinds + angles
