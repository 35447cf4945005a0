"""Time on changing soil over how late n is told."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure

from agents.benchmark.statistics import Interval

__all__ = ["promptness_figure"]

_TOLD, _AWARE, _BLIND = "0.25", "#0072B2", "#E69F00"


class _Driven(Protocol):
    name: str
    delay: float
    score: Interval
    failures: int
    episodes: int


class _Filter(Protocol):
    name: str
    delay: float


def promptness_figure(driven: Sequence[_Driven], filters: Sequence[_Filter]) -> Figure:
    """Mean time of who is told n late (line, with failures), of the arms (bands), and the filters' delays.

    Parameters
    ----------
    driven
        Delays, then the arms of the benchmark (their delay is NaN).
    filters
        Their median delays are marked below.
    """
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.subplots()
    late = [line for line in driven if not math.isnan(line.delay)]
    t, score = np.array([line.delay for line in late]), [line.score for line in late]
    axes.fill_between(t, [s.low for s in score], [s.high for s in score], color=_TOLD, alpha=0.12, lw=0)
    axes.plot(t, [s.value for s in score], color=_TOLD, marker="o", label="told the true n, late")
    for line in late:
        axes.annotate(
            f"{line.failures}",
            (line.delay, line.score.value),
            xytext=(0, 7),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    for line in driven:
        if math.isnan(line.delay):
            colour, style = (_AWARE, "-") if line.name == "aware" else (_BLIND, "--")
            style = ":" if line.name == "conservative" else style
            failed = f"{line.failures} of {line.episodes} fail"
            axes.axhline(line.score.value, color=colour, ls=style, label=f"{line.name}, {failed}")
    bottom = axes.get_ylim()[0]
    for line in filters:
        if math.isfinite(line.delay):
            axes.plot(line.delay, bottom, "^", color=_AWARE, ms=9, clip_on=False)
            axes.annotate(
                f"filter {line.name}",
                (line.delay, bottom),
                xytext=(7, 4),
                textcoords="offset points",
                color=_AWARE,
                fontsize=8,
            )
    axes.set_ylim(bottom=bottom)
    axes.set(xlabel="delay of n [s]", ylabel="mean time to the goal, a failure costs 120 s [s]")
    axes.set_title("patches; numbers: failures", loc="left", fontsize=10)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    return figure
