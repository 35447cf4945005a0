"""Trials of a wheel rig with the model before and after a diagnosis."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimators.discrepancy.model.protocol import Channel
from estimators.discrepancy.model.windows import REPORT
from estimators.discrepancy.rig.fit import held_out_trials
from estimators.discrepancy.rig.settings import measured_trials
from estimators.discrepancy.rig.trial_model import RigModel
from estimators.discrepancy.verdict import Diagnosis

__all__ = ["rig_figure"]

_TITLES = {"sinkage": "sinkage", "drawbar": "drawbar pull", "side_force": "side force", "torque": "torque"}
_SHOWN = {"sinkage": ("mm", 1e3), "torque": ("N m", 1.0)}
_GREY = "0.55"


def rig_figure(diagnosis: Diagnosis) -> Figure:
    """Measured, nominal and extended over slip, a column a channel; residuals below.

    Points: means over the repeats of a condition, hollow where they are test data. Dotted: the
    nominal model with n fitted. Solid: with the causes that were found. One colour per slip angle.

    Raises
    ------
    ValueError
        If nothing was fitted.
    """
    logs = diagnosis.logs
    trials = measured_trials(logs)
    run = RigModel(logs[0], trials)
    search = diagnosis.search
    if search is None:
        raise ValueError("nothing was fitted to these trials: their data have problems")
    extended = search.nominal if diagnosis.model is None else diagnosis.model
    residuals = [held_out_trials(fit, run).residual for fit in (search.nominal, extended)]
    figure = Figure(figsize=(3.4 * len(run.channels), 6.0), layout="constrained")
    axes = figure.subplots(2, len(run.channels), sharex=True, height_ratios=(3, 2), squeeze=False)
    levels = trials.levels()
    shades = colormaps["plasma"](np.linspace(0.0, 0.85, levels.max() + 1))
    for column, channel in enumerate(run.channels):
        unit, scale = _SHOWN.get(channel.name, ("N", 1.0))
        means = _means(run, channel, residuals)
        _draw(axes[:, column], means, scale, shades)
        axes[0, column].set_ylabel(f"{_TITLES[channel.name]} [{unit}]")
        axes[1, column].set_ylabel(f"measured - model [{unit}]")
        axes[1, column].set_title(_scores(means, unit, scale), loc="left", fontsize=9)
        axes[1, column].set_xlabel("slip [-]  (-1 locked, 1 spinning)")
    angles = [float(np.degrees(np.abs(trials.slip_angle[levels == i]).mean())) for i in range(len(shades))]
    figure.legend(
        handles=_legend(angles, shades), loc="outside lower center", ncols=5, frameon=False, fontsize=9
    )
    return figure


def _means(run: RigModel, channel: Channel, residuals: list[np.ndarray]) -> dict[str, np.ndarray]:
    """By condition: slip, level of the slip angle, use, measured, and what both models leave."""
    trials, rows = run.trials, channel.record
    group = trials.condition[rows]
    count = np.bincount(group)
    there = count > 0

    def mean(values: np.ndarray) -> np.ndarray:
        return (np.bincount(group, values) / np.maximum(count, 1))[there]

    return {
        "slip": mean(trials.slip[rows]),
        "level": np.round(mean(trials.levels()[rows])).astype(int),
        "use": np.round(mean(trials.uses()[rows])).astype(int),
        "measured": mean(run.y[channel.rows]),
        "before": mean(residuals[0][channel.rows]),
        "after": mean(residuals[1][channel.rows]),
    }


def _draw(axes: np.ndarray, means: dict[str, np.ndarray], scale: float, shades: np.ndarray) -> None:
    for level, colour in enumerate(shades):
        rows = np.flatnonzero(means["level"] == level)
        rows = rows[np.argsort(means["slip"][rows])]
        slip = means["slip"][rows]
        face = [("white" if use == REPORT else colour) for use in means["use"][rows]]
        for kind, style in (("before", ":"), ("after", "-")):
            model = means["measured"][rows] - means[kind][rows]
            axes[0].plot(slip, scale * model, color=colour, ls=style, lw=1.5)
        axes[0].scatter(slip, scale * means["measured"][rows], 26, face, edgecolors=[colour], zorder=3)
        axes[1].plot(slip, scale * means["before"][rows], color=colour, ls=":", lw=1.2)
        axes[1].plot(slip, scale * means["after"][rows], color=colour, lw=1.2)
        axes[1].scatter(slip, scale * means["after"][rows], 16, face, edgecolors=[colour], zorder=3)
    for each in axes:
        _tidy(each)


def _tidy(axes: Axes) -> None:
    axes.axhline(0.0, color=_GREY, lw=0.8)
    axes.grid(alpha=0.25)
    axes.set_xlim(-1.06, 1.06)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _scores(means: dict[str, np.ndarray], unit: str, scale: float) -> str:
    """Root mean squares over the conditions of the report, else over all."""
    rows = means["use"] == REPORT
    where = "not used" if rows.any() else "all"
    rows = rows if rows.any() else np.full(len(rows), True)
    before, after = (scale * np.sqrt(np.mean(means[kind][rows] ** 2)) for kind in ("before", "after"))
    return f"{where}: {before:.1f} -> {after:.1f} {unit}"


def _legend(angles: list[float], shades: np.ndarray) -> list[Line2D]:
    kinds = [
        Line2D([], [], color=_GREY, marker="o", ls="", label="measured"),
        Line2D([], [], color=_GREY, marker="o", mfc="white", ls="", label="not used by the search"),
        Line2D([], [], color=_GREY, ls=":", label="model, n fitted"),
        Line2D([], [], color=_GREY, ls="-", label="extended model"),
    ]
    return kinds + [
        Line2D([], [], color=colour, lw=3.0, label=f"slip angle {angle:.0f}°")
        for angle, colour in zip(angles, shades, strict=True)
    ]
