"""Simulated drives with faults, logged for tests of the diagnosis.

The truth runs with another step than the model of the diagnosis, on soil whose n the log does not state, and
with the errors of sound sensors. The faults are in `library` and `unmodelled`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.faults.natural import natural_plant
from estimators.logs.config import StartSpec, TerrainSpec
from estimators.logs.log import Log
from estimators.logs.runs import config_of, log_of_drive, wave_rows
from offroad_env.physics.records import Ground, SoilMap
from offroad_env.simulation.drive import Faults, Timing, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, rough_terrain
from offroad_env.world.vehicles import VEHICLES

__all__ = ["TICK", "Case", "Faults", "draw_case", "simulated_log"]

#: Time over which a command is held [s].
TICK = 0.005
#: Another step of the integrator than the diagnosis takes.
_TIMING = Timing(tick=TICK, steps=2, sample_ticks=2, command_ticks=4)
_SOILS = ("dry_sand", "sandy_loam", "lete_sand", "rubicon_sandy_loam", "upland_sandy_loam")
#: Soil without patches.
_UNIFORM = SoilMap(0.3, np.empty((0, 4)))
#: Standard deviations of the errors of a sound IMU and of sound wheel speeds [m/s^2, rad/s, -].
ACCELERATION_BIAS, RATE_BIAS, WHEEL_SCALE = 0.02, 5e-4, 0.002


@dataclass(frozen=True, kw_only=True)
class Case:
    """A run without its faults."""

    seed: int
    soil: str
    n: float  #: true sinkage exponent; the log states the catalogue's [-]
    road: str  #: "flat", "known" or "unknown"
    gnss: bool
    duration: float = 60.0  #: [s]
    drive: str = "lively"  #: "lively"; "steady": straight on at one speed; "blind": open loop in speed
    accel_noise: float = 0.1  #: [m/s^2]
    gyro_noise: float = 0.01  #: [rad/s]
    natural: bool = False  #: numbers within their tolerances and soil that scatters, see `natural_plant`


def draw_case(
    seed: int,
    *,
    soil: str | None = None,
    n: float | None = None,
    road: str | None = None,
    gnss: bool | None = None,
    duration: float = 60.0,
    drive: str = "lively",
    natural: bool = False,
) -> Case:
    """A run drawn from its seed; fields that are given replace the drawn ones."""
    rng = np.random.default_rng([seed, 7])
    # All are drawn, in this order, whatever is given: a seed keeps its run.
    drawn_soil = str(rng.choice(_SOILS))
    drawn_n = float(SOILS[drawn_soil].n + rng.uniform(-0.08, 0.08))
    drawn_road = str(rng.choice(["flat", "known", "unknown"]))
    drawn_gnss = bool(rng.random() < 0.7)
    road = drawn_road if road is None else road
    gnss = drawn_gnss if gnss is None else gnss
    return Case(
        seed=seed,
        soil=drawn_soil if soil is None else soil,
        n=drawn_n if n is None else n,
        road=road,
        # A map of the bumps is of no use to a vehicle without a position.
        gnss=gnss or road == "known",
        duration=duration,
        drive=drive,
        accel_noise=float(rng.choice([0.05, 0.1, 0.2])),
        gyro_noise=float(rng.choice([0.003, 0.01, 0.0175])),
        natural=natural,
    )


class _Driver:
    """Follows a speed that changes every few seconds, with a sinusoidal steering."""

    def __init__(self, rng: np.random.Generator, case: Case) -> None:
        count = int(case.duration / 4.0) + 2
        steady = case.drive == "steady"
        self._targets = np.full(count, 4.0) if steady else rng.uniform(2.0, 7.0, count)
        self._amplitudes = rng.uniform(0.05, 0.2, 2) * (0.0 if steady else 1.0)
        self._frequencies, self._phases = rng.uniform(0.6, 2.5, 2), rng.uniform(0.0, 6.0, 2)
        self._wiggle = 0.0 if steady else 0.5
        self._blind = case.drive == "blind"

    def __call__(self, t: float, v: float) -> tuple[float, float, float]:
        vehicle = VEHICLES["mrzr"]
        error = self._targets[int(t / 4.0)] - v + self._wiggle * math.sin(1.3 * t)
        if self._blind:
            error = 1.7 + 2.7 * math.sin(2.5 * t)
        # Open loop, commands begin at zero: the actuators before the start do not matter.
        begun = min(t, 1.0) if self._blind else 1.0
        pedal = begun * min(max(0.25 + 0.35 * error, -0.5), 1.0)
        steer = begun * float(self._amplitudes @ np.sin(self._frequencies * t + self._phases))
        return steer, max(pedal, 0.0) * vehicle.drive_torque_max, max(-pedal, 0.0) * vehicle.brake_torque_max


def _ground(case: Case, rng: np.random.Generator) -> tuple[Ground, TerrainSpec]:
    if case.road == "flat":
        return flat(), TerrainSpec(kind="flat")
    ground = rough_terrain("A" if rng.random() < 0.5 else "B", rng)
    if case.road == "unknown":
        rms = float(np.sqrt(0.5 * np.sum(ground.waves[:, 0] ** 2)))
        return ground, TerrainSpec(kind="unknown", rms=rms)
    return ground, TerrainSpec(kind="waves", waves=wave_rows(ground))


def simulated_log(case: Case, faults: Faults | None = None, name: str = "run") -> Log:
    """Drive a case with faults, and log its sensors.

    Raises
    ------
    SolverFailure
        When the vehicle drowns.
    """
    rng = np.random.default_rng([case.seed, 11])
    ground, terrain = _ground(case, rng)
    believed = make_plant(VEHICLES["mrzr"], SOILS[case.soil], ground)
    truth = believed._replace(soil=make_soil(case.soil, n=case.n), soil_map=_UNIFORM)
    if case.natural:
        truth = natural_plant(truth, np.random.default_rng([case.seed, 13]))
    sensors = SensorSuite(
        imu=ImuConfig(
            accel_noise=case.accel_noise,
            gyro_noise=case.gyro_noise,
            accel_bias_sd=ACCELERATION_BIAS,
            gyro_bias_sd=RATE_BIAS,
        ),
        wheel=WheelSpeedConfig(scale_sd=WHEEL_SCALE),
        gnss=GnssConfig() if case.gnss else None,
    )
    sensors.reset(rng)
    config = config_of(believed, sensors, StartSpec(v_x=3.0))
    drive = simulate_drive(
        truth, _Driver(rng, case), sensors, faults=faults, duration=case.duration, timing=_TIMING
    )
    return log_of_drive(drive, replace(config, terrain=terrain, exact=not case.natural), name)
