"""Trained policies: how they learn, and what they score in the end."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.benchmark.learned import LearnedArm
from agents.learning.action_interface import PlanInterface
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import MEASURES

__all__ = ["learning_figure"]

#: Thousands of environment steps that a step of the policy lasts.
_THOUSANDS = PlanInterface.hold / 1000.0
_COLOURS = {
    "ppo_aware": "#0072B2",
    "ppo_oblivious": "#D55E00",
    "ppo_memory": "#CC79A7",
    "zero_aware": "#56B4E9",
    "zero_oblivious": "#E69F00",
    "pure_pursuit": "0.35",
}


def learning_figure(arms: Sequence[LearnedArm], curves: Sequence[Mapping[str, Any]]) -> Figure:
    """Learning curves and test scores, a row for each task.

    Parameters
    ----------
    arms
        Summaries on test episodes.
    curves
        ``task, arm, seed, points`` with points (steps of the policy, wall time [s], score of the tuning
        episodes).

    Returns
    -------
    Figure
        Left: score of the tuning episodes, driven without noise, over environment steps: thin every
        seed, thick their mean. Right: test score of every seed and mean with its 95 % interval.
    """
    tasks = list(dict.fromkeys(arm.task for arm in arms))
    figure = Figure(figsize=(10.0, 3.2 * len(tasks) + 0.3), layout="constrained")
    for task, (left, right) in zip(tasks, figure.subplots(len(tasks), 2, squeeze=False), strict=True):
        measure, unit = MEASURES[find_scenario(task).measure]
        here = [arm for arm in arms if arm.task == task]
        _draw_curves(left, [curve for curve in curves if curve["task"] == task])
        _draw_plain(left, here)
        left.set_title(task, loc="left", fontsize=10)
        left.set_ylabel(f"score while learning [{unit}]")
        left.set_xlabel("environment steps of 0.02 s [thousands]")
        _draw_scores(right, here)
        right.set_title(f"{task}: test score of each training seed", loc="left", fontsize=10)
        right.set_xlabel(f"{measure} [{unit}]")
        for axes in (left, right):
            axes.grid(alpha=0.25)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=len(names), frameon=False)
    return figure


def _draw_curves(axes: Axes, curves: Sequence[Mapping[str, Any]]) -> None:
    for arm in dict.fromkeys(curve["arm"] for curve in curves):
        points = [np.array(curve["points"], dtype=np.float64) for curve in curves if curve["arm"] == arm]
        for one in points:
            axes.plot(_THOUSANDS * one[:, 0], one[:, 2], color=_COLOURS[arm], lw=0.7, alpha=0.4)
        count = min(len(one) for one in points)
        mean = np.mean([one[:count] for one in points], axis=0)
        axes.plot(_THOUSANDS * mean[:, 0], mean[:, 2], color=_COLOURS[arm], lw=2.2, label=arm)


def _draw_plain(axes: Axes, arms: Sequence[LearnedArm]) -> None:
    """The tracker that knows nothing, as a line."""
    for arm in arms:
        if arm.arm == "pure_pursuit":
            axes.axhline(arm.score.value, color=_COLOURS[arm.arm], lw=1.0, ls="--")
            axes.annotate(
                "pure pursuit", (0.01, arm.score.value), xycoords=("axes fraction", "data"), va="top"
            )


def _draw_scores(axes: Axes, arms: Sequence[LearnedArm]) -> None:
    for row, arm in enumerate(arms):
        colour, score = _COLOURS[arm.arm], arm.score
        if math.isfinite(score.low):
            axes.plot([score.low, score.high], [row, row], color=colour, lw=2.5)
        axes.plot(arm.means, [row] * len(arm.means), "o", color=colour, ms=4, alpha=0.5)
        axes.plot(score.value, row, "D", color=colour, ms=8, mec="white")
    axes.set_yticks(range(len(arms)), [arm.arm for arm in arms])
    axes.set_ylim(len(arms) - 0.5, -0.5)
