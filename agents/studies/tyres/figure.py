"""Six panels: the flexible tyre and what is published about tyres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from agents.studies.tyres.results import STRUCTURE, Comparison, CurvePoint, Snow, sand
from offroad_env.physics.pressure_sinkage import bekker_modulus
from offroad_env.physics.records import Soil
from offroad_env.physics.tyre import critical_ground_pressure, hard_ground_deflection, tread_stiffness
from offroad_env.simulation.wheel import wheel_forces
from offroad_env.world.soils import make_soil
from offroad_env.world.tyres import TYRES, make_tyre
from offroad_env.world.vehicles import make_wheel

__all__ = ["tyres_figure"]

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7")
_LOAD = 3400.0


def tyres_figure(
    curves: Sequence[CurvePoint],
    effects: Sequence[Comparison],
    snow: Snow,
    forces: Mapping[str, np.ndarray],
) -> Figure:
    """Load-deflection, Wong's criterion, side force, pressure effects, snow and the brush limit."""
    figure = Figure(figsize=(14.0, 8.2), layout="constrained")
    first, second, third, fourth, fifth, sixth = figure.subplots(2, 3).ravel()
    _draw_curves(first, curves)
    _draw_criterion(second)
    _draw_side_force(third, forces)
    _draw_effects(fourth, effects)
    _draw_snow(fifth, snow)
    _draw_brush(sixth)
    return figure


