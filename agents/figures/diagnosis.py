"""What the finder makes of hidden effects: which names it gives them, and how small they may be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

__all__ = ["diagnosis_figure"]


def diagnosis_figure(numbers: Mapping) -> Figure:
    """Confusion matrix, and power against the bound; ``numbers`` of `agents.studies.diagnosis.counted`."""
    figure = Figure(figsize=(13.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_confusion(left, numbers["confusion"])
    _draw_power(right, numbers["power"])
    return figure


def _draw_confusion(axes: Axes, confusion: Mapping[str, Mapping[str, float]]) -> None:
    if not confusion:
        axes.set_axis_off()
        return
    hidden = sorted(confusion)
    others = sorted({name for row in confusion.values() for name in row} - set(hidden) - {"nothing"})
    names = [*hidden, *others, "nothing"]
    shares = np.array([[confusion[row].get(name, 0.0) for name in names] for row in hidden])
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), share in np.ndenumerate(shares):
        if share > 0.0:
            colour = "white" if share > 0.6 else "0.1"
            axes.text(
                j, i, f"{share:.2f}".removeprefix("0"), ha="center", va="center", fontsize=8, color=colour
            )
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(hidden)), hidden, fontsize=8)
    axes.set_title(
        "Hidden at twice the limit (rows), named first in a set (columns): share of logs",
        loc="left",
        fontsize=10,
    )


def _draw_power(axes: Axes, power: Mapping) -> None:
    if power["points"]:
        sizes = np.linspace(0.0, 20.0, 200)
        threshold, ratio = power["threshold"], power["ratio"]
        axes.plot(sizes, norm.cdf(sizes - threshold), color="0.1", ls=":", lw=1.4, label="bound")
        if ratio is not None:
            label = f"measured: {ratio:.2f} times the bound's sizes"
            axes.plot(sizes, norm.cdf(sizes / ratio - threshold), color="#0072B2", lw=1.8, label=label)
        size = [point["size"] for point in power["points"]]
        share = np.array([point["share"] for point in power["points"]])
        error = [share - [p["low"] for p in power["points"]], [p["high"] for p in power["points"]] - share]
        axes.errorbar(
            size, share, yerr=np.maximum(error, 0.0), fmt="o", color="#D55E00", capsize=3, label="logs, 95 %"
        )
        axes.legend(loc="lower right", fontsize=9)
    axes.set(
        xlabel="hidden size over its standard deviation", ylabel="share of logs in which something is found"
    )
    axes.set_ylim(-0.03, 1.03)
    axes.set_title("Power", loc="left", fontsize=10)
