"""The soil under a drive: what is known of n and phi, and what the model predicts of the drive."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from agents.reports.soil_belief import Report
from estimators.belief.soil_belief import StructureFit
from estimators.belief.unknowns import PHI, N
from estimators.belief.windows import COMPARED
from estimators.replay.replay import LEAD_IN
from estimators.replay.structures import Case, plant_for, title_of

__all__ = ["soil_belief_figure"]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
#: Structures with less weight than this are not drawn.
_LEAST = 0.02
_SHOWN = {"v_x": "speed [m/s]", "yaw_rate": "yaw rate [rad/s]", "omega_f": "front wheels [rad/s]"}


def soil_belief_figure(report: Report) -> Figure:
    """Left: 95 % regions of n and phi, by structure; right: three channels, measured and predicted."""
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    parts = figure.subfigures(1, 2, width_ratios=(1.0, 1.35), squeeze=False)[0]
    _draw_regions(parts[0].subplots(), report)
    _draw_channels(parts[1].subplots(len(_SHOWN), 1, sharex=True), report)
    figure.suptitle(f"{report.belief.log}: {report.sentence}", fontsize=10, x=0.01, ha="left", wrap=True)
    return figure


def _label(case: Case) -> str:
    return f"{title_of(case.structure)}, {case.vehicle_model.replace('_', ' ')}"


def _region(part: StructureFit, colour: str) -> Ellipse:
    """Region of 95 % of n and phi under one structure, the model discrepancy included."""
    covariance = part.covariance[np.ix_((N, PHI), (N, PHI))]
    variances, axes = np.linalg.eigh(covariance)
    reach = 2.0 * np.sqrt(chi2.ppf(0.95, 2) * variances)
    angle = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    middle = part.fit.values[N], part.fit.values[PHI]
    return Ellipse(middle, reach[1], reach[0], angle=angle, facecolor=colour, alpha=0.25, edgecolor=colour)


def _draw_regions(axes: Axes, report: Report) -> None:
    drawn = [part for part in report.belief.parts if part.weight >= _LEAST]
    for part, colour in zip(drawn, _COLOURS, strict=False):
        axes.add_patch(_region(part, colour))
        name = f"{_label(part.case)}, weight {part.weight:.2f}"
        axes.plot(*part.fit.values[[N, PHI]], "o", color=colour, ms=5, label=name)
    soil = report.belief.soil()
    middle = soil["n"].mean, soil["phi"].mean
    n, phi = soil["n"], soil["phi"]
    reach = (
        [[n.mean - n.low], [n.high - n.mean]],
        [[phi.mean - phi.low], [phi.high - phi.mean]],
    )
    axes.errorbar(
        *middle, xerr=reach[0], yerr=reach[1], color="0.15", lw=1.3, capsize=3, label="95 % to quote"
    )
    axes.set(xlabel="sinkage exponent n [-]", ylabel="friction angle phi [rad]")
    axes.margins(0.25)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12))


def _draw_channels(rows: np.ndarray, report: Report) -> None:
    belief = report.belief
    windows, part = belief.windows, belief.parts[0]
    predicted = windows.predicted(plant_for(windows.log, part.case), part.fit.values)
    step = windows.motion.step
    for axes, (name, label) in zip(rows, _SHOWN.items(), strict=True):
        place = COMPARED.index(name)
        for w, first in enumerate(windows.first):
            t = windows.motion.t[first] + LEAD_IN + step * np.arange(predicted.shape[1])
            own = "measured, smoothed" if w == 0 else None
            model = "predicted from each window's start" if w == 0 else None
            axes.plot(t, windows.observed[w, :, place], color="0.55", lw=2.2, label=own)
            axes.plot(t, predicted[w, :, place], color=_COLOURS[0], lw=1.1, label=model)
        axes.set_ylabel(label)
        axes.margins(x=0.0)
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    rows[0].legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    rows[-1].set_xlabel("time [s]")
