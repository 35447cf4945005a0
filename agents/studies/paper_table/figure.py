"""The paper's table as pictures: estimates over time, information of the channels, the map of the sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.imu_sensitivity import Sensitivity
from offroad_env.world.soils import SOILS

__all__ = ["estimates_figure", "sensitivity_figure", "sweep_figure"]

#: Okabe & Ito.
_STYLES = {
    ("propagated", "bicycle"): ("#D55E00", "propagated, bicycle"),
    ("propagated", "half_car"): ("#E69F00", "propagated, half-car"),
    ("known", "half_car"): ("0.35", "known, half-car"),
    ("map_ukf_bank", "half_car"): ("#0072B2", "bank of joint UKFs, half-car"),
}
_CHANNELS = ("a_x", "a_y", "a_z", "pitch rate", "yaw rate")
#: Share of the colour scale below which its colours are light.
_LIGHT = 0.4
_COLOURS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00")


class _Point(Protocol):
    @property
    def model(self) -> str: ...

    @property
    def alpha(self) -> float: ...

    @property
    def drift(self) -> float: ...

    @property
    def reached(self) -> int: ...

    @property
    def median_log_mse(self) -> float: ...


def _tidy(axes: Axes) -> None:
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def estimates_figure(series: Mapping[tuple[str, str, int], Mapping[str, Sequence[float]]]) -> Figure:
    """n over time on every row, with 95 % intervals, one noise seed.

    Parameters
    ----------
    series : (source, model, row) -> lists "t", "n", "low", "high"
    """
    figure = Figure(figsize=(14.0, 7.4), layout="constrained")
    panels = figure.subplots(2, 4, sharex=True, sharey="row")
    for row, axes in zip(ROWS, panels.flat, strict=True):
        for (source, model), (colour, label) in _STYLES.items():
            kept = series.get((source, model, row.number))
            if kept is not None:
                axes.fill_between(kept["t"], kept["low"], kept["high"], color=colour, alpha=0.2, lw=0)
                axes.plot(kept["t"], kept["n"], color=colour, lw=1.1, label=label)
        axes.axhline(SOILS[row.soil].n, color="0.1", lw=1.0, ls="--", label="true n")
        if not axes.lines[1:]:
            axes.text(0.5, 0.1, "not run", color="0.4", ha="center", transform=axes.transAxes)
        steering = "straight"
        if row.steer_amplitude > 0.0:
            frequency = "" if row.steer_frequency == 1.0 else f"{row.steer_frequency:g} "
            steering = f"{row.steer_amplitude:g} sin {frequency}t"
        axes.set_title(
            f"{row.number}: {row.soil.replace('_', ' ')}, ground {row.H0:g} m, {steering}",
            loc="left",
            fontsize=10,
        )
        axes.set_ylim((0.3, 1.3) if row.soil == "clay" else (0.95, 1.25))
        axes.margins(x=0.0)
        _tidy(axes)
    for axes in panels.flat:
        axes.set_xlabel("time [s]")
        axes.set_ylabel("sinkage exponent n [-]")
    handles: dict[str, Artist] = {}
    for axes in panels.flat:
        artists, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, artists, strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=len(handles), frameon=False
    )
    return figure


def sensitivity_figure(soils: Sequence[Sensitivity]) -> Figure:
    """Force of the rolling vehicle over n, and the information of every channel, one row of panels a soil."""
    manoeuvres = list(soils[0].distances)
    figure = Figure(figsize=(14.0, 3.6 * len(soils)), layout="constrained")
    panels = figure.subplots(len(soils), 1 + len(manoeuvres), squeeze=False)
    for line, soil in zip(panels, soils, strict=True):
        _draw_force(line[0], soil)
        for axes, name in zip(line[1:], manoeuvres, strict=True):
            for j, (channel, colour) in enumerate(zip(_CHANNELS, _COLOURS, strict=True)):
                axes.plot(soil.n, np.maximum(soil.distances[name][:, j], 1e-4), color=colour, label=channel)
            axes.axvline(soil.n_true, color="0.1", lw=1.0, ls="--")
            axes.set_yscale("log")
            axes.set_ylim(1e-3, 10.0)
            axes.set_title(name, loc="left", fontsize=10)
            _tidy(axes)
        for axes in line[1:]:
            axes.set_ylabel("rms difference from the truth\n[sd of a sample's noise]")
    for axes in panels.flat:
        axes.set_xlabel("sinkage exponent n [-]")
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _draw_force(axes: Axes, soil: Sensitivity) -> None:
    curve = soil.force
    axes.plot(curve.n, curve.acceleration, color="#0072B2", lw=1.6)
    level = np.interp(soil.n_true, curve.n, curve.acceleration)
    axes.axhline(level, color="0.6", lw=0.8)
    axes.plot(curve.roots, [level] * len(curve.roots), "o", color="#0072B2", ms=6)
    axes.axvline(soil.n_true, color="0.1", lw=1.0, ls="--")
    for n in curve.turning_points:
        axes.plot(n, np.interp(n, curve.n, curve.acceleration), "^", color="#D55E00", ms=7)
    roots = ", ".join(f"{n:.2f}" for n in curve.roots)
    axes.set_title(
        f"{soil.soil.replace('_', ' ')}: pulls like the truth\nat n = {roots}", loc="left", fontsize=9
    )
    axes.set_ylabel("wheel force along x / mass [m/s$^2$]")
    _tidy(axes)


def sweep_figure(points: Sequence[_Point], chosen: Mapping[str, _Point]) -> Figure:
    """Median log-MSE over alpha and R_n, with the number of rows at or below the paper; chosen: framed."""
    figure = Figure(figsize=(6.2 * len(chosen), 3.8), layout="constrained")
    for axes, (model, best) in zip(
        figure.subplots(1, len(chosen), squeeze=False)[0], chosen.items(), strict=True
    ):
        own = {(p.alpha, p.drift): p for p in points if p.model == model}
        alphas, drifts = (sorted({key[i] for key in own}) for i in (0, 1))
        values = np.array([[own[a, d].median_log_mse for d in drifts] for a in alphas])
        image = axes.imshow(values, origin="lower", aspect="auto", cmap="viridis_r")
        for i, a in enumerate(alphas):
            for j, d in enumerate(drifts):
                light = image.norm(own[a, d].median_log_mse) < _LIGHT
                shade = "0.1" if light else "white"
                axes.text(j, i, f"{own[a, d].reached}", ha="center", va="center", color=shade, fontsize=11)
        corner = drifts.index(best.drift) - 0.45, alphas.index(best.alpha) - 0.45
        axes.add_patch(Rectangle(corner, 0.9, 0.9, fill=False, ec="#D55E00", lw=3.0, zorder=3))
        axes.set_xticks(range(len(drifts)), [f"{d:g}" for d in drifts])
        axes.set_yticks(range(len(alphas)), [f"{a:g}" for a in alphas])
        axes.set_xlabel(r"$\sqrt{R_n}$, drift of n in an update [-]")
        axes.set_ylabel(r"$\alpha$, spread of the sigma points [-]")
        name = model.replace("_", "-")
        axes.set_title(f"{name}: rows at or below the paper, of {len(ROWS)}", loc="left", fontsize=11)
        figure.colorbar(image, ax=axes, label="median of log$_{10}$ (mean square error of n) [-]")
    return figure
