"""A wheel in a soil bin by several structures: measured and predicted over slip."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimators.rig.comparison import CHANNELS, RigComparison
from estimators.rig.structures import ladder_title

__all__ = ["rig_structures_figure"]

_SHOWN_IN = {"m": ("mm", 1e3), "N": ("N", 1.0)}
#: Okabe & Ito, grey and brown in place of black and yellow: black is measured.
_COLOURS = ("#7F7F7F", "#D55E00", "#E69F00", "#009E73", "#56B4E9", "#0072B2", "#CC79A7", "#8C6D31")
#: Slip angles that are drawn: straight ahead, and the one nearest to this [rad].
_OBLIQUE = math.radians(45.0)


def rig_structures_figure(comparisons: Mapping[str, RigComparison]) -> Figure:
    """Measured means and the curves of each structure, straight ahead and at one large slip angle.

    Parameters
    ----------
    comparisons
        From `estimators.rig.structures.compare_structures`.

    Returns
    -------
    Figure
        Panels: a row for each slip angle, a column for each channel. Points: means over the repeats
        of a condition. Lines: the model at the mean load of that slip angle.
    """
    figure = Figure(figsize=(11.5, 7.2), layout="constrained")
    first = next(iter(comparisons.values()))
    sizes = sorted({round(abs(curve.slip_angle), 9) for curve in first.curves})
    angles = [sizes[0], min(sizes, key=lambda angle: abs(angle - _OBLIQUE))]
    axes = figure.subplots(2, len(CHANNELS), sharex=True)
    styles = {name: _COLOURS[i % len(_COLOURS)] for i, name in enumerate(comparisons)}
    for row, angle in enumerate(angles):
        for column, channel in enumerate(CHANNELS):
            unit, scale = _SHOWN_IN[channel.unit]
            panel = axes[row, column]
            if row == 0 and channel.name == "side_force":
                _draw_legend(panel, styles)  # there is none straight ahead
                continue
            for name, comparison in comparisons.items():
                _draw_curve(panel, comparison, angle, column, scale, styles[name])
            _draw_points(panel, first, angle, column, scale)
            quantity = f"{channel.title[0].upper()}{channel.title[1:]} [{unit}]"
            panel.set_ylabel(quantity)
            panel.set_title(f"Slip angle {math.degrees(angle):.0f}°", loc="left", fontsize=10)
            _tidy(panel)
    for panel in axes[1]:
        panel.set_xlabel("longitudinal slip [-]  (-1 locked, 1 spinning)")
    title = f"One wheel in a soil bin by {len(comparisons)} structures, nothing fitted"
    figure.suptitle(title, fontsize=13, x=0.01, ha="left")
    return figure


def _draw_legend(panel: Axes, styles: Mapping[str, str]) -> None:
    handles = [Line2D([], [], color="black", marker="o", ls="", label="measured, sd of repeats")]
    handles += [Line2D([], [], color=styles[name], lw=2.2, label=ladder_title(name)) for name in styles]
    panel.legend(handles=handles, loc="center", frameon=False, fontsize=11)
    panel.axis("off")


def _draw_curve(
    panel: Axes,
    comparison: RigComparison,
    angle: float,
    column: int,
    scale: float,
    colour: str,
) -> None:
    for curve in comparison.curves:
        if math.isclose(abs(curve.slip_angle), angle, abs_tol=1e-6):
            panel.plot(curve.slip, scale * curve.values[:, column], color=colour, lw=1.8)


def _draw_points(panel: Axes, comparison: RigComparison, angle: float, column: int, scale: float) -> None:
    table = comparison.conditions
    rows = np.isclose(np.abs(table.slip_angle), angle, atol=1e-6)
    panel.errorbar(
        table.slip[rows],
        scale * table.measured[rows, column],
        yerr=scale * table.measured_sd[rows, column],
        fmt="o",
        ms=5,
        color="black",
        mec="white",
        mew=0.6,
        capsize=2,
        zorder=10,
    )


def _tidy(panel: Axes) -> None:
    panel.axhline(0.0, color="0.35", lw=0.8)
    panel.grid(alpha=0.25)
    panel.set_xlim(-1.06, 1.06)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
