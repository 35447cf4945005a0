"""An exponent that changes on the way, and what the filters make of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

__all__ = ["changing_figure"]

_COLOURS = ("#009E73", "#D55E00", "#0072B2")
#: The second and third filter often agree: both show.
_STYLES = ("-", "-", (0, (4, 3)))
_TRUTH = "true n"


def changing_figure(results: Mapping[tuple[str, str], Mapping[str, Any]], *, step: float) -> Figure:
    """One panel a model and scenario: truth, means and bands of two standard deviations.

    Parameters
    ----------
    results
        By (model, scenario), one seed each, of `agents.studies.changing_soil.study.run_unit`.
    step
        Time between the kept samples [s].
    """
    models = list(dict.fromkeys(model for model, _ in results))
    scenarios = list(dict.fromkeys(scenario for _, scenario in results))
    figure = Figure(figsize=(13.0, 3.6 * len(models)), layout="constrained")
    panels = figure.subplots(len(models), len(scenarios), sharex=True, squeeze=False)
    for (model, scenario), unit in results.items():
        axes = panels[models.index(model), scenarios.index(scenario)]
        t = step * np.arange(len(unit["truth"]))
        for (name, run), colour, style in zip(unit["runs"].items(), _COLOURS, _STYLES, strict=False):
            n, sd = np.array(run["n"]), np.array(run["sd"])
            axes.fill_between(t, n - 2.0 * sd, n + 2.0 * sd, color=colour, alpha=0.15, lw=0)
            axes.plot(t, n, color=colour, lw=1.3, ls=style, label=name)
        axes.plot(t, unit["truth"], color="0.1", lw=1.2, ls="--", label=_TRUTH)
        low, high = min(unit["truth"]), max(unit["truth"])
        margin = 0.6 * (high - low)
        axes.set_ylim(low - margin, high + margin)
        axes.set_title(f"{model.capitalize()} model, {scenario}", loc="left", fontsize=10)
        axes.margins(x=0.0)
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    for axes in panels.flat:
        axes.set(xlabel="time [s]", ylabel="sinkage exponent n [-]")
    handles: dict[str, Artist] = {}
    for row in panels:
        artists, labels = row[0].get_legend_handles_labels()
        handles |= dict(zip(labels, artists, strict=True))
    shown = [name for name in handles if name != _TRUTH] + [_TRUTH]
    figure.legend(
        [handles[name] for name in shown], shown, loc="outside lower center", ncols=4, frameon=False
    )
    return figure
