"""Filters beside each other: error against the bound, coverage, cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["FILTER_COLOURS", "filters_figure"]

#: Okabe & Ito; the reference is grey.
FILTER_COLOURS = {
    "parameter_ukf": "#E69F00",
    "parameter_ukf_known_state": "#F0E442",
    "map_joint_ukf": "#0072B2",
    "map_ekf": "#56B4E9",
    "map_particle_filter": "#D55E00",
    "map_ukf_bank": "#009E73",
    "map_smoother": "0.45",
}


class _Line(Protocol):
    @property
    def filter(self) -> str: ...

    @property
    def row(self) -> int: ...

    @property
    def ratio(self) -> float: ...

    @property
    def coverage(self) -> float: ...


class _Total(Protocol):
    @property
    def filter(self) -> str: ...

    @property
    def title(self) -> str: ...

    @property
    def ratio(self) -> float: ...

    @property
    def microseconds(self) -> float: ...


def filters_figure(lines: Sequence[_Line], totals: Sequence[_Total]) -> Figure:
    """Error over bound and coverage by row, and what accuracy costs.

    Parameters
    ----------
    lines
        One for every filter and row (`agents.studies.filter_comparison.study.FilterLine`).
    totals
        One for every filter, in the order of the legend.
    """
    figure = Figure(figsize=(13.0, 5.2), layout="constrained")
    ratio, covers, cost = figure.subplots(1, 3, width_ratios=(5, 5, 3))
    for index, total in enumerate(totals):
        own = [line for line in lines if line.filter == total.filter]
        # Side by side: the filters of a row would cover each other.
        place = np.array([line.row for line in own]) + 0.1 * (index - 0.5 * (len(totals) - 1))
        style = {
            "color": FILTER_COLOURS[total.filter],
            "marker": "o",
            "ms": 6,
            "ls": "",
            "mec": "0.2",
            "mew": 0.4,
        }
        ratio.plot(place, [line.ratio for line in own], label=total.title, **style)
        covers.plot(place, [100.0 * line.coverage for line in own], **style)
        cost.plot(total.microseconds, total.ratio, **style)
    _finish(ratio, "Error over the bound", "RMSE of n after 20 s over the Cramér-Rao bound [-]")
    ratio.axhline(1.0, color="0.1", lw=1.2, ls="--")
    ratio.set_yscale("log")
    _finish(covers, "Coverage", "truth inside the 95 % interval [% of the time]")
    covers.axhspan(90.0, 98.0, color="0.9", zorder=0)
    covers.axhline(95.0, color="0.1", lw=1.2, ls="--")
    covers.set_ylim(-3.0, 103.0)
    for axes in (ratio, covers):
        axes.set_xticks(sorted({line.row for line in lines}))
        axes.set_xlabel("row of the table [-]")
    _finish(cost, "Error and cost", "RMSE over the bound, all rows [-]")
    cost.set(xscale="log", yscale="log", xlabel="processor time of an update [µs]")
    cost.axhline(1.0, color="0.1", lw=1.2, ls="--")
    cost.axvline(1e4, color="0.5", lw=1.0, ls=":")
    cost.annotate(
        "real time", (1e4, 0.98), xycoords=("data", "axes fraction"), ha="right", va="top", fontsize=8
    )
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


def _finish(axes: Axes, title: str, label: str) -> None:
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
