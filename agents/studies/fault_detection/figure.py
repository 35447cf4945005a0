"""Diagnoses of injected faults: the causes that they name, their error rates and their power."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from agents.studies.fault_detection.one_log import Numbers

__all__ = ["diagnosis_figure"]


def diagnosis_figure(numbers: Numbers) -> Figure:
    """Confusion matrix, shares beside their bars, and power; ``numbers`` as of the study."""
    figure = Figure(figsize=(13.5, 8.2), layout="constrained")
    places = figure.subplot_mosaic(
        [["names", "bars"], ["names", "power"]], width_ratios=(1.45, 1.0), height_ratios=(1.0, 1.1)
    )
    _draw_confusion(places["names"], numbers["confusion"])
    _draw_bars(places["bars"], numbers["bars"])
    _draw_power(places["power"], numbers["power"])
    return figure


def _draw_bars(axes: Axes, bars: Sequence[Numbers]) -> None:
    done = [bar for bar in bars if bar["count"]]
    labels = [fill(f"{bar['what']} ({bar['count']})", 24) for bar in done]
    for i, bar in enumerate(done):
        axes.barh(i, bar["most"] - bar["least"], left=bar["least"], height=0.7, color="#CFE8D5", zorder=1)
        error = [[max(bar["share"] - bar["low"], 0.0)], [max(bar["high"] - bar["share"], 0.0)]]
        axes.errorbar(bar["share"], i, xerr=error, fmt="o", color="#D55E00", capsize=3, zorder=2)
    axes.set_yticks(range(len(done)), labels, fontsize=8)
    axes.set(
        xlim=(-0.02, 1.02), xlabel="share [-]; green: required range", ylabel="what is counted (logs) [-]"
    )
    axes.invert_yaxis()
    axes.set_title("Rates", loc="left", fontsize=10)


def _draw_confusion(axes: Axes, confusion: Mapping[str, Mapping[str, float]]) -> None:
    if not confusion:
        axes.set_axis_off()
        return
    faults = sorted(confusion)
    others = sorted({name for row in confusion.values() for name in row} - set(faults) - {"nothing"})
    names = [*faults, *others, "nothing"]
    shares = np.array([[confusion[row].get(name, 0.0) for name in names] for row in faults])
    image = axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(faults)), faults, fontsize=7)
    axes.set(xlabel="best name of a cause [-]", ylabel="fault at twice its detection limit [-]")
    axes.set_title("Causes that are named", loc="left", fontsize=10)
    figure = axes.get_figure()
    assert figure is not None  # drawn into one
    figure.colorbar(image, ax=axes, label="share of the logs with this fault [-]", shrink=0.5, pad=0.01)


def _draw_power(axes: Axes, power: Numbers) -> None:
    if power["points"]:
        sizes = np.linspace(0.0, 20.0, 200)
        threshold, ratio = power["threshold"], power["ratio"]
        axes.plot(sizes, norm.cdf(sizes - threshold), color="0.1", ls=":", lw=1.4, label="bound")
        if ratio is not None:
            label = f"measured: {ratio:.2f} times\nits sizes ({power['low']:.2f} to {power['high']:.2f})"
            axes.plot(sizes, norm.cdf(sizes / ratio - threshold), color="#0072B2", lw=1.8, label=label)
        size = [point["size"] for point in power["points"]]
        share = np.array([point["share"] for point in power["points"]])
        error = [share - [p["low"] for p in power["points"]], [p["high"] for p in power["points"]] - share]
        axes.errorbar(
            size, share, yerr=np.maximum(error, 0.0), fmt="o", color="#D55E00", capsize=3, label="logs, 95 %"
        )
        axes.legend(loc="lower right", fontsize=9)
    axes.set(xlabel="size of the fault [standard deviations]", ylabel="share of logs with an alarm [-]")
    axes.set_ylim(-0.03, 1.03)
    axes.set_title("Power", loc="left", fontsize=10)
