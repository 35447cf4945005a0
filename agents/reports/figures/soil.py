"""Sinkage, drawbar pull and side force of one wheel, over slip and over load."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.reports.soil_curves import SoilCurves

__all__ = ["soil_figure"]


def soil_figure(curves: SoilCurves, *, title: str) -> Figure:
    """Curves of a soil.

    Parameters
    ----------
    curves
        From `agents.reports.soil_curves.soil_curves`.
    title
        Heading: which soil, which wheel.

    Returns
    -------
    Figure
        2 x 3 panels: over slip, one line a load; over load, one line a slip. A line that ends early
        ends where the soil no longer carries the wheel.
    """
    figure = Figure(figsize=(12.0, 6.8), layout="constrained")
    axes = figure.subplots(2, 3)
    angle = f"{math.degrees(curves.slip_angle):.0f}° slip angle"
    unit, force = ("kN", 1e-3) if curves.loads.max() >= 1000.0 else ("N", 1.0)
    columns = (
        ("sinkage", 1e3, "sinkage [mm]"),
        ("drawbar", force, f"drawbar pull $F_x$ [{unit}]"),
        ("side_force", force, f"side force at {angle} [{unit}]"),
    )
    rows = (
        (curves.slip_axis, curves.over_slip, "slip [-]  (-1 locked, 1 spinning)"),
        (force * curves.load_axis, curves.over_load, f"wheel load [{unit}]"),
    )
    labels = (
        [f"{force * load:g} {unit}" for load in curves.loads],
        [f"{slip:g}" for slip in curves.slips],
    )
    for row, (x, values, label) in enumerate(rows):
        for column, (name, scale, heading) in enumerate(columns):
            panel = axes[row, column]
            _draw(panel, x, scale * values[name], labels[row])
            panel.set(xlabel=label, ylabel=heading)
        # On hard ground the sinkage is zero throughout: an axis of 1 mm instead of rounding errors.
        axes[row, 0].set_ylim(0.0, None if np.nanmax(values["sinkage"], initial=0.0) > 0.0 else 1.0)
        axes[row, 2].set_ylim(bottom=0.0)
    for panel, heading in zip(axes[:, 0], ("wheel load", "slip"), strict=True):
        panel.legend(title=heading, frameon=False, fontsize=9, title_fontsize=9)
    figure.suptitle(title, fontsize=12.5, x=0.01, ha="left")
    return figure


def _draw(axes: Axes, x: np.ndarray, lines: np.ndarray, labels: list[str]) -> None:
    shades = colormaps["viridis"](np.linspace(0.0, 0.8, len(lines)))
    for line, label, shade in zip(lines, labels, shades, strict=True):
        axes.plot(x, line, color=shade, lw=1.9, label=label)
    axes.axhline(0.0, color="0.4", lw=0.8)
    if x[0] < 0.0:
        axes.axvline(0.0, color="0.4", lw=0.6, ls=":")
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
