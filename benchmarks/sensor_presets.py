"""One drive seen by the presets of the sensors, and what the log filters and the diagnosis make of each log.

python benchmarks/sensor_presets.py --figure docs/images/sensor_presets.png
python benchmarks/sensor_presets.py --logs FOLDER    # then: offroad estimate, offroad diagnose FOLDER/*.csv
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from estimators.logs import StartSpec, config_of, log_of_drive, write_log
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.drive import DriveRecord, simulate_drive
from offroad_env.simulation.sensor_presets import make_sensors
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import rough_terrain
from offroad_env.world.vehicles import VEHICLES

NAMES = ("ideal", "automotive", "consumer")
COLOURS = {"ideal": "#009E73", "automotive": "#0072B2", "consumer": "#D55E00"}  # Okabe & Ito
SEED, DURATION = 3, 40.0


def driver(t: float, v: float) -> tuple[float, float, float]:
    """Weave at a speed that rises and falls."""
    target = 5.0 + 1.5 * math.sin(0.35 * t)
    return 0.12 * math.sin(0.9 * t), float(np.clip(900.0 * (target - v) + 250.0, 0.0, 1500.0)), 0.0


def drives() -> dict[str, DriveRecord]:
    """The same drive, measured by each preset."""
    ground = rough_terrain("B", np.random.default_rng(1))
    plant = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=0.8), ground)
    return {name: simulate_drive(plant, driver, name, SEED, duration=DURATION, speed=5.0) for name in NAMES}


def draw(runs: dict[str, DriveRecord], file: Path) -> None:
    """Wheel speed, yaw rate, error of the position and vertical acceleration, against the truth."""
    figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.0), layout="constrained")
    (speed, yaw), (place, vertical) = axes
    truth = runs["ideal"]
    t, states = truth.t, truth.states
    window = (t >= 8.0) & (t <= 16.0)
    for name in reversed(NAMES):
        run, colour = runs[name], COLOURS[name]
        seen = window & np.isfinite(run.wheel[:, 1])
        speed.plot(t[seen], run.wheel[seen, 1], ".", ms=3, color=colour, label=name)
        yaw.plot(t[window], np.degrees(run.imu[window, 4]), lw=1.0, color=colour, label=name)
        vertical.plot(t[window], run.imu[window, 2] - GRAVITY, lw=0.8, color=colour, label=name)
        fixes = np.isfinite(run.gnss[:, 0])
        place.plot(t[fixes], run.gnss[fixes, 1] - states[fixes, at.Y], ".", ms=3, color=colour, label=name)
    dark = {"color": "black", "lw": 1.0, "label": "truth"}
    speed.plot(t[window], truth.readings[window, at.AXLE + at.R_OMEGA], **dark)
    yaw.plot(t[window], np.degrees(states[window, at.YAW_RATE]), **dark)
    place.axhline(0.0, **dark)
    vertical.plot(t[window], truth.readings[window, at.A_Z], **dark)
    for axis, title, label in (
        (speed, "speed of the rear rims", "r omega [m/s]"),
        (yaw, "yaw rate", "yaw rate [degrees/s]"),
        (vertical, "vertical specific force", "a_z - g [m/s$^2$]"),
        (place, "GNSS fixes of the whole drive, with latency", "error of Y [m]"),
    ):
        axis.set(title=title, xlabel="time [s]", ylabel=label)
    speed.legend(loc="upper right", framealpha=0.9, markerscale=2.0)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


def main() -> None:
    """Write the figure, or the logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--logs", type=Path)
    arguments = parser.parse_args()
    runs = drives()
    if arguments.figure:
        draw(runs, arguments.figure)
    if arguments.logs:
        arguments.logs.mkdir(parents=True, exist_ok=True)
        for name, run in runs.items():
            config = config_of(run.plant, make_sensors(name), StartSpec(v_x=5.0))
            write_log(arguments.logs / f"{name}.csv", log_of_drive(run, config, name))


if __name__ == "__main__":
    main()
