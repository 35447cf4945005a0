"""Errors of prediction over time of adaptation, and over soils of training."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.studies.adaptation.results import FITTED, ONLINE, MethodLine
from estimators.experiments.motion_sequences import AT

__all__ = ["adaptation_figure"]

_COLOURS = {
    "nominal": "0.45",
    "filter for n": "#E69F00",
    ONLINE: "#0072B2",
    FITTED: "#D55E00",
    "oracle of the soil alone": "#56B4E9",
    "oracle": "0.1",
}
_LEARNED_COLOURS = ("#009E73", "#CC79A7")
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0)


def adaptation_figure(lines: Sequence[MethodLine], soils: Sequence[int], learned: Sequence[str]) -> Figure:
    """Left and middle: position and speed over time of adaptation; right: position over soils of training.

    Parameters
    ----------
    lines
        Of every method and time.
    soils
        Numbers of soils that the learned methods were trained on.
    learned
        Their names, without the number.
    """
    figure = Figure(figsize=(13.0, 4.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    shown = 100 if 100 in soils else soils[0]
    names = {**_COLOURS}
    for name, colour in zip(learned, _LEARNED_COLOURS, strict=False):
        names[f"{name}, {shown} soils"] = colour
    for axes, quantity, unit in ((left, "position", "m"), (middle, "speed", "m/s")):
        _draw_times(axes, lines, names, quantity)
        axes.set(
            xlabel="time of driving on the soil [s]", ylabel=f"mean error of {quantity} 3 s ahead [{unit}]"
        )
    left.set_title("position")
    middle.set_title("speed")
    _draw_soils(right, lines, soils, learned)
    for axes in (left, middle, right):
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_yticks([tick for tick in _TICKS if low <= tick <= high], minor=False)
        axes.set_yticks([], minor=True)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_times(axes: Axes, lines: Sequence[MethodLine], names: dict[str, str], quantity: str) -> None:
    for i, (name, colour) in enumerate(names.items()):
        own = [line for line in lines if line.method == name]
        values = [[getattr(line, f"{quantity}{part}") for line in own] for part in ("", "_low", "_high")]
        mean, low, high = values
        around = [
            [m - a for m, a in zip(mean, low, strict=True)],
            [b - m for m, b in zip(mean, high, strict=True)],
        ]
        times = [line.at + 0.06 * (i - 3) for line in own]
        style = "--" if name.startswith("oracle") else "-"
        axes.errorbar(
            times, mean, yerr=around, fmt=f"o{style}", ms=4, lw=1.6, capsize=2, color=colour, label=name
        )
    axes.set_xticks(AT)


def _draw_soils(
    axes: Axes, lines: Sequence[MethodLine], soils: Sequence[int], learned: Sequence[str]
) -> None:
    at_five = {line.method: line for line in lines if line.at == AT[1]}
    for name in ("nominal", "filter for n", ONLINE, FITTED, "oracle"):
        axes.axhline(
            at_five[name].position, color=_COLOURS[name], lw=1.4, ls="--" if name == "oracle" else "-"
        )
    for name, colour in zip(learned, _LEARNED_COLOURS, strict=False):
        own = [at_five[f"{name}, {count} soils"] for count in soils]
        mean = [line.position for line in own]
        around = [
            [line.position - line.position_low for line in own],
            [line.position_high - line.position for line in own],
        ]
        axes.errorbar(list(soils), mean, yerr=around, fmt="o-", ms=5, lw=1.6, capsize=2, color=colour)
    axes.set_xscale("log")
    axes.set_xticks(list(soils), minor=False)
    axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(
        xlabel="soils that the learned models were trained on [-]",
        ylabel="mean error of position 3 s ahead [m]",
    )
    axes.set_title("position after 5 s, by training data")
