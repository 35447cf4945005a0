"""Estimates of the sinkage exponent over time, with their bands and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["EstimateLine", "EstimatePanel", "estimate_figure"]

_COLOURS = ("#0072B2", "#D55E00", "#009E73")  # Okabe & Ito


@dataclass(frozen=True, kw_only=True)
class EstimateLine:
    """What one filter believed over time."""

    label: str
    n: np.ndarray  #: (T,) mean [-]
    sd: np.ndarray  #: (T,) standard deviation [-]


@dataclass(frozen=True, kw_only=True)
class EstimatePanel:
    """Filters that saw the same truth."""

    title: str
    t: np.ndarray  #: (T,) [s]
    truth: np.ndarray  #: (T,) true exponent [-]
    lines: tuple[EstimateLine, ...]


def estimate_figure(panels: Sequence[EstimatePanel]) -> Figure:
    """One panel a truth: mean of every filter, band of two standard deviations, true n dashed."""
    figure = Figure(figsize=(12.0, 4.4), layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        _draw(axes, panel)
    return figure


def _draw(axes: Axes, panel: EstimatePanel) -> None:
    for line, colour in zip(panel.lines, _COLOURS, strict=False):
        low, high = line.n - 2.0 * line.sd, line.n + 2.0 * line.sd
        axes.fill_between(panel.t, low, high, color=colour, alpha=0.18, lw=0)
        axes.plot(panel.t, line.n, color=colour, lw=1.5, label=f"{line.label}, ± 2 sd")
    axes.plot(panel.t, panel.truth, color="0.1", lw=1.3, ls="--", label="true n")
    axes.set_title(panel.title, loc="left", fontsize=11)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("sinkage exponent n [-]")
    axes.margins(x=0.0)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=9)
