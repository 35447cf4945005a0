"""Natural soil seen from above, and the population of soils with its leave-one-out coverage."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offroad_env.physics.records import Soil, SoilField
from offroad_env.world.natural_soil import reference_pressure, soil_maps
from offroad_env.world.soil_prior import PRIOR_NAMES, LeaveOneOut, SoilPrior
from offroad_env.world.soils import SOILS

__all__ = ["field_figure", "prior_figure"]

_POINTS = 320  # along the longer side of a map
#: Colours of Okabe & Ito.
_MEASURED, _COVERAGE = "#D55E00", ("#0072B2", "#E69F00")
_LEVELS = np.arange(0.05, 1.0, 0.05)


def field_figure(field: SoilField, base: Soil, *, title: str, width: float, height: float) -> Figure:
    """Maps of p(5 cm), n, c and phi over ``width`` x ``height`` [m] about the origin."""
    X = np.linspace(-0.5 * width, 0.5 * width, _POINTS)
    Y = np.linspace(-0.5 * height, 0.5 * height, max(round(_POINTS * height / width), 2))
    here = soil_maps(field, base, X[None, :], Y[:, None])
    panels = (
        ("pressure at 5 cm [kPa]", 1e-3 * here.pressure),
        ("sinkage exponent n [-]", here.n),
        ("cohesion c [kPa]", 1e-3 * here.c),
        ("friction angle phi [°]", np.degrees(here.phi)),
    )
    figure = Figure(figsize=(11.0, 1.2 + 9.6 * height / width), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for panel, (heading, values) in zip(axes.ravel(), panels, strict=True):
        image = panel.imshow(
            values, origin="lower", extent=(X[0], X[-1], Y[0], Y[-1]), cmap="viridis", interpolation="nearest"
        )
        figure.colorbar(image, ax=panel, shrink=0.9, pad=0.02, label=heading)
    for panel in axes[-1]:
        panel.set_xlabel("X [m]")
    for panel in axes[:, 0]:
        panel.set_ylabel("Y [m]")
    figure.suptitle(title, fontsize=12.5, x=0.01, ha="left")
    return figure


def prior_figure(prior: SoilPrior, left_out: dict[str, LeaveOneOut], *, seed: int = 0) -> Figure:
    """Sampled and measured soils, and the coverage of the prior for soils that it has not seen."""
    rng = np.random.default_rng(seed)
    drawn = [prior.sample(rng) for _ in range(1500)]
    figure = Figure(figsize=(12.5, 4.6), layout="constrained")
    axes = figure.subplots(1, 3)
    _draw_soils(axes[0], prior, drawn, _stiffness)
    axes[0].set_yscale("log")
    axes[0].set_ylim(4.0, 6e3)
    axes[0].set_xlim(0.0, 2.0)
    axes[0].set_xlabel("sinkage exponent n [-]")
    axes[0].set_ylabel("pressure at 5 cm, 0.2 m wide [kPa]")
    _draw_soils(axes[1], prior, drawn, _strength)
    axes[1].set_xscale("log")
    axes[1].set_xlim(0.1, 300.0)
    axes[1].set_ylim(0.0, 55.0)
    axes[1].set_xlabel("cohesion c [kPa]")
    axes[1].set_ylabel("angle of shearing resistance phi [°]")
    figure.legend(*axes[0].get_legend_handles_labels(), frameon=False, loc="outside lower left", ncols=2)
    _draw_coverage(axes[2], left_out)
    for panel in axes:
        panel.grid(alpha=0.25)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    figure.suptitle(
        f"Prior of whole soils from {len(prior.soils)} measured ones", fontsize=12.5, x=0.01, ha="left"
    )
    return figure


def _stiffness(soil: Soil) -> tuple[float, float]:
    return soil.n, 1e-3 * reference_pressure(soil)


def _strength(soil: Soil) -> tuple[float, float]:
    return 1e-3 * soil.c, math.degrees(soil.phi)


def _draw_soils(
    panel: Axes, prior: SoilPrior, drawn: list[Soil], of: Callable[[Soil], tuple[float, float]]
) -> None:
    sampled = np.array([of(soil) for soil in drawn])
    measured = np.array([of(SOILS[name]) for name in prior.soils])
    panel.plot(*sampled.T, ".", ms=3, color="0.72", label="sampled soils", zorder=1, rasterized=True)
    panel.plot(*measured.T, "o", ms=6, color=_MEASURED, mec="white", label="measured soils", zorder=2)


def _draw_coverage(panel: Axes, left_out: dict[str, LeaveOneOut]) -> None:
    count = 0
    for (label, found), shade in zip(left_out.items(), _COVERAGE, strict=False):
        count = len(found.soils)
        joint = [found.coverage(level)[-1] for level in _LEVELS]
        panel.plot(_LEVELS, joint, "o-", ms=4, lw=1.5, color=shade, label=label)
    sd = np.sqrt(_LEVELS * (1.0 - _LEVELS) / count)
    panel.fill_between(_LEVELS, _LEVELS - 2.0 * sd, _LEVELS + 2.0 * sd, color="0.9", label="two binomial sd")
    panel.plot([0.0, 1.0], [0.0, 1.0], color="0.4", lw=0.9)
    panel.set_xlim(0.0, 1.0)
    panel.set_ylim(0.0, 1.02)
    panel.set_xlabel("nominal probability of the region [-]")
    panel.set_ylabel("left-out soils inside [-]")
    panel.set_title(f"Regions of {', '.join(PRIOR_NAMES[:4])}", loc="left", fontsize=9)
    panel.legend(frameon=False, fontsize=8.5, loc="upper left")
