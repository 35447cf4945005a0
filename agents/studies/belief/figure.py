"""Estimated over true n and phi with the intervals that were stated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["belief_figure"]

_COLOURS = {"tuning half": "#0072B2", "check half": "#D55E00", "straight": "0.5", "simulated": "#009E73"}
_LABELS = {"n": "sinkage exponent n [-]", "phi": "friction angle phi [rad]"}


def belief_figure(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Two panels, n and phi: a point and its 95 % interval for each drive; the diagonal is the truth."""
    figure = Figure(figsize=(10.5, 5.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, 2), _LABELS, strict=True):
        _draw(axes, name, groups)
    return figure


def _draw(axes: Axes, name: str, groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    ends: list[float] = []
    for group, rows in groups.items():
        truth = np.array([row["truth"][name] for row in rows])
        found = [row["soil"][name] for row in rows]
        mean, low, high = (np.array([item[key] for item in found]) for key in ("mean", "low", "high"))
        axes.errorbar(
            truth,
            mean,
            yerr=[mean - low, high - mean],
            fmt="o",
            ms=4,
            lw=1.0,
            capsize=2,
            color=_COLOURS[group],
            label=f"{group} ({len(rows)})",
        )
        ends += [truth.min(), truth.max()]
    line = [min(ends) - 0.03, max(ends) + 0.03]
    axes.plot(line, line, color="0.2", lw=0.9, ls="--", label="truth")
    axes.set(xlabel=f"true {_LABELS[name]}", ylabel=f"estimated {_LABELS[name]}")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=9, loc="upper left")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
