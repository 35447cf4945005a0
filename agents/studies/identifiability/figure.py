"""Ellipses of the bound and clouds of estimates for pairs of soil parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from agents.studies.identifiability.study import Finding
from estimators.experiments.fisher_information import PARAMETERS

__all__ = ["identify_figure"]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe & Ito
#: sqrt(chi-square quantile of 2 degrees of freedom at 95 %).
_SIZE = math.sqrt(5.991465)


def identify_figure(findings: Sequence[Finding]) -> Figure:
    """A row a drive, a column a pair: 95 % ellipse of the bound, of the prior, and the estimates' errors."""
    sources = list(dict.fromkeys(finding.title for finding in findings))
    pairs = list(dict.fromkeys(finding.information.parameters for finding in findings))
    size = (1.0 + 3.7 * len(pairs), 0.8 + 2.7 * len(sources))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(sources), len(pairs), squeeze=False)
    for finding in findings:
        i, j = sources.index(finding.title), pairs.index(finding.information.parameters)
        _draw(panels[i, j], finding, _COLOURS[i % len(_COLOURS)])
        if j == 0:
            panels[i, j].set_title(f"{finding.title}, {finding.duration:g} s", loc="left", fontsize=10)
        panels[i, j].set_xlabel("error of n [-]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=9, loc="outside upper right", ncols=3)
    return figure


def _draw(axes: Axes, finding: Finding, colour: str) -> None:
    information = finding.information
    axes.plot(
        *_ellipse(np.diag(np.square(information.prior_sd))), color="0.6", lw=1.0, ls=":", label="prior, 95 %"
    )
    axes.plot(*_ellipse(information.bound), color=colour, lw=1.8, label="bound, 95 %")
    axes.scatter(
        finding.errors[:, 0], finding.errors[:, 1], s=9, color=colour, alpha=0.55, lw=0, label="estimates"
    )
    axes.axhline(0.0, color="0.85", lw=0.8, zorder=0)
    axes.axvline(0.0, color="0.85", lw=0.8, zorder=0)
    name = information.parameters[1]
    axes.set_ylabel(f"error of {name} [{PARAMETERS[name].unit}]")
    # The bound fills the panel: how much larger the prior is, its dots show only where both fit.
    reach = 1.25 * _SIZE * np.sqrt(np.diag(information.bound))
    largest = np.nanmax(np.abs(finding.errors), axis=0) if not np.isnan(finding.errors).all() else reach
    x, y = np.maximum(reach, np.minimum(1.1 * largest, 2.0 * reach))
    axes.set_xlim(-x, x)
    axes.set_ylim(-y, y)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.xaxis.set_major_locator(MaxNLocator(5))


def _ellipse(covariance: np.ndarray) -> np.ndarray:
    """(2, 200) outline that holds 95 % of a normal distribution."""
    angle = np.linspace(0.0, 2.0 * math.pi, 200)
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors @ (np.sqrt(values)[:, None] * _SIZE * np.stack([np.cos(angle), np.sin(angle)])))
