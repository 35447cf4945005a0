"""Speed: ratios with their ranges and promises, and the cost of a vector step over its size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from agents.studies.speed.study import Ratio, Speed

__all__ = ["speed_figure"]

_OURS, _PROMISE, _FILTER = "#0072B2", "#D55E00", "#E69F00"


def speed_figure(speed: Speed) -> Figure:
    """Two panels: every ratio on a log axis, and microseconds of a vector step against N."""
    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1))
    _ratios(left, [ratio for ratio in speed.ratios if ratio.kind == "rate"])
    _growth(right, speed)
    return figure


def _ratios(axes: Axes, ratios: Sequence[Ratio]) -> None:
    place = -np.arange(len(ratios))
    value = np.array([ratio.value for ratio in ratios])
    spread = np.abs(np.array([[ratio.low, ratio.high] for ratio in ratios]).reshape(-1, 2).T - value)
    axes.errorbar(value, place, xerr=spread, fmt="o", color=_OURS, capsize=3, label="measured, with range")
    promised = [(y, ratio.bar) for y, ratio in zip(place, ratios, strict=True) if ratio.bar is not None]
    if promised:
        y, bar = zip(*promised, strict=True)
        axes.plot(bar, y, "|", color=_PROMISE, markersize=16, markeredgewidth=2, label="promised at least")
    axes.axvline(1.0, color="0.6", linewidth=0.8)
    labels = [f"{r.ours} /\n{r.peer}{' (elapsed time)' if r.clock else ''}" for r in ratios]
    axes.set_yticks(place, labels)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set_xlabel("ratio of steps per second, ours / peer [-]")
    axes.set_title("Rate of steps against others, in the same run", loc="left", fontsize=10.5)
    # Below the axis: ratios and promises lie anywhere on the panel.
    axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    axes.grid(axis="x", alpha=0.3)


def _growth(axes: Axes, speed: Speed) -> None:
    for (kind, rows), color in zip(speed.vector_us.items(), (_OURS, _FILTER), strict=False):
        sizes = np.array(sorted(rows))
        cpu, clock = (np.array([rows[n][column] for n in sizes]) for column in (0, 1))
        name = "with the UKF" if "UKF" in kind else "no filter"
        axes.plot(sizes, cpu, "o-", color=color, label=f"CPU time, {name}")
        axes.plot(sizes, clock, "o--", color=color, mfc="white", label=f"elapsed time, {name}")
        axes.plot(sizes, cpu[-1] * sizes / sizes[-1], ":", color="0.5", linewidth=1.0)
    axes.plot([], [], ":", color="0.5", label="proportional to N")
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({n for rows in speed.vector_us.values() for n in rows})
    axes.set_xticks(ticks, [str(n) for n in ticks])
    axes.set_xlabel("environments in the vector, N [-]")
    axes.set_ylabel("time of one vector step [µs]")
    axes.set_title(f"Vector environment, {speed.processors} processors", loc="left", fontsize=10.5)
    axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    axes.grid(alpha=0.3)
