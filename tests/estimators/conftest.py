"""A vehicle to estimate from: the full model driven at random, seen through its sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from offroad_env.physics import state as at
from offroad_env.physics.ground import sinkage_exponent
from offroad_env.physics.records import Ground, SoilMap
from offroad_env.simulation.drive import simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import rough_terrain, soil_map
from offroad_env.world.vehicles import VEHICLES

PERIOD = 0.01  # of a sensor sample [s]


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A recorded drive; row k was measured at t = k PERIOD, and ``commands[k]`` came before it."""

    n: float
    states: np.ndarray  # (T, 15) truth
    commands: np.ndarray  # (T, 3)
    imu: np.ndarray  # (T, 5)
    wheel: np.ndarray  # (T, 2)
    gnss: np.ndarray  # (T, 4)

    def samples(self):
        """(command, imu, rim speeds, gnss) of every row but the start."""
        for k in range(1, len(self.imu)):
            command = tuple(float(value) for value in self.commands[k])
            yield command, self.imu[k], self.wheel[k], self.gnss[k]


class Driver:
    """Chases a random speed and swings the steering: excites whatever there is to learn."""

    def __init__(self, rng: np.random.Generator, duration: float) -> None:
        self.targets = rng.uniform(2.0, 7.0, int(duration / 4.0) + 2)
        self.amplitudes = rng.uniform(0.05, 0.2, 2)
        self.frequencies = rng.uniform(0.6, 2.5, 2)
        self.phases = rng.uniform(0.0, 6.0, 2)

    def __call__(self, t: float, v: float) -> tuple[float, float, float]:
        vehicle = VEHICLES["mrzr"]
        error = self.targets[int(t / 4.0)] - v + 0.5 * np.sin(1.3 * t)
        pedal = float(np.clip(0.25 + 0.35 * error, -0.5, 1.0))
        steer = float(self.amplitudes @ np.sin(self.frequencies * t + self.phases))
        return steer, max(pedal, 0.0) * vehicle.drive_torque_max, max(-pedal, 0.0) * vehicle.brake_torque_max


def record(
    n: float,
    *,
    seed: int,
    soil: str = "dry_sand",
    duration: float = 10.0,
    driver=None,
    ground: Ground | None = None,
    unit: ImuConfig | GnssConfig | None = None,
    soils: SoilMap | None = None,
) -> Drive:
    """Drive the full model on rough ground (class B unless given) and record what the sensors say.

    ``unit`` takes the place of the inertial unit or of the receiver.
    """
    rng = np.random.default_rng(seed)
    ground = rough_terrain("B", rng) if ground is None else ground
    driver = driver or Driver(rng, duration)
    imu = unit if isinstance(unit, ImuConfig) else ImuConfig()
    gnss = unit if isinstance(unit, GnssConfig) else GnssConfig()
    sensors = SensorSuite(imu=imu, wheel=WheelSpeedConfig(), gnss=gnss)
    sensors.reset(rng)
    plant = make_plant(VEHICLES["mrzr"], make_soil(soil, n=n), ground, soil_map=soils or soil_map())
    run = simulate_drive(plant, driver, sensors, duration=duration)
    return Drive(n=n, states=run.states, commands=run.commands, imu=run.imu, wheel=run.wheel, gnss=run.gnss)


@pytest.fixture(scope="session")
def drive():
    """``drive(n, seed=...)`` records a random drive of the full model, see `record`."""
    return record


#: Exponents before and after the edge of a soil, which the random driver reaches after some 10 s.
_EDGES = ((0.8, 1.0), (0.8, 0.5), (0.5, 0.8), (1.0, 0.7))


@pytest.fixture(scope="session")
def edge_drives():
    """(true n under the centre of gravity, `Drive`) of drives from one soil into another."""
    found = []
    for seed, (before, after) in enumerate(_EDGES, start=500):
        beyond = soil_map([(1040.0, 0.0, 1000.0, after)], 0.3)
        drive = record(before, seed=seed, duration=20.0, soils=beyond)
        truth = np.array([sinkage_exponent(beyond, before, x[at.X], x[at.Y]) for x in drive.states[1:]])
        found.append((truth, drive))
    return found
