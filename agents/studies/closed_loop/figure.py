"""Times of the three plans by hidden cause."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from agents.studies.closed_loop.results import CauseLine

__all__ = ["closed_loop_figure"]

#: Plan -> (name in the figure, colour, marker).
_PLANS = {
    "nominal": ("nominal model", "#D55E00", "o"),
    "extended": ("model extended by the diagnosis", "#0072B2", "s"),
    "true": ("true model", "#009E73", "^"),
}


def closed_loop_figure(lines: Sequence[CauseLine]) -> Figure:
    """Mean time to the goal with its interval, a row for every cause, the largest loss on top."""
    ordered = sorted(lines, key=lambda line: line.loss.value)
    figure = Figure(figsize=(8.0, 1.4 + 0.6 * len(ordered)), layout="constrained")
    axes = figure.subplots()
    place = np.arange(len(ordered), dtype=float)
    for k, (plan, (name, colour, marker)) in enumerate(_PLANS.items()):
        found = [getattr(line, plan) for line in ordered]
        value = np.array([one.value for one in found])
        reach = np.array([[one.value - one.low for one in found], [one.high - one.value for one in found]])
        axes.errorbar(
            value,
            place + 0.22 * (1 - k),
            xerr=np.maximum(reach, 0.0),
            fmt=marker,
            color=colour,
            ms=6,
            capsize=2,
            lw=1.2,
            label=f"plan for the {name}",
        )
    axes.set_yticks(place, [f"{line.cause}\nnamed in {line.named} of {line.units}" for line in ordered])
    axes.set_ylabel("hidden cause")
    axes.set_xlabel("mean time to the goal, a failure costs the time limit [s]")
    axes.grid(axis="x", alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    return figure
