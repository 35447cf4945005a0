"""Vehicles that turn without steering, described as if they steered: ``python benchmarks/skid_steer.py``.

Simulates skid-steered robots of four wheels on firm to soft soils, gently and hard driven, and logs them with
a steering of zero and a vehicle of two axles; counts how often the checks of the data say that no model of
that kind can be right, and nothing else, before anything is fitted. The same logs without pitch and roll
gyros, without a receiver, with a yaw gyro and wheels alone, and with the speeds of both sides in place of the
steering. Bounds were set on the default seeds, and on those from 1000 and 5000 on.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import numpy as np

from estimators.discrepancy.data_quality import unusable
from estimators.logs import Log, log_from_run, quality, read_log, write_log
from estimators.logs.channel_checks import OUTSIDE
from estimators.logs.immobile_findings import IMMOBILE
from estimators.logs.signals import Windows
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.four_wheel import make_four_wheel
from offroad_env.world.four_wheel_vehicles import FOUR_WHEEL_VEHICLES, FourWheelVehicle
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, rough_terrain

#: Length of a drive, and its step [s].
DURATION, STEP = 40.0, 0.01
#: A robot that leans further has rolled over [rad].
UPSET = 1.0
GROUNDS = ("lete_sand", "sandy_loam", "michigan_sandy_loam", "upland_sandy_loam", "clay", "heavy_clay",
           "hanamoto_sandy_loam", "grenville_loam", "hard_ground")  # fmt: skip
_RECEIVER = ("x", "y", "speed", "course")
#: Channels that a log lacks, by what it is called.
WITHOUT: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "all channels": (),
        "without a pitch gyro": ("pitch_rate", "roll_rate"),
        "without a receiver": _RECEIVER,
        "a yaw gyro and wheels": (*_RECEIVER, "a_x", "a_y", "a_z", "pitch_rate", "roll_rate"),
    }
)
SENSORS = SensorSuite(
    imu=ImuConfig(accel_noise=0.05, gyro_noise=0.003, kind="specific_force"),
    wheel=WheelSpeedConfig(noise=0.01, scale_sd=0.0),
    gnss=GnssConfig(),
)


def robot(rng: np.random.Generator) -> FourWheelVehicle:
    """A skid-steered robot of 150 to 500 kg."""
    known, _ = FOUR_WHEEL_VEHICLES["warthog"]
    m, track = float(rng.uniform(150.0, 500.0)), float(rng.uniform(0.8, 1.3))
    scaled = ("I_z", "I_y", "k_f", "k_r", "c_f", "c_r", "drive_torque_max", "brake_torque_max")
    vehicle = known._replace(m=m, track=track, **{k: m / known.m * getattr(known, k) for k in scaled})
    return FourWheelVehicle(vehicle, make_four_wheel(vehicle, skid=1.0))


def drive(seed: int) -> tuple[Log, np.ndarray] | None:
    """A drive drawn by the seed and the speeds of its sides (T, 2) [rad/s]; None if it rolls or sinks."""
    rng = np.random.default_rng(seed)
    vehicle, four = robot(rng)
    t = STEP * np.arange(round(DURATION / STEP))
    phase, rate = rng.uniform(0.0, 2.0 * np.pi, (3, 1)), rng.uniform(0.2, 1.0, (3, 1))
    wave = np.sin(rate * t + phase)
    handle = rng.uniform(0.3, 1.0) * vehicle.steer_max * np.array([0.6, 0.4]) @ wave[:2]
    push = vehicle.drive_torque_max * rng.uniform(0.1, 0.25) * (1.0 + rng.uniform(0.2, 0.8) * wave[2])
    ground = flat() if rng.random() < 0.5 else rough_terrain("B", rng)
    soil = SOILS[str(rng.choice(GROUNDS))]
    plant = make_plant(vehicle, soil, ground, vehicle_model="four_wheel", four_wheel=four)
    commands = np.column_stack([handle, push, np.zeros(len(t))])
    try:
        state, warm = settled_state(plant, v_x=float(rng.uniform(0.5, 3.0)))
        run = simulate_commands(plant, state, warm, commands, interval=STEP)
    except OffroadError:
        return None
    if np.abs(run.states[:, at.ROLL]).max() > UPSET:
        return None
    log = log_from_run(run, plant, commands, SENSORS, rng)
    rims = run.readings[:, [at.WHEELS + i * at.AXLE + at.R_OMEGA for i in range(at.WHEEL_COUNT)]]
    sides = np.column_stack([rims[:, [0, 2]].mean(axis=1), rims[:, [1, 3]].mean(axis=1)]) / vehicle.r
    return replace(log, config=replace(log.config, four_wheel=None)), sides


def variants(log: Log, sides: np.ndarray) -> Iterator[tuple[str, Log]]:
    """The drive with a steering of zero and all channels or fewer, and with its sides in place of both."""
    straight = {**log.channels, "steer": np.zeros(len(log))}
    for name, missing in WITHOUT.items():
        yield name, replace(log, channels={k: v for k, v in straight.items() if k not in missing})
    with TemporaryDirectory() as folder:
        table = write_log(Path(folder) / "run.csv", log)
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
        for row, (left, right) in zip(rows, sides, strict=True):
            for name in ("steer", "omega_f", "omega_r"):
                del row[name]
            row |= {"omega_left": repr(float(left)), "omega_right": repr(float(right))}
        with table.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
        yield "speeds of both sides, no steering", read_log(table)


def said(log: Log) -> str:
    """Why nothing can be fitted: it turns without steering, is stuck, or its data have problems."""
    reasons = unusable([log], [quality(log)])
    if not reasons:
        return "nothing"
    kinds = {one.kind for one in reasons}
    if kinds in ({OUTSIDE}, {IMMOBILE}):
        return "outside the model" if kinds == {OUTSIDE} else "stuck"
    return "a data problem: " + ", ".join(sorted({f"{one.channel} {one.kind}" for one in reasons}))


def main() -> None:
    """Print all counts, and what else is said."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=40, help="drives on their wheels")
    parser.add_argument("--first", type=int, default=0, help="seed of the first drive")
    asked = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    seed, done = asked.first, 0
    while done < asked.drives:
        found = drive(seed)
        seed += 1
        if found is None:
            continue
        done += 1
        fastest = float(np.nanmax(np.abs(Windows(found[0]).mean("yaw_rate"))))
        for name, log in variants(*found):
            text = said(log)
            counts.setdefault(name, Counter())[text.split(":")[0]] += 1
            if text != "outside the model":
                print(f"drive {seed - 1}, turns at up to {fastest:.2g} rad/s, {name}: {text}")
    print(f"{done} drives; {seed - asked.first - done} more rolled over or sank in")
    for name, count in counts.items():
        print(f"{name}: {dict(count)}")


if __name__ == "__main__":
    main()
