"""What knowing n is worth, task by task."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agents.benchmark.summary import Benchmark
from agents.studies.value_of_n.results import Cell

__all__ = ["headroom_figure", "value_figure"]

_PAYS, _NIL, _AWARE = "#009E73", "0.55", "#0072B2"
_SOILS = (_PAYS, _AWARE, "#D55E00", "#CC79A7", "0.3")


def headroom_figure(results: Sequence[Benchmark]) -> Figure:
    """Headroom of each comparison with its interval, and the share that the estimate recovers.

    Parameters
    ----------
    results
        With arms oracle, nominal and conservative.

    Returns
    -------
    Figure
        Left: headroom in per cent of the better uninformed arm's mean score, grey where the interval holds
        zero. Right: share of it that aware recovers, only where there is one.
    """
    figure = Figure(figsize=(11.0, 0.42 * len(results) + 2.1), layout="constrained")
    room, share = figure.subplots(1, 2, sharey=True, width_ratios=(3.0, 2.0))
    for row, result in enumerate(results):
        _draw_room(room, row, result)
        if result.recovered is not None:
            part = result.recovered
            share.plot([100.0 * part.low, 100.0 * part.high], [row, row], color=_AWARE, lw=2.5)
            share.plot(100.0 * part.value, row, "o", color=_AWARE, ms=8, mec="white")
        else:
            share.annotate("no headroom shown", (0.02, row), xycoords=("axes fraction", "data"), va="center")
    room.set_yticks(range(len(results)), [f"{r.scenario}, {r.form}" for r in results])
    room.set_ylim(len(results) - 0.5, -0.5)
    room.set_title("What perfect knowledge of n is worth", loc="left", fontsize=10)
    room.set_xlabel("headroom [% of the score]")
    room.set_ylabel("task, form [-]")
    share.set_title("Share of it that the estimate recovers", loc="left", fontsize=10)
    share.set_xlabel("share of the headroom [%]")
    for axes, mark in ((room, 0.0), (share, 100.0)):
        axes.axvline(mark, color="0.4", lw=0.8)
        axes.grid(axis="x", alpha=0.25)
        axes.tick_params(axis="y", length=0)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
    share.axvline(80.0, color="0.4", lw=0.8, ls=":")
    if share.lines:
        low, high = share.get_xlim()
        share.set_xlim(max(min(low, -5.0), -150.0), min(max(high, 110.0), 200.0))
    return figure


def _draw_room(axes: Axes, row: int, result: Benchmark) -> None:
    room = result.headroom
    assert room is not None  # only results with an oracle and uninformed arms are drawn
    base = float(result.arm(result.better_uninformed).scores.mean())
    values = 100.0 / base * np.array([room.low, room.value, room.high])
    colour = _PAYS if values[0] > 0.0 else _NIL
    axes.plot(values[[0, 2]], [row, row], color=colour, lw=2.5)
    axes.plot(values[1], row, "o", color=colour, ms=8, mec="white")
    text = f"{room.value:.2g} {result.unit} against {result.better_uninformed}"
    axes.annotate(
        text,
        (values[2], row),
        xytext=(6, 0),
        textcoords="offset points",
        va="center",
        fontsize=8,
        color="0.3",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
    axes.margins(x=0.3)


def value_figure(cells: Sequence[Cell]) -> Figure:
    """Headroom of each task over the width of the prior, one line a soil.

    Parameters
    ----------
    cells
        From `agents.studies.value_of_n.study`.

    Returns
    -------
    Figure
        One panel a task; in per cent of the better uninformed arm's mean score, with 95 % intervals.
        Hollow markers: the interval holds zero, the episodes do not show that knowing n pays.
    """
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    soils = list(dict.fromkeys(cell.soil for cell in cells))
    columns = 2 if len(tasks) in (2, 4) else 3  # four panels: two rows of two
    rows = max(-(-len(tasks) // columns), 1)
    figure = Figure(figsize=(4.0 * columns + 0.4, 3.3 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, min(len(tasks), columns) or 1, squeeze=False).ravel()
    for axes, task in zip(panels, tasks, strict=False):
        _draw_task(axes, [cell for cell in cells if cell.task == task], soils)
        axes.set_title(task, loc="left", fontsize=10.5)
    for axes in panels[len(tasks) :]:
        axes.set_axis_off()
    handles = [Line2D([], [], color=_SOILS[i % len(_SOILS)], label=soil) for i, soil in enumerate(soils)]
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=len(soils), frameon=False)
    figure.suptitle(
        "What knowing n is worth; filled circles: the 95 % interval lies above 0",
        x=0.01,
        ha="left",
    )
    return figure


def _draw_task(axes: Axes, cells: Sequence[Cell], soils: Sequence[str]) -> None:
    for i, soil in enumerate(soils):
        own = [cell for cell in cells if cell.soil == soil]
        if not own:
            continue
        width = np.array([cell.width for cell in own]) * (1.0 + 0.03 * (i - 1))
        colour = _SOILS[i % len(_SOILS)]
        values = 100.0 * np.array([[c.room.low, c.room.value, c.room.high] for c in own]).T
        values /= np.array([cell.base for cell in own])
        axes.plot(width, values[1], color=colour, lw=1.2)
        axes.vlines(width, values[0], values[2], color=colour, lw=1.8)
        for x, low, value in zip(width, values[0], values[1], strict=True):
            axes.plot(x, value, "o", color=colour, mfc=colour if low > 0.0 else "white", ms=7)
    axes.axhline(0.0, color="0.4", lw=0.8)
    axes.set_xlabel("width of the prior of n [-]")
    axes.set_ylabel("headroom [% of the score]")
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
