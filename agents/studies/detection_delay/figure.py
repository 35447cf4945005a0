"""Time on changing soil over the delay of n."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.studies.detection_delay.results import DrivenLine, FilterLine

__all__ = ["delay_figure"]

_AWARE, _BLIND = "#0072B2", "#E69F00"
#: Colours of the drives with a delayed n, and height of the failures above the points [points].
_DELAYED = {"0.25": -14.0, "#D55E00": 7.0}


def delay_figure(driven: Sequence[DrivenLine], filters: Sequence[FilterLine]) -> Figure:
    """Mean time with a delayed n (line, with failures), of the arms (bands), and the filters' delays.

    Parameters
    ----------
    driven
        Delays, then the arms of the benchmark (their delay is NaN).
    filters
        Their median delays are marked below.
    """
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.subplots()
    delayed = [line for line in driven if not math.isnan(line.delay)]
    for name, (colour, above) in zip(
        dict.fromkeys(line.name for line in delayed), _DELAYED.items(), strict=False
    ):
        _draw_late(axes, [line for line in delayed if line.name == name], colour, above)
    for line in driven:
        if math.isnan(line.delay):
            colour, style = (_AWARE, "-") if line.name == "aware" else (_BLIND, "--")
            style = ":" if line.name == "conservative" else style
            failed = f"{line.failures} of {line.episodes} fail"
            axes.axhline(line.score.value, color=colour, ls=style, label=f"{line.name}, {failed}")
    bottom = axes.get_ylim()[0] - 3.0  # room for the filters' names
    for found in filters:
        if math.isfinite(found.delay):
            axes.plot(found.delay, bottom, "^", color=_AWARE, ms=9, clip_on=False)
            axes.annotate(
                f"filter {found.name}",
                (found.delay, bottom),
                xytext=(0, 9),
                textcoords="offset points",
                ha="center",
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


def _draw_late(axes: Axes, lines: Sequence[DrivenLine], colour: str, above: float) -> None:
    """Mean time over the delay with its band, and the number of failures at each."""
    t, score = np.array([line.delay for line in lines]), [line.score for line in lines]
    axes.fill_between(t, [s.low for s in score], [s.high for s in score], color=colour, alpha=0.12, lw=0)
    axes.plot(t, [s.value for s in score], color=colour, marker="o", label=f"true n, {lines[0].name}")
    for line in lines:
        axes.annotate(
            f"{line.failures}",
            (line.delay, line.score.value),
            xytext=(0.0, above),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=colour,
        )
