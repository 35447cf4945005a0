"""A simulated slalom on sand and its log, for the tests of logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.logs import (
    Log,
)
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES

STEP = 0.01  # sample period of the simulated logs [s]
TRUE_N, BELIEVED_N = 0.937_251, 0.8


def plant_with(n: float, ground=None):
    soil = make_soil(SOILS["dry_sand"], n=n)
    return make_plant(VEHICLES["mrzr"], soil, flat() if ground is None else ground)


def sensors_for(**imu) -> SensorSuite:
    noise = {"accel_noise": 0.05, "gyro_noise": 0.003, "kind": "specific_force"} | imu
    return SensorSuite(
        imu=ImuConfig(**noise), wheel=WheelSpeedConfig(noise=0.01, scale_sd=0.0), gnss=GnssConfig()
    )


def slalom(duration: float = 24.0):
    """(trajectory, plant, commands) of a slalom with changing drive on sand."""
    plant = plant_with(TRUE_N, paper_terrain(0.02))
    t = STEP * np.arange(round(duration / STEP))
    drive = 1500.0 + 700.0 * np.sin(0.9 * t)
    commands = np.column_stack([0.15 * np.sin(1.3 * t), drive, np.zeros(len(t))])
    state, warm = settled_state(plant, v_x=4.0)
    return simulate_commands(plant, state, warm, commands, interval=STEP), plant, commands


def changed(log: Log, **channels: np.ndarray) -> Log:
    return replace(log, channels=log.channels | channels)


def same_columns(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return list(a) == list(b) and all(np.array_equal(a[k], b[k], equal_nan=True) for k in a)
