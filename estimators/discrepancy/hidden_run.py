"""Drives with something hidden in them, logged for tests of the finder.

The truth runs with another step than the finder, on soil whose n the log does not state, and with sensors as
imperfect as healthy ones are. What is hidden is in `hide`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.logs.config import StartSpec, TerrainSpec
from estimators.logs.log import Log
from estimators.logs.runs import Recorder, config_of
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import full_advance
from offroad_env.physics.records import SoilMap
from offroad_env.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulator import Plant, make_plant, settled_state
from offroad_env.soils import SOILS, make_soil
from offroad_env.terrain import flat, rough_terrain
from offroad_env.vehicles import VEHICLES

__all__ = ["TICK", "Case", "Hidden", "draw_case", "hidden_log"]

#: Hider's tick, and steps of the plant in it: another step than the finder's [s].
TICK, _STEPS = 0.005, 2
#: Parts of a tick between which forces kick the vehicle: a wheel's spin settles in milliseconds.
_KICKS = 5
#: Ticks of a sensor sample, and of a command.
_SAMPLE, _COMMAND = 2, 4
_SOILS = ("dry_sand", "sandy_loam", "lete_sand", "rubicon_sandy_loam", "upland_sandy_loam")
#: What a healthy IMU and healthy wheel speeds may be off by [m/s^2, rad/s, -].
HEALTHY_ACCELERATION, HEALTHY_RATE, HEALTHY_WHEEL = 0.02, 5e-4, 0.002


@dataclass(frozen=True, kw_only=True)
class Case:
    """Everything of a run but what is hidden in it."""

    seed: int
    soil: str
    n: float  #: true sinkage exponent; the log states the catalogue's [-]
    road: str  #: "flat", "known" or "unknown"
    scatter: float  #: standard deviation of n over the ground [-]
    gnss: bool
    duration: float = 60.0  #: [s]
    drive: str = (
        "lively"  #: "lively"; "steady": straight on at one speed; "blind": pedal without a look at the speed
    )
    accel_noise: float = 0.1  #: [m/s^2]
    gyro_noise: float = 0.01  #: [rad/s]


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """What is wrong, by what it does; every part may be left out."""

    plant: Callable[[Plant], Plant] = field(default=lambda plant: plant)
    command: Callable[[list[tuple[float, float, float]]], tuple[float, float, float]] = field(
        default=lambda past: past[-1]
    )  #: what acts, from all logged commands so far, one a tick
    step: Callable[[np.ndarray, np.ndarray, Plant], Plant] | None = None  #: state, readings -> plant
    kick: Callable[[np.ndarray, np.ndarray, Plant, float], None] | None = (
        None  #: of so many seconds, in place
    )
    feel: Callable[[np.ndarray, np.ndarray, Plant], None] | None = None  #: adds to the readings after a step
    sample: Callable[[np.ndarray], None] = field(default=lambda sample: None)  #: what sensors say, in place


def draw_case(seed: int, **fixed) -> Case:
    """A run drawn from its seed; ``fixed`` sets fields of it."""
    rng = np.random.default_rng([seed, 7])
    soil = str(rng.choice(_SOILS))
    values = {
        "soil": soil,
        "n": float(SOILS[soil].n + rng.uniform(-0.08, 0.08)),
        "road": str(rng.choice(["flat", "known", "unknown"])),
        "scatter": 0.0,
        "gnss": bool(rng.random() < 0.7),
        "accel_noise": float(rng.choice([0.05, 0.1, 0.2])),
        "gyro_noise": float(rng.choice([0.003, 0.01, 0.0175])),
    }
    values |= fixed
    # A map of the bumps is worth nothing to a vehicle that does not know where it is.
    values["gnss"] = bool(values["gnss"] or values["road"] == "known")
    return Case(seed=seed, **values)


class _Driver:
    """Chases a speed that changes every few seconds and swings the steering."""

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
        # The blind one begins with nothing, so that it does not matter what the actuators did before.
        begun = min(t, 1.0) if self._blind else 1.0
        pedal = begun * min(max(0.25 + 0.35 * error, -0.5), 1.0)
        steer = begun * float(self._amplitudes @ np.sin(self._frequencies * t + self._phases))
        return steer, max(pedal, 0.0) * vehicle.drive_torque_max, max(-pedal, 0.0) * vehicle.brake_torque_max


def _ground(case: Case, rng: np.random.Generator):
    if case.road == "flat":
        return flat(), TerrainSpec(kind="flat")
    ground = rough_terrain("A" if rng.random() < 0.5 else "B", rng)
    if case.road == "unknown":
        rms = float(np.sqrt(0.5 * np.sum(ground.waves[:, 0] ** 2)))
        return ground, TerrainSpec(kind="unknown", rms=rms)
    rows = tuple(tuple(float(value) for value in row) for row in ground.waves)
    return ground, TerrainSpec(kind="waves", waves=rows)


def _scatter(case: Case, rng: np.random.Generator) -> SoilMap:
    if case.scatter == 0.0:
        return SoilMap(0.3, np.empty((0, 4)))
    rows = [
        (rng.uniform(-50.0, 400.0), rng.uniform(-150.0, 150.0), rng.uniform(5.0, 20.0), n)
        for n in rng.normal(case.n, case.scatter, 400)
    ]
    return SoilMap(2.0, np.array(rows))


def hidden_log(case: Case, hidden: Hidden | None = None, name: str = "run") -> Log:
    """Drive the case with what is hidden, and log what its sensors say.

    Raises
    ------
    SolverFailure
        When the vehicle drowns.
    """
    hidden = hidden or Hidden()
    rng = np.random.default_rng([case.seed, 11])
    ground, terrain = _ground(case, rng)
    believed = make_plant(VEHICLES["mrzr"], SOILS[case.soil], ground)
    truth = believed._replace(soil=make_soil(case.soil, n=case.n), soil_map=_scatter(case, rng))
    truth = hidden.plant(truth)
    sensors = SensorSuite(
        imu=ImuConfig(
            accel_noise=case.accel_noise,
            gyro_noise=case.gyro_noise,
            accel_bias_sd=HEALTHY_ACCELERATION,
            gyro_bias_sd=HEALTHY_RATE,
        ),
        wheel=WheelSpeedConfig(scale_sd=HEALTHY_WHEEL),
        gnss=GnssConfig() if case.gnss else None,
    )
    sensors.reset(rng)
    config = config_of(believed, sensors, StartSpec(v_x=3.0))
    recorder = Recorder(replace(config, terrain=terrain), period=TICK * _SAMPLE)
    _drive(case, truth, hidden, (_Driver(rng, case), sensors, recorder))
    return recorder.log(name)


def _drive(case: Case, plant: Plant, hidden: Hidden, parts: tuple) -> None:
    driver, sensors, recorder = parts
    x, warm = settled_state(plant, v_x=3.0)
    readings, past = np.zeros(at.READINGS_SIZE), []
    full_advance(x, warm, (0.0, 0.0, 0.0), plant, TICK, 0, readings)
    recorder.start(_sample(x, readings, sensors, hidden))
    command, pending = (0.0, 0.0, 0.0), []
    for tick in range(round(case.duration / TICK)):
        if tick % _COMMAND == 0:
            if pending:
                recorder.hold(command, np.array(pending))
            command, pending = driver(tick * TICK, float(x[at.V_X])), []
        past.append(command)
        if hidden.step is not None:
            plant = hidden.step(x, readings, plant)
        status = _advance((x, warm), hidden.command(past), plant, hidden, readings)
        if hidden.feel is not None:
            hidden.feel(x, readings, plant)
        if status >= SUNK:
            raise SolverFailure(f"the hidden run {case.seed} drowns at {tick * TICK:.2f} s")
        if (tick + 1) % _SAMPLE == 0:
            pending.append(_sample(x, readings, sensors, hidden))
    recorder.hold(command, np.array(pending))


def _advance(start: tuple, command: tuple, plant: Plant, hidden: Hidden, readings: np.ndarray) -> float:
    """One tick; kicks come half before and half after each part, so that what is read lies between."""
    x, warm = start
    if hidden.kick is None:
        return full_advance(x, warm, command, plant, TICK / _STEPS, _STEPS, readings)
    worst, part = 0.0, TICK / _KICKS
    for _ in range(_KICKS):
        hidden.kick(x, readings, plant, 0.5 * part)
        worst = max(worst, full_advance(x, warm, command, plant, part, 1, readings))
        hidden.kick(x, readings, plant, 0.5 * part)
    return max(worst, full_advance(x, warm, command, plant, part, 0, readings))


def _sample(x, readings, sensors: SensorSuite, hidden: Hidden) -> np.ndarray:
    sample = np.concatenate(sensors.sample(x, readings)[:3])
    hidden.sample(sample)
    return sample
