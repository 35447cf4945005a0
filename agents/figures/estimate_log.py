"""What a filter made of a log: n over time with its band, and how well each sample was expected."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from estimators.log_filters import LogEstimate

__all__ = ["log_estimate_figure"]

_BLUE, _ORANGE, _GREEN, _GREY = "#0072B2", "#D55E00", "#009E73", "0.35"
#: Innovations are drawn as their mean over this time [s]: single samples would be a cloud.
_MEAN_TIME = 1.0
_NORMAL_95 = 1.959964


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
    t = result.t
    axes.fill_between(t, result.low, result.high, color=_BLUE, alpha=0.2, lw=0, label="95 % interval")
    axes.plot(t, result.n, color=_BLUE, lw=1.5, label="estimate")
    if reference is not None and len(reference):
        axes.plot(*reference.T, color="0.1", lw=1.3, ls="--", label="truth (ref column, unseen)")
    mean, reach = result.second[:, 0], _NORMAL_95 * result.second[:, 1]
    axes.fill_between(t, mean - reach, mean + reach, color=_GREEN, alpha=0.15, lw=0)
    axes.plot(t, mean, color=_GREEN, lw=1.3, label="second opinion and its 95 %, in doubt of the model")
    low, high = axes.get_ylim()
    if not result.valid.all():
        axes.fill_between(
            t,
            low,
            high,
            where=~result.valid,
            color=_ORANGE,
            alpha=0.12,
            lw=0,
            label="the filter does not vouch for it",
        )
    axes.set_ylim(low, high)
    axes.set_ylabel("sinkage exponent n [-]")
    axes.legend(frameon=False, fontsize=9, loc="best")


def _draw_innovations(axes: Axes, result: LogEstimate) -> None:
    present = ~np.isnan(result.nis)
    if not present.any():
        return
    t, nis = result.t[present], result.nis[present] / result.channels
    count = max(round(_MEAN_TIME / float(np.median(np.diff(t)))), 1) if len(t) > 1 else 1
    window = np.ones(count)
    mean = np.convolve(nis, window, mode="same") / np.convolve(np.ones(len(nis)), window, mode="same")
    low, high = chi2.ppf([0.025, 0.975], result.channels * count) / (result.channels * count)
    axes.axhspan(low, high, color=_GREY, alpha=0.15, lw=0, label="expected of white noise, 95 %")
    axes.plot(t, mean, color=_BLUE, lw=1.2, label=f"mean over {_MEAN_TIME:g} s")
    axes.set_ylim(0.0, max(2.0, 1.1 * float(mean.max())))
    axes.set_ylabel("innovation² /\nexpected [-]")
    axes.legend(frameon=False, fontsize=9, loc="best")
