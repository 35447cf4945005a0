"""The arms of a benchmark side by side: how they score, how often they fail, on which soil."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.benchmark.runner import FORM_TITLES
from agents.benchmark.statistics import Interval
from agents.benchmark.summary import ArmSummary, Benchmark

__all__ = ["arms_figure"]

#: Colours of Okabe & Ito, for colour-blind readers too; one marker each.
_STYLES = {
    "nominal": ("#D55E00", "s"),
    "conservative": ("#E69F00", "D"),
    "aware": ("#0072B2", "o"),
    "oracle": ("#009E73", "^"),
}
#: Markers of other controllers with the belief of an arm (lqr_aware, nmpc_belief), which have its colour.
_CONTROLLERS = "*phd"
_BELIEFS = {"truth": "oracle", "belief": "aware"}
#: Arms in a line of the legend, and in a figure of the usual height.
_COLUMNS, _USUAL = 8, 6
#: For all others, in turn.
_OTHERS = (("#CC79A7", "v"), ("0.35", "P"), ("#56B4E9", "X"), ("#8A6D00", "<"), ("#7A4A1E", ">"))


def arms_figure(benchmark: Benchmark, *, title: str | None = None) -> Figure:
    """Score over the true n, mean scores, times and failure rates with 95 % intervals.

    Parameters
    ----------
    benchmark
        From `agents.benchmark.runner.run_arms`.
    title
        Heading; default: what knowing the soil is worth in this benchmark.

    Returns
    -------
    Figure
        Left: every episode of every arm; those that failed lie in the strip above the line. Right:
        mean score, mean time of the episodes that all arms finished, and share of failed episodes.
    """
    more = max(len(benchmark.arms) - _USUAL, 0)
    figure = Figure(figsize=(13.0, 5.2 + 0.35 * more), layout="constrained")
    episodes, score, time, failed = figure.subplots(1, 4, width_ratios=(3.9, 2.2, 2.2, 1.6))
    _draw_episodes(episodes, benchmark)
    names = [summary.name for summary in benchmark.summaries]
    _draw_rows(score, benchmark.summaries, [summary.score for summary in benchmark.summaries])
    score.set_yticks(range(len(names)), names)
    score.set_title(_broken(f"Score: {benchmark.measure}"), loc="left", fontsize=9)
    score.set_xlabel(f"mean score [{benchmark.unit}]")
    _draw_rows(time, benchmark.summaries, [summary.paired_time for summary in benchmark.summaries])
    paired = f"The {benchmark.finished_by_all} episodes that all arms finished"
    time.set_title(_broken(paired), loc="left", fontsize=9)
    time.set_xlabel("mean time [s]")
    shares = [_failure_share(summary.success) for summary in benchmark.summaries]
    _draw_rows(failed, benchmark.summaries, shares, percent=True)
    failed.set_title("Failures", loc="left", fontsize=9)
    failed.set_xlabel("failed episodes [%]")
    # Of the figure: under one of four axes ten names would leave no room for the axes.
    figure.legend(
        *episodes.get_legend_handles_labels(),
        loc="outside lower left",
        ncols=min(len(names), _COLUMNS),
        frameon=False,
        handletextpad=0.2,
    )
    figure.suptitle(title or _headline(benchmark), fontsize=12, x=0.01, ha="left")
    return figure


def _style(name: str) -> tuple[str, str]:
    controller, _, belief = name.partition("_")
    colour, _ = _STYLES.get(_BELIEFS.get(belief, belief), ("", ""))
    if colour:
        return colour, _CONTROLLERS[sum(controller.encode()) % len(_CONTROLLERS)]
    return _STYLES.get(name) or _OTHERS[sum(name.encode()) % len(_OTHERS)]


def _broken(text: str, width: int = 30) -> str:
    """The text in lines of at most ``width`` characters."""
    return "\n".join(textwrap.wrap(text, width))


def _headline(benchmark: Benchmark) -> str:
    episodes = len(benchmark.arms[0].episodes)
    text = f"{benchmark.scenario}, {FORM_TITLES[benchmark.form]}: {episodes} paired episodes an arm"
    difference = benchmark.oracle_minus_uninformed
    if difference is not None:
        text += f"; oracle minus {benchmark.better_uninformed}: {difference:+.3g} {benchmark.unit}"
    return text


def _failure_share(success: Interval) -> Interval:
    return Interval(1.0 - success.value, 1.0 - success.high, 1.0 - success.low, success.level)


def _draw_episodes(axes: Axes, benchmark: Benchmark) -> None:
    arms = benchmark.arms
    scores = np.concatenate([arm.scores[arm.success] for arm in arms])
    low, high = (float(scores.min()), float(scores.max())) if scores.size else (0.0, arms[0].time_limit)
    span = max(high - low, 1e-3)
    line = high + 0.08 * span
    for row, arm in enumerate(arms):
        colour, marker = _style(arm.name)
        n = np.array([episode.n for episode in arm.episodes])
        good = arm.success
        axes.plot(n[good], arm.scores[good], marker, color=colour, ms=5, alpha=0.8, ls="none", label=arm.name)
        height = line + (0.06 + 0.07 * row) * span
        axes.plot(n[~good], np.full((~good).sum(), height), "x", color=colour, ms=6, mew=1.6)
    axes.axhline(line, color="0.5", lw=0.8)
    axes.set_ylim(low - 0.05 * span, line + (0.12 + 0.07 * len(arms)) * span)
    failed = sum(int((~arm.success).sum()) for arm in arms)
    note = "failed" if failed else "failed: none"
    axes.text(0.01, 0.985, note, transform=axes.transAxes, va="top", color="0.35", fontsize=9)
    axes.set_yticks([tick for tick in axes.get_yticks() if low - 0.05 * span <= tick <= line])
    axes.set_xlabel("true sinkage exponent n [-]")
    axes.set_ylabel(f"score [{benchmark.unit}], less is better")
    axes.set_title("Every episode", loc="left", fontsize=10)
    axes.grid(alpha=0.25)


def _draw_rows(
    axes: Axes,
    summaries: tuple[ArmSummary, ...],
    intervals: Sequence[Interval | None],
    *,
    percent: bool = False,
) -> None:
    scale = 100.0 if percent else 1.0
    for row, (summary, interval) in enumerate(zip(summaries, intervals, strict=True)):
        if interval is None:
            continue
        colour, marker = _style(summary.name)
        axes.plot([scale * interval.low, scale * interval.high], [row, row], color=colour, lw=2.5)
        axes.plot(scale * interval.value, row, marker, color=colour, ms=8, mec="white")
        axes.annotate(
            f"{scale * interval.value:.0f}" if percent else f"{interval.value:.3g}",
            (scale * interval.value, row),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            fontsize=9,
            color=colour,
        )
    axes.set_yticks(range(len(summaries)), [""] * len(summaries))
    axes.set_ylim(len(summaries) - 0.5, -0.6)
    axes.margins(x=0.15)
    if percent:
        axes.set_xlim(left=min(-3.0, axes.get_xlim()[0]))
    axes.grid(axis="x", alpha=0.25)
    axes.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
