"""Standard deviation of n over time while the motion holds no information on the soil."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["gate_figure"]

_COLOURS = ("#0072B2", "#009E73", "#D55E00")
_STEP = 0.1


def gate_figure(
    results: Mapping[tuple[Any, ...], Mapping[str, Any]],
    map_phases: Sequence[tuple[str, float]],
    online_phases: Sequence[tuple[str, float]],
) -> Figure:
    """Median over the seeds: against the bound in the paper's model, and online filters in the full model.

    Parameters
    ----------
    results
        By (part, seed, drift), of `agents.studies.information_gate.study.run_unit`.
    map_phases, online_phases
        Name and end [s] of every phase.
    """
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    drifts = sorted({key[2] for key in results if key[0] == "map"})
    panels = figure.subplots(1, len(drifts) + 1)
    for axes, drift in zip(panels, drifts, strict=False):
        units = [result for key, result in results.items() if key[0] == "map" and key[2] == drift]
        _draw(axes, units, map_phases)
        axes.set_title(f"Paper's model, soil {_kind(drift)}", loc="left", fontsize=10)
    units = [result for key, result in results.items() if key[0] == "online"]
    _draw(panels[-1], units, online_phases)
    panels[-1].set_title("Full model, online filters", loc="left", fontsize=10)
    return figure


def _kind(drift: float) -> str:
    return f"drifts by {drift:g} of η per √s" if drift > 0.0 else "does not drift"


def _median(units: Sequence[Mapping[str, Any]], name: str) -> np.ndarray:
    return np.asarray(np.median([unit["runs"][name]["sd"] for unit in units], axis=0))


def _draw(axes: Axes, units: Sequence[Mapping[str, Any]], phases: Sequence[tuple[str, float]]) -> None:
    for index, (name, colour) in enumerate(zip(units[0]["runs"], _COLOURS, strict=False)):
        sd = _median(units, name)
        # Where two filters agree the second is dashed over the first.
        style = "-" if index == 0 else (0, (4, 2 + 2 * index))
        axes.plot(_STEP * np.arange(len(sd)), sd, color=colour, lw=1.8, ls=style, label=name)
    if "bound" in units[0]:
        bound = np.median([unit["bound"] for unit in units], axis=0)
        axes.plot(_STEP * np.arange(len(bound)), bound, color="0.1", lw=1.2, ls=":", label="Cramér-Rao bound")
    begin = 0.0
    for name, end in phases:
        if "steering" not in name:
            axes.axvspan(begin, end, color="0.93" if name == "straight" else "0.85", zorder=0, lw=0)
            place = (0.5 * (begin + end), 0.97)
            axes.annotate(name, place, xycoords=("data", "axes fraction"), ha="center", va="top", fontsize=9)
        begin = end
    axes.set(yscale="log", xlabel="time [s]", ylabel="standard deviation of n [-]")
    axes.margins(x=0.0)
    axes.grid(alpha=0.25, which="both")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(
        frameon=False, fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.13), columnspacing=1.0
    )
