"""Estimate of a filter along a log: n over time with its interval, and the normalised innovations."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from estimators.filters.belief_history import NORMAL_95
from estimators.log_estimation import LogEstimate

__all__ = ["log_estimate_figure"]

_BLUE, _ORANGE, _GREEN, _GREY = "#0072B2", "#D55E00", "#009E73", "0.35"
#: Innovations are drawn as their mean over this time [s]: single samples would be a cloud.
_MEAN_TIME = 1.0


def log_estimate_figure(result: LogEstimate, reference: np.ndarray | None = None) -> Figure:
    """Two panels over time: the estimate, and the normalised innovations.

    Parameters
    ----------
    result : LogEstimate
    reference : array (R, 2), optional
        Times [s] and true n [-], where the log knows them. No filter has seen them.
    """
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    _draw_estimate(upper, result, reference)
    _draw_innovations(lower, result)
    upper.set_title(f"{result.log}: filter {result.filter}", loc="left", fontsize=11)
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.margins(x=0.0)
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure


def _draw_estimate(axes: Axes, result: LogEstimate, reference: np.ndarray | None) -> None:
    stated, robust, t = result.stated, result.robust, result.stated.t
    label = "95 % interval as stated by the filter"
    axes.fill_between(t, stated.low, stated.high, color=_BLUE, alpha=0.2, lw=0, label=label)
    axes.plot(t, stated.n, color=_BLUE, lw=1.5, label="estimate")
    if reference is not None and len(reference):
        axes.plot(*reference.T, color="0.1", lw=1.3, ls="--", label="truth (ref column, unseen)")
    mean, reach = robust.posterior_n, NORMAL_95 * robust.posterior_sd
    axes.fill_between(t, mean - reach, mean + reach, color=_GREEN, alpha=0.15, lw=0)
    axes.plot(t, mean, color=_GREEN, lw=1.3, label="model evidence and its 95 %, robust to model errors")
    low, high = axes.get_ylim()
    if not stated.flag.all():
        axes.fill_between(
            t,
            low,
            high,
            where=~stated.flag,
            color=_ORANGE,
            alpha=0.12,
            lw=0,
            label="flag down",
        )
    axes.set_ylim(low, high)
    axes.set_ylabel("sinkage exponent n [-]")
    axes.legend(frameon=False, fontsize=9, loc="best")


def _draw_innovations(axes: Axes, result: LogEstimate) -> None:
    stated, channels = result.stated, result.stated.channels
    present = ~np.isnan(stated.nis)
    if not present.any() or not channels:
        return
    t, nis = stated.t[present], stated.nis[present] / channels
    count = max(round(_MEAN_TIME / float(np.median(np.diff(t)))), 1) if len(t) > 1 else 1
    window = np.ones(count)
    mean = np.convolve(nis, window, mode="same") / np.convolve(np.ones(len(nis)), window, mode="same")
    low, high = chi2.ppf([0.025, 0.975], channels * count) / (channels * count)
    axes.axhspan(low, high, color=_GREY, alpha=0.15, lw=0, label="expected of white noise, 95 %")
    axes.plot(t, mean, color=_BLUE, lw=1.2, label=f"mean over {_MEAN_TIME:g} s")
    axes.set_ylim(0.0, max(2.0, 1.1 * float(mean.max())))
    axes.set_ylabel("innovation² /\nexpected [-]")
    axes.legend(frameon=False, fontsize=9, loc="best")
