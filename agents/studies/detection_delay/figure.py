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
#: Drives with a delayed n: colour, and whether their bars stand left or right of the delay.
_DELAYED = (("0.25", -0.5), ("#D55E00", 0.5))
_BAR = 0.02  #: width of a bar of failures [s]


def delay_figure(driven: Sequence[DrivenLine], filters: Sequence[FilterLine]) -> Figure:
    """Mean time and failures with a delayed n, of the arms (lines across), and the filters' delays.

    Parameters
    ----------
    driven
        Delays, then the arms of the benchmark (their delay is NaN).
    filters
        Their median delays are marked below.
    """
    figure = Figure(figsize=(8.0, 6.2), layout="constrained")
    times, failures = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    delayed = [line for line in driven if not math.isnan(line.delay)]
    names = dict.fromkeys(line.name for line in delayed)
    for name, (colour, side) in zip(names, _DELAYED, strict=False):
        here = [line for line in delayed if line.name == name]
        _draw_times(times, here, colour)
        delays = [line.delay + side * _BAR for line in here]
        failures.bar(delays, [line.failures for line in here], width=_BAR, color=colour)
    for line in driven:
        if math.isnan(line.delay):
            colour, style = (_AWARE, "-") if line.name == "aware" else (_BLIND, "--")
            style = ":" if line.name == "conservative" else style
            failed = f"{line.failures} of {line.episodes} fail"
            times.axhline(line.score.value, color=colour, ls=style, label=f"{line.name}, {failed}")
    _draw_filters(times, filters)
    times.set(ylabel="mean time to the goal,\na failure costs 120 s [s]")
    episodes = max((line.episodes for line in delayed), default=0)
    failures.set(xlabel="delay of n [s]", ylabel=f"failures\n[of {episodes}]", ylim=(0.0, None))
    failures.yaxis.get_major_locator().set_params(integer=True)
    times.set_title("patches", loc="left", fontsize=10)
    for axes in (times, failures):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    times.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def _draw_times(axes: Axes, lines: Sequence[DrivenLine], colour: str) -> None:
    """Mean time over the delay with its band."""
    t, score = np.array([line.delay for line in lines]), [line.score for line in lines]
    axes.fill_between(t, [s.low for s in score], [s.high for s in score], color=colour, alpha=0.12, lw=0)
    axes.plot(t, [s.value for s in score], color=colour, marker="o", label=f"true n, {lines[0].name}")


def _draw_filters(axes: Axes, filters: Sequence[FilterLine]) -> None:
    """A mark at the median delay of each filter, on the lower edge of the panel."""
    bottom = axes.get_ylim()[0] - 3.0  # room for the names
    for found in filters:
        if math.isfinite(found.delay):
            axes.plot(found.delay, bottom, "^", color=_AWARE, ms=9, clip_on=False, zorder=3)
            axes.annotate(
                f"filter of a {found.name}",
                (found.delay, bottom),
                xytext=(0, 9),
                textcoords="offset points",
                ha="center",
                color=_AWARE,
                fontsize=8,
            )
    axes.set_ylim(bottom=bottom)
