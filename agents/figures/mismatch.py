"""Error, coverage and validity flag of every filter under every mismatch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.mismatch import MISMATCHES
from estimators.mismatch_runs import FILTERS, MismatchSummary

__all__ = ["mismatch_figure"]

_COLOURS = {"robust": "#009E73", "bank": "#0072B2", "embedded": "#E69F00", "propagated": "#D55E00"}
_BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.4}
_FLOOR = 0.1  # smallest error that is drawn [%]


def mismatch_figure(
    summaries: Sequence[MismatchSummary], alone: Sequence[MismatchSummary], bars: Mapping[str, float]
) -> Figure:
    """Three panels over the mismatches: a group of bars each, one bar a filter; dashed: what is asked for.

    Parameters
    ----------
    summaries, alone
        In doubt of the model, drawn as bars, and by each filter's own word, drawn as ticks.
    bars
        What the robust bank is asked for.
    """
    figure = Figure(figsize=(12.0, 8.4), layout="constrained")
    names = [name for name in MISMATCHES if any(line.mismatch == name for line in summaries)]
    filters = [name for name in FILTERS if any(line.filter == name for line in summaries)]
    found = {(line.filter, line.mismatch): line for line in summaries}
    own = {(line.filter, line.mismatch): line for line in alone if FILTERS[line.filter].exact}
    panels = figure.subplots(3, 1, sharex=True)
    fields = ("error", "coverage", "flag")
    first = next((name for name in filters if FILTERS[name].exact), None)
    for axes, field in zip(panels, fields, strict=True):
        for i, name in enumerate(filters):
            values = [100.0 * getattr(found[name, mismatch], field) for mismatch in names]
            place = np.arange(len(names)) + 0.8 * ((i + 0.5) / len(filters) - 0.5)
            _bars(axes, place, values, name, 0.8 / len(filters), error=field == "error")
            if FILTERS[name].exact:
                words = [100.0 * getattr(own[name, mismatch], field) for mismatch in names]
                label = "by its own word" if axes is panels[0] and name == first else None
                axes.plot(place, words, "_", ms=10, mew=1.8, color="0.25", zorder=6, label=label)
        axes.grid(axis="y", alpha=0.25)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _limits(panels, names, bars)
    panels[0].set(yscale="log", ylim=(0.1, 200.0), ylabel="median error of n [%]")
    panels[0].yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_title("While the estimate is trusted, in doubt of the model", loc="left", fontsize=11)
    panels[1].set(ylim=(0.0, 109.0), ylabel="95 % interval holds the truth [%]")
    panels[2].set(ylim=(0.0, 109.0), ylabel="flag up, of excited time [%]")
    labels = [fill(MISMATCHES[name].title, 14) for name in names]
    panels[2].set_xticks(np.arange(len(names)), labels, fontsize=9)
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        frameon=False,
        fontsize=9,
        ncols=len(filters) + 2,
        loc="outside upper right",
    )
    return figure


def _bars(
    axes: Axes, place: np.ndarray, values: Sequence[float], name: str, width: float, *, error: bool
) -> None:
    drawn = np.nan_to_num(np.array(values), nan=0.0)
    axes.bar(
        place,
        np.maximum(drawn, _FLOOR) if error else drawn,
        0.92 * width,
        bottom=0.0,
        color=_COLOURS[name],
        label=FILTERS[name].title,
    )
    for x, value, top in zip(place, values, drawn, strict=True):
        text = "-" if not np.isfinite(value) else f"{value:.1f}" if error and value < 9.95 else f"{value:.0f}"
        height = max(top, _FLOOR) * 1.05 if error else top + 1.0
        axes.annotate(text, (x, height), ha="center", va="bottom", fontsize=7, zorder=5, bbox=_BEHIND)


def _limits(panels: Sequence[Axes], names: Sequence[str], bars: Mapping[str, float]) -> None:
    """What the robust bank is asked to keep, as dashed lines over the groups that it is asked for."""
    for i, name in enumerate(names):
        reach = (i - 0.45, i + 0.45)
        together = name == "all"
        wanted = [bars["error_all"] if together else bars["error"], bars["coverage"]]
        wanted.append(bars["flag_twin"] if name == "none" else bars["flag"])
        for axes, value in zip(panels, wanted, strict=True):
            if not (together and axes is panels[2]):
                label = "asked for" if i == 0 else None
                axes.plot(reach, [100.0 * value] * 2, color="0.2", lw=1.1, ls="--", label=label)
