"""Figures of a diagnosis: errors, causes with their certainty, and gains."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from estimators.discrepancy.checks.forecast import Prediction
from estimators.discrepancy.checks.holdout_gain import ChannelGain
from estimators.discrepancy.checks.likelihood_profiles import LEVEL, Profile
from estimators.discrepancy.checks.misfit import Misfit, Stretch
from estimators.discrepancy.checks.whiteness import LikelihoodGain
from estimators.discrepancy.next_experiment import Advice
from estimators.discrepancy.summary import Score, SinkageExponent
from estimators.discrepancy.wording import amount as plain_amount

__all__ = [
    "UNITS",
    "amount",
    "cause_figure",
    "dependence_figure",
    "error_unit",
    "exponent_figure",
    "gain_figure",
    "isolability_figure",
    "menu_figure",
    "misfit_figure",
    "prediction_figure",
    "profile_figure",
    "raised",
    "sentence",
    "worst_figure",
]

#: Okabe & Ito: nominal and extended model.
_NOMINAL, _EXTENDED = "#D55E00", "#0072B2"
_GREY = "0.62"
#: Channel -> unit.
UNITS = {
    "a_x": "m/s²", "a_y": "m/s²", "a_z": "m/s²", "pitch_rate": "rad/s", "yaw_rate": "rad/s",
    "omega_f": "rad/s", "omega_r": "rad/s", "x": "m", "y": "m", "yaw": "rad", "pitch": "rad",
    "v_x": "m/s", "v_y": "m/s", "speed": "m/s", "course": "rad",
}  # fmt: skip


def error_unit(channel: str, channels: Collection[str]) -> str:
    """Unit of a channel's errors; those of a course count as the velocity across it if the speed is known."""
    return "m/s" if channel == "course" and "speed" in channels else UNITS[channel]


def amount(effect: str, size: float) -> str:
    """A size of an effect with its unit, for the eye."""
    return raised(plain_amount(effect, size))


def raised(text: str) -> str:
    """Powers of units as one writes them."""
    return text.replace("^2", "²").replace("^3", "³")


def sentence(text: str) -> str:
    """A phrase as a sentence."""
    return f"{text[0].upper()}{text[1:]}."


def _tidy(axes: Axes, grid: Literal["both", "x", "y"] = "both") -> None:
    axes.grid(alpha=0.25, axis=grid)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def misfit_figure(misfit: Misfit, *, extended: bool) -> Figure:
    """Residuals by channel and regime, relative to those of the better model in the whole run."""
    scale = misfit.extended[:, :1]
    tables = [("nominal model", misfit.nominal / scale)]
    if extended:
        tables.append(("extended model", misfit.extended / scale))
    top = max(float(np.nanmax([np.nanmax(table) for _, table in tables])), 3.0)
    height = 1.3 + 0.33 * len(misfit.channels)
    figure = Figure(figsize=(12.0 if extended else 7.0, height), layout="constrained")
    panels = figure.subplots(1, len(tables), squeeze=False, sharey=True)[0]
    for axes, (title, table) in zip(panels, tables, strict=True):
        image = axes.imshow(table, cmap="OrRd", norm=LogNorm(0.8, top), aspect="auto")
        for (i, j), value in np.ndenumerate(table):
            if np.isfinite(value):
                shade = "white" if value > 0.8 * (top / 0.8) ** 0.6 else "0.15"
                axes.text(j, i, f"{value:.1f}", ha="center", va="center", fontsize=8, color=shade)
        axes.set_title(title, loc="left", fontsize=11)
        axes.set_xticks(range(len(misfit.regimes)), misfit.regimes, fontsize=8)
        axes.set_yticks(range(len(misfit.channels)), misfit.channels)
        axes.set_xlabel("driving regime [-]")
        axes.tick_params(length=0)
    panels[0].set_ylabel("channel [-]")
    ticks = [1, 2, 5, 10, 20, 50, 100]
    bar = figure.colorbar(
        image, ax=panels, label="error over what remains [-]", pad=0.01, ticks=ticks, format="%g"
    )
    bar.minorticks_off()
    return figure


