"""What the online belief says of the limits: coverage, and width over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

__all__ = ["soil_belief_figure"]

_TITLES = {
    "lateral": "lateral acceleration",
    "pull": "pull",
    "resistance": "rolling resistance",
    "sinkage": "sinkage",
    "stopping": "stopping distance",
    "n": "n",
}
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9")


class _Line(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def runs(self) -> int: ...

    @property
    def coverage(self) -> float: ...


def soil_belief_figure(
    limits: Sequence[_Line], widths: np.ndarray, times: Sequence[float], bars: Mapping[str, Any]
) -> Figure:
    """Coverage of the 95 % intervals at the last time, and their median half width over time.

    Parameters
    ----------
    limits
        One line a limit, last n.
    widths
        (times, limits) relative half widths.
    times
        When [s].
    bars
        "coverage": lowest and highest that is required.
    """
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    low, high = bars["coverage"]
    place = np.arange(len(limits))
    left.axvspan(100.0 * low, 100.0 * high, color="0.9", label="required")
    coverage = np.array([line.coverage for line in limits])
    error = 196.0 * np.sqrt(coverage * (1.0 - coverage) / limits[0].runs)
    left.errorbar(100.0 * coverage, place, xerr=error, fmt="o", color="#0072B2", capsize=3)
    left.set(
        yticks=place,
        yticklabels=[_TITLES[line.name] for line in limits],
        xlabel=f"95 % intervals that hold the truth, {times[-1]:g} s after the start [%]",
        xlim=(60.0, 101.0),
    )
    left.invert_yaxis()
    left.legend(frameon=False, loc="lower left")
    names = [line.name for line in limits if line.name != "n"]
    for i, (name, colour) in enumerate(zip(names, _COLOURS, strict=False)):
        right.plot(times, 100.0 * widths[:, i], color=colour, marker="o", label=_TITLES[name])
    right.set(
        xlabel="time since the start [s]",
        ylabel="median half width of the interval [% of the limit]",
        ylim=(0.0, None),
        xticks=list(times),
    )
    right.legend(frameon=False, fontsize=9)
    for axes in (left, right):
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure
