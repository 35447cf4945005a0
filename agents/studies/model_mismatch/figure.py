"""Error, coverage and validity flag of every filter under every mismatch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.experiments.mismatch_comparison import COMPARED, MismatchSummary
from estimators.experiments.model_mismatch import MISMATCHES
from estimators.filters.registry import FILTERS

__all__ = ["mismatch_figure"]

_COLOURS = {
    "augmented_ekf_bank": "#009E73",
    "map_ukf_bank": "#0072B2",
    "online_parameter_ukf": "#E69F00",
    "parameter_ukf": "#D55E00",
}
_FLOOR = 0.1  # smallest error that is drawn [%]


def mismatch_figure(
    summaries: Sequence[MismatchSummary], stated: Sequence[MismatchSummary], bars: Mapping[str, float]
) -> Figure:
    """Three panels over the mismatches: a group of bars each, one bar a filter; dashed: requirements.

    Parameters
    ----------
    summaries, stated
        Robust to model errors, drawn as bars, and as stated by each filter, drawn as ticks.
    bars
        Requirements on the augmented bank.
    """
    figure = Figure(figsize=(12.0, 8.4), layout="constrained")
    names = [name for name in MISMATCHES if any(line.mismatch == name for line in summaries)]
    filters = [name for name in COMPARED if any(line.filter == name for line in summaries)]
    found = {(line.filter, line.mismatch): line for line in summaries}
    own = {(line.filter, line.mismatch): line for line in stated if FILTERS[line.filter].exact_model}
    panels = figure.subplots(3, 1, sharex=True)
    fields = ("error", "coverage", "flag")
    first = next((name for name in filters if FILTERS[name].exact_model), None)
    for axes, field in zip(panels, fields, strict=True):
        for i, name in enumerate(filters):
            values = [100.0 * getattr(found[name, mismatch], field) for mismatch in names]
            place = np.arange(len(names)) + 0.8 * ((i + 0.5) / len(filters) - 0.5)
            _bars(axes, place, values, name, 0.8 / len(filters), error=field == "error")
            if FILTERS[name].exact_model:
                stated_values = [100.0 * getattr(own[name, mismatch], field) for mismatch in names]
                label = "as stated by the filter" if axes is panels[0] and name == first else None
                axes.plot(place, stated_values, "_", ms=10, mew=1.8, color="0.25", zorder=6, label=label)
        axes.grid(axis="y", alpha=0.25)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    _limits(panels, names, bars)
    panels[0].set(yscale="log", ylim=(0.05, 200.0), ylabel="median error of n [%]")
    panels[0].yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    panels[0].set_title("While the robust flag is up", loc="left", fontsize=11)
    panels[1].set(ylim=(0.0, 109.0), ylabel="95 % interval holds the truth [%]")
    panels[2].set(ylim=(0.0, 109.0), ylabel="flag up, of excited time [%]")
    labels = [fill(MISMATCHES[name].title, 14) for name in names]
    panels[2].set_xticks(np.arange(len(names)), labels, fontsize=9)
    panels[2].set_xlabel("what differs between model and vehicle [-]")
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        frameon=False,
        fontsize=9,
        ncols=3,
        loc="outside upper right",
    )
    return figure


def _bars(
    axes: Axes, place: np.ndarray, values: Sequence[float], name: str, width: float, *, error: bool
) -> None:
    drawn = np.nan_to_num(np.array(values), nan=0.0)
    axes.bar(
        place,
        np.where(drawn > 0.0, np.maximum(drawn, _FLOOR), 0.0) if error else drawn,
        0.92 * width,
        bottom=0.0,
        color=_COLOURS[name],
        label=FILTERS[name].title,
    )
    for x in place[~np.isfinite(np.array(values))]:  # the flag is never up
        axes.annotate("none", (x, 0.06 if error else 2.0), ha="center", va="bottom", fontsize=7, rotation=90)


def _limits(panels: Sequence[Axes], names: Sequence[str], bars: Mapping[str, float]) -> None:
    """Requirements on the augmented bank as dashed lines over the groups that they apply to."""
    for i, name in enumerate(names):
        reach = (i - 0.45, i + 0.45)
        together = name == "all"
        wanted = [bars["error_all"] if together else bars["error"], bars["coverage"]]
        wanted.append(bars["flag_matched"] if name == "none" else bars["flag"])
        for axes, value in zip(panels, wanted, strict=True):
            if not (together and axes is panels[2]):
                label = "required" if i == 0 else None
                axes.plot(reach, [100.0 * value] * 2, color="0.2", lw=1.1, ls="--", label=label)