def worst_figure(misfit: Misfit, *, extended: bool) -> Figure:
    """Measured and simulated in the worst seconds; every window of both models starts anew."""
    rows = (len(misfit.worst) + 1) // 2
    figure = Figure(figsize=(12.0, 2.5 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False, sharex=True).ravel()
    for axes, stretch in zip(panels, misfit.worst, strict=False):
        axes.plot(stretch.t, stretch.measured, ".", color=_GREY, ms=4, label="measured")
        axes.plot(*_broken(stretch, stretch.nominal), color=_NOMINAL, lw=1.6, label="nominal")
        if extended:
            axes.plot(*_broken(stretch, stretch.extended), color=_EXTENDED, lw=1.6, label="extended")
        axes.set_ylabel(f"{stretch.channel} [{UNITS[stretch.channel]}]")
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
        _tidy(axes)
    for axes in panels[len(misfit.worst) :]:
        axes.set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    return figure


def _broken(stretch: Stretch, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A line with a gap between windows."""
    places = np.flatnonzero(np.diff(stretch.window)) + 1
    return np.insert(stretch.t, places, np.nan), np.insert(values, places, np.nan)


def dependence_figure(misfit: Misfit, *, extended: bool) -> Figure:
    """Mean residual over the quantity that it depends on most, for up to six channels."""
    chosen = misfit.dependences[:6]
    rows = (len(chosen) + 2) // 3
    figure = Figure(figsize=(12.0, 2.8 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, 3, squeeze=False).ravel()
    for axes, one in zip(panels, chosen, strict=False):
        style = {"fmt": "o-", "ms": 4, "lw": 1.3, "capsize": 2}
        axes.errorbar(one.centre, one.nominal, one.nominal_band, color=_NOMINAL, label="nominal", **style)
        if extended:
            axes.errorbar(
                one.centre, one.extended, one.extended_band, color=_EXTENDED, label="extended", **style
            )
        axes.axhline(0.0, color="0.3", lw=0.8)
        axes.set_xlabel(one.quantity)
        axes.set_ylabel(f"{one.channel} [{error_unit(one.channel, misfit.channels)}]")
        shares = f"{100.0 * one.share:.0f} %"
        if extended:
            shares += f" → {100.0 * one.share_extended:.0f} %"
        axes.set_title(f"{shares} of the variance", loc="left", fontsize=10)
        _tidy(axes)
    for axes in panels[len(chosen) :]:
        axes.set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    return figure


def cause_figure(scores: Sequence[Score], threshold: float, sets: Sequence[Sequence[str]]) -> Figure:
    """Score of every effect against the nominal model; sets in brackets, what is untestable in grey."""
    order = sorted(scores, key=lambda score: (score.reason == "", score.z))
    figure = Figure(figsize=(12.0, 1.1 + 0.19 * len(order)), layout="constrained")
    axes = figure.subplots()
    largest = max([*(score.z for score in order), 1.5 * threshold])
    places = {score.effect: i for i, score in enumerate(order)}
    members = {name for group in sets for name in group}
    for i, score in enumerate(order):
        if score.reason:
            axes.text(0.0, i, f" {raised(score.reason)}", va="center", fontsize=8, color="0.3")
            axes.barh(i, score.z, color="0.92", height=0.75, zorder=0)
            continue
        axes.barh(i, score.z, color=_EXTENDED if score.effect in members else "#B9CBDA", height=0.75)
        axes.annotate(
            f"detectable from {amount(score.effect, score.limit)}", (score.z, i), (4, 0),
            textcoords="offset points", va="center", fontsize=7.5, color="0.35",
        )  # fmt: skip
    axes.axvline(threshold, color=_NOMINAL, lw=1.2, ls="--")
    axes.text(threshold, len(order) - 0.2, f"  threshold {threshold:.1f}", color=_NOMINAL, fontsize=8)
    axes.set_xscale("function", functions=(lambda z: np.sqrt(np.maximum(z, 0.0)), np.square))
    axes.set_xlim(0.0, 1.9 * largest)
    axes.set_ylim(-0.6, len(order) + 0.4)
    axes.set_xticks([t for t in (1, 4, 10, 25, 50, 100, 200, 400, 800) if t < 1.6 * largest])
    axes.set_yticks(range(len(order)), [score.effect for score in order], fontsize=8)
    for label, score in zip(axes.get_yticklabels(), order, strict=True):
        label.set_color("0.55" if score.reason else "0.1")
        label.set_fontweight("bold" if score.effect in members else "normal")
    for k, group in enumerate(sets):
        _bracket(axes, sorted(places[name] for name in group), (1.58 + 0.05 * k) * largest, f"cause {k + 1}")
    axes.set_xlabel("score of the effect alone [standard deviations, root scale]")
    axes.set_ylabel("effect [-]")
    _tidy(axes, "x")
    return figure


def _bracket(axes: Axes, rows: list[int], x: float, label: str) -> None:
    """A line that joins the members of a set."""
    axes.plot([x, x], [rows[0] - 0.3, rows[-1] + 0.3], color="0.2", lw=1.4)
    for row in rows:
        axes.plot([0.985 * x, x], [row, row], color="0.2", lw=1.4)
    axes.text(1.01 * x, 0.5 * (rows[0] + rows[-1]), label, rotation=0, va="center", fontsize=8)


def isolability_figure(names: Sequence[str], alike: np.ndarray) -> Figure:
    """Similarity of any two effects in these data; similar ones are neighbours."""
    from scipy.cluster.hierarchy import leaves_list, linkage
    from scipy.spatial.distance import squareform

    if len(names) > 2:
        apart = np.clip(1.0 - np.abs(alike), 0.0, 1.0)
        np.fill_diagonal(apart, 0.0)
        order = leaves_list(linkage(squareform(0.5 * (apart + apart.T), checks=False), "average"))
        names, alike = [names[i] for i in order], alike[np.ix_(order, order)]
    side = 2.6 + 0.185 * len(names)
    figure = Figure(figsize=(side + 0.9, side), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(np.abs(alike), cmap="Blues", vmin=0.0, vmax=1.0)
    for (i, j), value in np.ndenumerate(np.abs(alike)):
        if i != j and value >= 0.9:
            axes.text(
                j, i, "●" if value >= 0.99 else "○", ha="center", va="center", fontsize=7, color="white"
            )
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7.5)
    axes.set_yticks(range(len(names)), names, fontsize=7.5)
    axes.tick_params(length=0)
    figure.colorbar(image, ax=axes, label="|cosine| of the two traces [-]", shrink=0.7, pad=0.01)
    return figure


def gain_figure(gains: Sequence[ChannelGain], likelihood: Sequence[LikelihoodGain]) -> Figure:
    """Reduction of the residuals and gain of the likelihood by the extended model on test data."""
    figure = Figure(figsize=(12.0, 1.2 + 0.33 * len(gains)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(gains))[::-1]
    share = [100.0 * (1.0 - gain.extended / max(gain.nominal, 1e-300)) for gain in gains]
    for axes, values, sides in (
        (left, share, [(100.0 * gain.low, 100.0 * gain.high) for gain in gains]),
        (right, [one.gain for one in likelihood], [(one.low, one.high) for one in likelihood]),
    ):
        for row, value, (low, high) in zip(rows, values, sides, strict=True):
            colour = _EXTENDED if low > 0.0 else _NOMINAL if high < 0.0 else _GREY
            axes.plot([low, high], [row, row], color=colour, lw=2.4)
            axes.plot(value, row, "o", color=colour, ms=6)
        axes.axvline(0.0, color="0.3", lw=0.8)
        _tidy(axes)
    left.set_yticks(rows, [gain.channel for gain in gains])
    left.set_xlabel("reduction of the residual [%]")
    left.set_ylabel("channel [-]")
    right.set_xlabel("gain of the log-likelihood [1/s]")
    return figure


def exponent_figure(n: SinkageExponent) -> Figure:
    """n before, and with every member of every cause, with 95 % intervals."""
    lines = [("nominal model", n.before, _NOMINAL)]
    lines += [(f"with {name}", entry, _EXTENDED) for name, entry in n.after.items()]
    figure = Figure(figsize=(12.0, 1.3 + 0.42 * len(lines)), layout="constrained")
    axes = figure.subplots()
    for i, (_, entry, colour) in enumerate(reversed(lines)):
        axes.plot([entry.low, entry.high], [i, i], color=colour, lw=2.6)
        axes.plot(entry.value, i, "o", color=colour, ms=6)
        axes.annotate(
            f"{entry.value:.3f}", (entry.value, i), (0, 6), textcoords="offset points", ha="center",
            fontsize=9,
        )  # fmt: skip
    axes.axvline(n.prior, color="0.4", lw=1.0, ls=":", label=f"stated in the log, {n.prior:.3f}")
    axes.set_yticks(range(len(lines)), [name for name, _, _ in reversed(lines)])
    axes.set_ylim(-0.6, len(lines) - 0.2)
    axes.set_xlabel("sinkage exponent n [-]")
    axes.set_ylabel("model [-]")
    figure.legend(loc="outside upper right", frameon=False, fontsize=9)
    _tidy(axes, "x")
    return figure


def prediction_figure(predictions: Sequence[Prediction], *, extended: bool) -> Figure:
    """Error of forecasts by horizon."""
    quantities = list(dict.fromkeys(one.quantity for one in predictions))
    figure = Figure(figsize=(12.0, 3.2), layout="constrained")
    panels = figure.subplots(1, len(quantities), squeeze=False)[0]
    for axes, quantity in zip(panels, quantities, strict=True):
        own = [one for one in predictions if one.quantity == quantity]
        places = np.arange(len(own))
        shift = 0.2 if extended else 0.0
        axes.bar(places - shift, [one.nominal for one in own], 0.38, color=_NOMINAL, label="nominal")
        if extended:
            axes.bar(places + shift, [one.extended for one in own], 0.38, color=_EXTENDED, label="extended")
        axes.set_xticks(places, [f"{one.horizon:.0f}" for one in own])
        axes.set_xlabel("horizon [s]")
        axes.set_ylabel(f"error of {quantity} [{own[0].unit}]")
        _tidy(axes, "y")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False)
    return figure


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """Loss of the log-likelihood where the size of a cause is fixed."""
    figure = Figure(figsize=(max(3.4 * len(profiles), 6.0), 3.2), layout="constrained")
    for axes, profile in zip(figure.subplots(1, len(profiles), squeeze=False)[0], profiles, strict=True):
        fine = np.linspace(profile.sizes.min(), profile.sizes.max(), 100)
        parabola = ((fine - profile.size) / profile.deviation) ** 2
        axes.plot(fine, parabola, color=_GREY, lw=1.2, ls="--", label="parabola")
        axes.plot(
            profile.sizes, profile.likelihood_ratio, "o-", color=_EXTENDED, ms=4, lw=1.4, label="profile"
        )
        axes.axhline(LEVEL, color=_NOMINAL, lw=1.0, ls=":")
        if np.isfinite(profile.low) and np.isfinite(profile.high):
            axes.axvspan(profile.low, profile.high, color=_EXTENDED, alpha=0.12, label="95 %")
        unit = f" [{profile.unit}]"
        axes.set_xlabel(raised(f"{profile.effect}{unit}"))
        axes.set_ylabel("loss of twice the\nlog-likelihood [-]")
        axes.set_ylim(-0.3, 10.0)
        axes.locator_params(axis="x", nbins=5)
        _tidy(axes)
    figure.axes[0].legend(frameon=False, fontsize=8)
    return figure


def menu_figure(advice: Advice) -> Figure:
    """Benefit of every manoeuvre of the menu."""
    trials = advice.trials
    figure = Figure(figsize=(12.0, 1.3 + 0.3 * len(trials)), layout="constrained")
    if advice.power is not None:
        axes = figure.subplots()
        rows = np.arange(len(trials))[::-1]
        axes.barh(rows, [100.0 * (trial.power or 0.0) for trial in trials], color=_EXTENDED, height=0.7)
        axes.axvline(100.0 * advice.power, color=_NOMINAL, lw=1.2, ls="--", label="these data alone")
        axes.set_yticks(rows, [trial.name for trial in trials])
        axes.set_xlim(0.0, 100.0)
        axes.set_xlabel(f"probability to {advice.question} [%]")
        axes.set_ylabel("manoeuvre [-]")
        axes.legend(frameon=False, loc="lower right")
        _tidy(axes, "x")
        return figure
    names = list(advice.limits)
    share = np.array([[trial.limits[name] / advice.limits[name] for name in names] for trial in trials])
    axes = figure.subplots()
    image = axes.imshow(100.0 * share, cmap="Greens_r", vmin=0.0, vmax=100.0, aspect="auto")
    for (i, j), value in np.ndenumerate(share):
        axes.text(
            j, i, f"{100.0 * value:.0f}", ha="center", va="center", fontsize=8,
            color="white" if value < 0.45 else "0.1",
        )  # fmt: skip
    axes.set_xticks(range(len(names)), names, fontsize=9)
    axes.set_yticks(range(len(trials)), [trial.name for trial in trials], fontsize=9)
    axes.set_xlabel("effect [-]")
    axes.set_ylabel("manoeuvre [-]")
    axes.tick_params(length=0)
    figure.colorbar(image, ax=axes, label="detectable size [% of the present one]", pad=0.01)
    return figure