def _finish(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
    axes.set(xlabel=x, ylabel=y)
    axes.grid(alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=8)


def _plain_ticks(axis: Axis, ticks: Sequence[int]) -> None:
    """Numbers instead of powers of ten on a logarithmic axis."""
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_locator(NullLocator())


def _draw_curves(axes: Axes, curves: Sequence[CurvePoint]) -> None:
    for inflation, colour in zip(sorted({one.inflation for one in curves}), _COLOURS, strict=False):
        own = [one for one in curves if one.inflation == inflation]
        tyre = make_tyre("goodyear_335_65r22_5", inflation=inflation)
        load = np.linspace(1e3, max(one.load for one in own) * 1.08, 60)
        f = [1e3 * hard_ground_deflection(tyre, float(one)) for one in load]
        axes.plot(f, load / 1e3, color=colour, label=f"{inflation / 1e3:.0f} kPa")
        axes.plot(
            [1e3 * one.deflection for one in own], [one.load / 1e3 for one in own], "o", color=colour, ms=4
        )
    _finish(axes, "Goodyear 335/65R22.5: measured (dots), model", "deflection [mm]", "load [kN]")


def _wong(soil: Soil, bearing: np.ndarray) -> np.ndarray:
    """Wong's sinkage [m]: of a rigid wheel above the critical pressure, of a flat patch below it."""
    tyre = TYRES["mrzr"]
    modulus = bekker_modulus(soil, tyre.b)
    p_gcr = critical_ground_pressure(modulus, soil.n, tyre.r, tyre.b, _LOAD)
    return np.array((np.minimum(bearing, p_gcr) / modulus) ** (1.0 / soil.n))


def _draw_criterion(axes: Axes) -> None:
    wheel = make_wheel(r=0.33, b=0.212)
    inflation = np.geomspace(30e3, 20e6, 40)
    for pressure, colour in zip((50e3, 150e3, 500e3), _COLOURS, strict=False):
        soil = sand(pressure)
        sinkage, bearing = [], []
        for p in inflation:
            tyre = make_tyre("mrzr", inflation=float(p))
            found = wheel_forces(soil, wheel, load=_LOAD, slip=0.0, structure=STRUCTURE, tyre=tyre)
            f = hard_ground_deflection(tyre, _LOAD)
            sinkage.append(1e3 * float(found.sinkage))
            bearing.append(_LOAD / (wheel.b * 2.0 * math.sqrt(2.0 * wheel.r * f)))
        q = np.array(bearing)
        label = f"sand, {pressure / 1e3:.0f} kPa at 5 cm"
        axes.loglog(q / 1e3, sinkage, color=colour, label=label)
        axes.loglog(q / 1e3, 1e3 * _wong(soil, q), ":", color=colour)
        p_gcr = critical_ground_pressure(bekker_modulus(soil, wheel.b), soil.n, wheel.r, wheel.b, _LOAD)
        axes.axvline(p_gcr / 1e3, color=colour, lw=0.8, alpha=0.5)
    _plain_ticks(axes.xaxis, (50, 100, 200, 400))
    _plain_ticks(axes.yaxis, (3, 10, 30, 100))
    title = "Sinkage, MRZR tyre, 3.4 kN (dotted: Wong; lines: p_gcr)"
    _finish(axes, title, "mean pressure on hard ground p_i + p_c [kPa]", "sinkage [mm]")


def _draw_side_force(axes: Axes, forces: Mapping[str, np.ndarray]) -> None:
    pressure = forces["pressure"] / 1e3
    names = [name for name in forces if name != "pressure"]
    for name, colour in zip(names, ("0.3", *_COLOURS), strict=False):
        axes.semilogx(pressure, forces[name], "--" if name == "rigid rim" else "-", color=colour, label=name)
    axes.set_ylim(bottom=0.0)
    _plain_ticks(axes.xaxis, (30, 100, 300, 1000))
    _finish(
        axes,
        "Side force at 10 degrees, sand, 3.4 kN",
        "soil's pressure at 5 cm [kPa]",
        "side force / load [-]",
    )


def _draw_effects(axes: Axes, effects: Sequence[Comparison]) -> None:
    for name, marker, colour in (("rut", "o", _COLOURS[0]), ("towed", "s", _COLOURS[1])):
        own = [one for one in effects if one.quantity.startswith(name)]
        label = {"rut": "rut (Maclaurin)", "towed": "towed resistance (Brixius)"}[name]
        axes.plot([o.published for o in own], [o.model for o in own], marker, color=colour, label=label)
    axes.plot([1.0, 1.8], [1.0, 1.8], color="0.5", lw=1, ls=":")
    axes.set(xlim=(1.0, 1.8), ylim=(1.0, 1.8))
    _finish(
        axes,
        "650 over 270 kPa, Goodyear tyre",
        "ratio by the published formula [-]",
        "ratio of the model [-]",
    )


def _draw_snow(axes: Axes, snow: Snow) -> None:
    axes.plot(snow.sinkage, snow.resistance, "o", color=_COLOURS[0], ms=4, label="measured (CRREL)")
    axes.plot(
        snow.model_sinkage, snow.model_resistance, "-", color=_COLOURS[3], label="model, catalogue snow"
    )
    axes.set(xlim=(0.0, None), ylim=(0.0, None))
    _finish(axes, "Snow: resistance of a towed wheel", "sinkage [m]", "resistance / load [-]")


def _draw_brush(axes: Axes) -> None:
    tyre, wheel = TYRES["mrzr"], make_wheel(r=0.33, b=0.212)
    degrees = np.linspace(0.0, 14.0, 29)
    f = hard_ground_deflection(tyre, _LOAD)
    stiffness = tread_stiffness(tyre, wheel.r, wheel.b, _LOAD, f) * wheel.b * 2.0 * wheel.r * f
    share = np.minimum(2.0 * stiffness * np.tan(np.radians(degrees)) / (3.0 * tyre.mu * _LOAD), 1.0)
    axes.plot(degrees, tyre.mu * (3 * share - 3 * share**2 + share**3), "k--", label="brush model")
    for pressure, colour in zip((1e6, 5e6, 5e7), _COLOURS, strict=False):
        soil = make_soil("clay", k_c=0.0, k_phi=pressure / 0.05, n=1.0, c=0.0, phi=math.radians(55.0))
        found = wheel_forces(
            soil, wheel, load=_LOAD, slip=0.0, slip_angle=np.radians(degrees), structure=STRUCTURE, tyre=tyre
        )
        axes.plot(degrees, -found.F_y / _LOAD, color=colour, label=f"soil, {pressure / 1e6:.0f} MPa at 5 cm")
    _finish(axes, "Firm ground, MRZR tyre, 3.4 kN", "slip angle [deg]", "side force / load [-]")
