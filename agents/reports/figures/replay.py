"""Open-loop errors of several models: as bars by channel, and over the time since the start of a window."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from estimators.replay.replay import CHANNELS, Replay
from estimators.replay.structures import title_of

__all__ = ["replay_figure"]

#: A colour for each structure, Okabe & Ito, the strongest contrasts first; a line for each vehicle model.
_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31", "#7F7F7F")
_LINES = ("-", "--", ":")
_PANELS = {
    "v_x": "forward speed v_x", "v_y": "side speed v_y", "yaw_rate": "yaw rate", "omega_f": "front wheels ω",
    "omega_r": "rear wheels ω", "a_y": "side acceleration a_y", "position": "position",
}  # fmt: skip
#: The smallest error on a bar is at least this share of the largest, so that logarithmic bars stay readable.
_SPAN = 1e-3
#: The scale of the growth shows all errors from this share of the window on.
_SETTLED = 0.05


def replay_figure(groups: Sequence[Replay]) -> Figure:
    """Bars of the root mean square error above, its growth within a window below, a panel per channel.

    Parameters
    ----------
    groups
        One for each model, all logs together (`pooled`).
    """
    count = len(groups)
    figure = Figure(figsize=(15.0, 4.6 + 0.32 * count + 3.0), layout="constrained")
    grid = figure.add_gridspec(2, len(_PANELS), height_ratios=(1.0 + 0.24 * count, 3.0))
    best = {name: _best(groups, name) for name in _PANELS}
    for i, name in enumerate(_PANELS):
        bars, growth = figure.add_subplot(grid[0, i]), figure.add_subplot(grid[1, i])
        _draw_bars(bars, groups, name, best[name])
        _draw_growth(growth, groups, name)
        if i == 0:
            bars.set_yticks(range(count), [_title(group) for group in groups], fontsize=11)
        else:
            bars.set_yticks([])
    first = groups[0]
    figure.suptitle(
        f"{first.log}, {first.windows} windows of {first.window_s:g} s predicted open loop, nothing fitted: "
        "r.m.s. error, the smaller the better (★ smallest)",
        fontsize=12,
        x=0.01,
        ha="left",
    )
    return figure


def _style(groups: Sequence[Replay], k: int) -> tuple[str, str]:
    """(colour, line) of a group: by its structure and by its vehicle model, in the order of their coming."""
    structures = list(dict.fromkeys(group.structure for group in groups))
    models = list(dict.fromkeys(group.vehicle_model for group in groups))
    colour = _COLOURS[structures.index(groups[k].structure) % len(_COLOURS)]
    return colour, _LINES[models.index(groups[k].vehicle_model) % len(_LINES)]


def _title(group: Replay) -> str:
    return f"{title_of(group.structure)} · {group.vehicle_model.replace('_', ' ')}"


def _best(groups: Sequence[Replay], name: str) -> int:
    errors = [group.rms[name] for group in groups]
    return int(np.nanargmin(errors)) if np.isfinite(errors).any() else -1


def _draw_bars(axes: Axes, groups: Sequence[Replay], name: str, best: int) -> None:
    errors = np.array([group.rms[name] for group in groups])
    finite = errors[np.isfinite(errors)]
    axes.set_title(_PANELS[name], fontsize=11, loc="left")
    axes.set_xlabel(f"error [{CHANNELS[name]}]", fontsize=10.5)
    axes.set_xticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_ylim(len(groups) - 0.4, -0.6)
    if not len(finite):
        axes.text(0.5, 0.5, "no data", transform=axes.transAxes, ha="center")
        return
    largest = max(float(finite.max()), 1e-12)
    axes.set_xlim(0.0, 2.0 * largest)
    for k, error in enumerate(errors):
        if not math.isfinite(error):
            continue
        colour, line = _style(groups, k)
        hatch = "" if line == _LINES[0] else "////"
        axes.barh(k, max(error, _SPAN * largest), height=0.7, color=colour, hatch=hatch, edgecolor="white")
        star = " ★" if k == best and len(groups) > 1 else ""
        weight = "bold" if star else "normal"
        axes.text(
            error + 0.03 * largest, k, f"{error:.3g}{star}", va="center", fontsize=10.5, fontweight=weight
        )


def _draw_growth(axes: Axes, groups: Sequence[Replay], name: str) -> None:
    for k, group in enumerate(groups):
        growth = group.growth[name]
        if not np.isfinite(growth).any():
            continue
        colour, line = _style(groups, k)
        axes.plot(group.t, growth, color=colour, ls=line, lw=1.6)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    # The first instants, where an error is only that of the start, must not stretch the scale.
    values = np.concatenate([group.growth[name][group.t >= _SETTLED * group.window_s] for group in groups])
    values = values[values > 0.0]
    if len(values):
        axes.set_ylim(0.6 * values.min(), 1.5 * values.max())
    axes.set_ylabel(f"error [{CHANNELS[name]}]", fontsize=10.5)
    axes.set_xlabel("time [s]", fontsize=10.5)
    axes.margins(x=0.0)
    axes.grid(alpha=0.25)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
