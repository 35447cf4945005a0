"""Learners that start behind pure pursuit: their score over the time they have learnt for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from agents.studies.passing import Curve

__all__ = ["passing_figure"]

_COLOURS = {"ppo_tracker_aware": "#0072B2", "ppo_tracker_oblivious": "#D55E00", "ppo_pedals_aware": "#009E73"}


def passing_figure(curves: Sequence[Curve], rival: float, limit: float) -> Figure:
    """Learning curves over wall time, a panel for each guide.

    Parameters
    ----------
    curves
        One of each training.
    rival
        Pure pursuit's score on the same episodes [s].
    limit
        Wall time in which it is to be passed [s].

    Returns
    -------
    Figure
        Thin: score of the tuning episodes, driven without noise, one line a training seed; a ring where it
        falls below pure pursuit for good. The shaded time is beyond the limit.
    """
    guides = list(dict.fromkeys(curve.guide for curve in curves))
    figure = Figure(figsize=(10.0, 3.9), layout="constrained")
    panels = figure.subplots(1, len(guides), squeeze=False, sharey=True)[0]
    for axes, guide in zip(panels, guides, strict=True):
        here = [curve for curve in curves if curve.guide == guide]
        for curve in here:
            _draw(axes, curve)
        axes.axhline(rival, color="0.2", lw=1.2, ls="--", label="pure pursuit")
        longest = max(curve.wall_times[-1] for curve in here)
        if longest > limit:
            axes.axvspan(limit, longest, color="0.9")
        axes.set_xlim(0.0, 1.02 * longest)
        axes.set_ylim(40.0, 123.0)
        axes.set_title(f"{guide}: mean time on the tuning episodes [s]", loc="left", fontsize=10)
        axes.set_xlabel("wall time of the training [s]")
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        handles, names = axes.get_legend_handles_labels()
        shown = dict(zip(names, handles, strict=True))
        axes.legend(shown.values(), shown.keys(), frameon=False, fontsize=9, loc="upper right")
    return figure


def _draw(axes: Axes, curve: Curve) -> None:
    colour = _COLOURS[curve.arm]
    axes.plot(curve.wall_times, curve.scores, color=colour, lw=1.2, alpha=0.75, label=curve.arm)
    if curve.ahead is not None:
        axes.plot(
            curve.wall_times[curve.ahead], curve.scores[curve.ahead], "o", color=colour, mfc="white", ms=7
        )
