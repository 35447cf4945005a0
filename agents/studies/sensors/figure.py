"""What each set of sensors adds: error of n and its bound by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure

__all__ = ["sensors_figure"]

_COLOURS = ("#0072B2", "#E69F00", "#009E73")


class _Line(Protocol):
    @property
    def sensors(self) -> str: ...

    @property
    def row(self) -> int: ...

    @property
    def rmse_after_20s(self) -> float: ...

    @property
    def bound_rmse_after_20s(self) -> float: ...


def sensors_figure(lines: Sequence[_Line]) -> Figure:
    """RMSE of n after 20 s (points) and the Cramér-Rao bound (bars) by row and set of sensors."""
    names = list(dict.fromkeys(line.sensors for line in lines))
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    axes = figure.subplots()
    for index, (name, colour) in enumerate(zip(names, _COLOURS, strict=False)):
        own = [line for line in lines if line.sensors == name]
        place = np.array([line.row for line in own]) + 0.25 * (index - 0.5 * (len(names) - 1))
        bound = [line.bound_rmse_after_20s for line in own]
        axes.bar(place, bound, width=0.22, color=colour, alpha=0.35, label=f"{name}: bound")
        rmse = [line.rmse_after_20s for line in own]
        axes.plot(place, rmse, color=colour, marker="o", ls="", mec="0.2", mew=0.5, label=f"{name}: bank")
    axes.set(
        yscale="log",
        xlabel="row of the table [-]",
        ylabel="RMSE of n after 20 s [-]",
        xticks=sorted({line.row for line in lines}),
    )
    axes.grid(alpha=0.25, axis="y")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.14))
    return figure
