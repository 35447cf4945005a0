"""Learners that start behind pure pursuit: their score over what they have driven."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.learning.action_interface import find_interface

if TYPE_CHECKING:
    from agents.studies.ppo_learning_curve.results import Curve

__all__ = ["learning_curve_figure"]

_COLOURS = {"ppo_tracker_aware": "#0072B2", "ppo_tracker_oblivious": "#D55E00", "ppo_direct_aware": "#009E73"}


def learning_curve_figure(curves: Sequence[Curve], reference: float) -> Figure:
    """Learning curves, a panel for each action interface.

    Parameters
    ----------
    curves
        One of each training.
    reference
        Pure pursuit's score on the same episodes [s].

    Returns
    -------
    Figure
        Score of the tuning episodes, driven without noise, over environment steps: one line a training seed,
        and a ring where it falls below pure pursuit for good.
    """
    interfaces = list(dict.fromkeys(curve.action_interface for curve in curves))
    figure = Figure(figsize=(8.0 if len(interfaces) == 1 else 11.0, 3.9), layout="constrained")
    panels = figure.subplots(1, len(interfaces), squeeze=False, sharey=True)[0]
    for axes, interface in zip(panels, interfaces, strict=True):
        here = [curve for curve in curves if curve.action_interface == interface]
        for curve in here:
            _draw(axes, curve)
        axes.axhline(reference, color="0.2", lw=1.2, ls="--", label="pure pursuit")
        axes.set_ylim(40.0, 123.0)
        axes.set_title(f"action interface {interface}", loc="left", fontsize=10)
        axes.set_ylabel("mean time on the tuning episodes [s]")
        axes.set_xlabel("environment steps [thousands]")
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        handles, names = axes.get_legend_handles_labels()
        shown = dict(zip(names, handles, strict=True))
        axes.legend(shown.values(), shown.keys(), frameon=False, fontsize=9, loc="upper right")
    return figure


def _draw(axes: Axes, curve: Curve) -> None:
    colour, driven = (
        _COLOURS[curve.arm],
        np.array(curve.steps) * find_interface(curve.action_interface).hold / 1000.0,
    )
    axes.plot(driven, curve.scores, color=colour, lw=1.2, alpha=0.75, label=curve.arm)
    if curve.ahead is not None:
        axes.plot(driven[curve.ahead], curve.scores[curve.ahead], "o", color=colour, mfc="white", ms=7)
