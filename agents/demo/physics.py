"""Physics alone: one wheel, half-car against bicycle, and paths over the sinkage exponent."""

from __future__ import annotations

import numpy as np

from agents.demo.context import Run
from agents.reports.figures.forward import exponent_figure, forces_figure, motion_figure
from agents.reports.figures.soil import soil_figure
from agents.reports.page import Section, Table, figure_picture
from agents.reports.soil_curves import soil_curves
from estimators.experiments.buzhardt_tallapragada import exponent_sweep, forward_comparison
from offroad_env.physics import state as at
from offroad_env.world.soils import SOILS
from offroad_env.world.vehicles import VEHICLES, make_wheel

__all__ = ["exponent_section", "forward_section", "soil_section"]

#: What the paper reports for its forward comparison (Buzhardt & Tallapragada, ACC 2021, section II-C) [m].
_PAPER_DIFFERENCE = 15.0


def soil_section(run: Run) -> Section:
    """Force and sinkage curves of the soil that the scenarios are driven on."""
    name, vehicle = "dry_sand", VEHICLES["mrzr"]
    wheel = make_wheel(r=vehicle.r, b=vehicle.b)
    curves = soil_curves(SOILS[name], wheel, loads=(1000.0, 2000.0, 3500.0))
    sinkage, pull = 1e3 * curves.over_slip["sinkage"][-1], curves.over_slip["drawbar"][-1] / 1e3
    rolling, best = int(np.argmin(np.abs(curves.slip_axis))), int(np.nanargmax(pull))
    sees = (
        f"A wheel of {vehicle.r:g} m radius under {curves.loads[-1] / 1e3:g} kN sinks "
        f"{sinkage[rolling]:.0f} mm into dry sand when it rolls without slip, {sinkage[-1]:.0f} mm when it "
        f"spins on the spot, and pulls most, {pull[best]:.2f} kN, at slip {curves.slip_axis[best]:.2f}."
    )
    entry = SOILS.entry(name)
    figure = soil_figure(curves, title=f"{entry.title}, n = {entry.record.n:g}")
    return Section(
        name="soil",
        title="One wheel on soil",
        sees=sees,
        command=f"offroad soil {name}",
        pictures=(figure_picture(figure, "Sinkage, drawbar pull and side force, over slip and over load."),),
        notes=(f"Soil: {entry.source}.",),
        data={"source": entry.source, "curves": curves},
    )


def forward_section(run: Run) -> Section:
    """The paper's forward comparison of half-car and bicycle."""
    duration = run.settings.duration
    result = forward_comparison(duration=duration)
    load = result.half_car.readings[:, at.N] / 1e3
    steady = result.bicycle.readings[0, at.N] / 1e3
    speed = result.half_car.states[:, at.V_X]
    largest, end = result.largest_distance, float(result.distance[-1])
    sees = (
        f"Under the same force and steering the front axle load of the half-car swings between "
        f"{load.min():.1f} and {load.max():.1f} kN around the bicycle's constant {steady:.1f} kN, and within "
        f"{duration:g} s the two vehicles come up to {largest:.2f} m apart; the paper reports up to "
        f"{_PAPER_DIFFERENCE:g} m."
    )
    rows = (
        (f"largest distance in {duration:g} s", f"{largest:.3f} m", f"up to {_PAPER_DIFFERENCE:g} m (50 s)"),
        ("distance at the end", f"{end:.3f} m", "not given"),
        ("speed of the half-car", f"{speed.min():.1f} ... {speed.max():.1f} m/s", "not given"),
        ("front axle load of the half-car", f"{load.min():.2f} ... {load.max():.2f} kN", "not given"),
    )
    return Section(
        name="forward",
        title="Half-car against bicycle",
        sees=sees,
        command="offroad demo --only forward",
        pictures=(
            figure_picture(forces_figure(result), "Wheel forces of both models on clay, per axle."),
            figure_picture(motion_figure(result), "Ground, heave and pitch; paths, and how far apart."),
        ),
        tables=(Table(heading=("", "here", "paper"), rows=rows),),
        notes=(
            "The paper prints neither its vehicle nor speed and slip, on which the difference depends; what "
            "was chosen instead stands, with reasons, in offroad_env/world/vehicles.py and "
            "estimators/experiments/buzhardt_tallapragada.py.",
        ),
        key=(
            (
                f"Largest half-car/bicycle difference in {duration:g} s",
                f"{largest:.2f} m (paper: up to {_PAPER_DIFFERENCE:g} m)",
            ),
        ),
        data={
            "largest_distance": largest,
            "paper_largest_distance": _PAPER_DIFFERENCE,
            "end_distance": end,
            "speed_range": [speed.min(), speed.max()],
            "front_load_range": [1e3 * load.min(), 1e3 * load.max()],
        },
    )


def exponent_section(run: Run) -> Section:
    """Paths of vehicles whose soils differ in n, under the same speed and under the same force."""
    duration = run.settings.duration
    sweeps = {mode: exponent_sweep(mode=mode, duration=duration) for mode in ("speed", "force")}
    spread = {mode: sweep.spread for mode, sweep in sweeps.items()}
    ends = {mode: sweep.paths[:, -1] for mode, sweep in sweeps.items()}
    exponents = sweeps["speed"].n
    span = f"n = {exponents[0]:g} ... {exponents[-1]:g}"
    sees = (
        f"Vehicles that differ in the soil's exponent alone, {span}, end up to {spread['speed']:.1f} m apart "
        f"after {duration:g} s at the same speed, and {spread['force']:.1f} m under the same force."
    )
    rows = tuple(
        (f"{n:g}", *(f"{value:.1f}" for places in ends.values() for value in places[i]))
        for i, n in enumerate(exponents)
    )
    heading = ("n [-]", "X, same speed [m]", "Y, same speed [m]", "X, same force [m]", "Y, same force [m]")
    figure = exponent_figure(*sweeps.values())
    return Section(
        name="exponent",
        title="What the exponent n does to a path",
        sees=sees,
        command="offroad demo --only exponent",
        pictures=(figure_picture(figure, "Half-car on clay, same steering; dots are the end points."),),
        tables=(Table(heading=heading, rows=rows),),
        key=(
            (f"Spread of end points, {span}, same speed", f"{spread['speed']:.1f} m"),
            (f"Spread of end points, {span}, same force", f"{spread['force']:.1f} m"),
        ),
        data={"n": exponents, "spread": spread, "ends": ends},
    )
