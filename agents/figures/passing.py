"""Learners that start behind pure pursuit: their score over what they have driven."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.guide import GUIDES

if TYPE_CHECKING:
    from agents.studies.passing import Curve

__all__ = ["passing_figure"]

_COLOURS = {"ppo_tracker_aware": "#0072B2", "ppo_tracker_oblivious": "#D55E00", "ppo_pedals_aware": "#009E73"}


def passing_figure(curves: Sequence[Curve], rival: float) -> Figure:
    """Learning curves, a panel for each guide.

    Parameters
    ----------
    curves
        One of each training.
    rival
        Pure pursuit's score on the same episodes [s].

    Returns
    -------
    Figure
        Score of the tuning episodes, driven without noise, over environment steps: one line a training seed,
        and a ring where it falls below pure pursuit for good.
    """
    guides = list(dict.fromkeys(curve.guide for curve in curves))
    figure = Figure(figsize=(8.0 if len(guides) == 1 else 11.0, 3.9), layout="constrained")
    panels = figure.subplots(1, len(guides), squeeze=False, sharey=True)[0]
    for axes, guide in zip(panels, guides, strict=True):
        here = [curve for curve in curves if curve.guide == guide]
        for curve in here:
            _draw(axes, curve)
        axes.axhline(rival, color="0.2", lw=1.2, ls="--", label="pure pursuit")
        axes.set_ylim(40.0, 123.0)
        axes.set_title(f"{guide}: mean time on the tuning episodes [s]", loc="left", fontsize=10)
        axes.set_xlabel("thousands of environment steps")
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        handles, names = axes.get_legend_handles_labels()
        shown = dict(zip(names, handles, strict=True))
        axes.legend(shown.values(), shown.keys(), frameon=False, fontsize=9, loc="upper right")
    return figure


def _draw(axes: Axes, curve: Curve) -> None:
    colour, driven = _COLOURS[curve.arm], np.array(curve.steps) * GUIDES[curve.guide].hold / 1000.0
    axes.plot(driven, curve.scores, color=colour, lw=1.2, alpha=0.75, label=curve.arm)
    if curve.ahead is not None:
        axes.plot(driven[curve.ahead], curve.scores[curve.ahead], "o", color=colour, mfc="white", ms=7)
