"""Position error of open-loop predictions, by what is believed about the soil."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure

__all__ = ["prediction_figure"]

_COLOURS = ("#E69F00", "#56B4E9", "#009E73", "0.25")


class _Line(Protocol):
    @property
    def row(self) -> int: ...

    @property
    def model(self) -> str: ...

    @property
    def source(self) -> str: ...

    @property
    def median(self) -> float: ...

    @property
    def low(self) -> float: ...

    @property
    def high(self) -> float: ...


def prediction_figure(lines: Sequence[_Line]) -> Figure:
    """Median and 95 % of the runs by row, one panel a model, one colour a source of n."""
    models = list(dict.fromkeys(line.model for line in lines))
    sources = list(dict.fromkeys(line.source for line in lines))
    figure = Figure(figsize=(13.0, 4.8), layout="constrained")
    panels = figure.subplots(1, len(models), sharey=True)
    # Predictions that left the model have no error to draw: their bars end at the top of the panel.
    finite = [value for line in lines for value in (line.median, line.high) if np.isfinite(value)]
    top = 2.0 * max(finite, default=1.0)
    for axes, model in zip(panels, models, strict=True):
        for index, (source, colour) in enumerate(zip(sources, _COLOURS, strict=True)):
            own = [line for line in lines if (line.model, line.source) == (model, source)]
            median, low, high = (
                np.minimum([getattr(line, part) for line in own], top) for part in ("median", "low", "high")
            )
            place = np.array([line.row for line in own]) + 0.17 * (index - 0.5 * (len(sources) - 1))
            axes.errorbar(
                place, median, yerr=(median - low, high - median), fmt="o", ms=6, capsize=2, color=colour,
                label=f"n: {source}",
            )  # fmt: skip
        axes.set_title(f"Prediction by the {model.replace('_', '-')}", loc="left", fontsize=11)
        axes.set(yscale="log", xlabel="row of the table [-]", xticks=sorted({line.row for line in lines}))
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    panels[0].set_ylabel("position error after 10 s [m]")
    panels[0].legend(frameon=False, fontsize=9)
    return figure
