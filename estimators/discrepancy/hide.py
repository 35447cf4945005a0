"""Logs with something hidden in them, for tests of the finder.

What is hidden here is written a second time: as changes of the commands, of the records and of the state
between steps, never with the laws of `offroad_env.effects`. The truth also runs with another step than the
finder, on soil whose n the log does not state, and with sensors as imperfect as healthy ones are.
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
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import SoilMap
from offroad_env.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulator import Plant, make_plant, settled_state
from offroad_env.soils import SOILS, make_soil
from offroad_env.terrain import flat, rough_terrain
from offroad_env.vehicles import VEHICLES

__all__ = ["HIDERS", "STRANGERS", "Case", "Hidden", "draw_case", "hidden_log"]

#: Hider's tick, and steps of the plant in it: another step than the finder's [s].
_TICK, _STEPS = 0.005, 2
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
    drive: str = "lively"  #: "lively", or "steady": straight on at one speed
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

    def __call__(self, t: float, v: float) -> tuple[float, float, float]:
        vehicle = VEHICLES["mrzr"]
        error = self._targets[int(t / 4.0)] - v + self._wiggle * math.sin(1.3 * t)
        pedal = min(max(0.25 + 0.35 * error, -0.5), 1.0)
        steer = float(self._amplitudes @ np.sin(self._frequencies * t + self._phases))
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
    recorder = Recorder(replace(config, terrain=terrain), period=_TICK * _SAMPLE)
    _drive(case, truth, hidden, (_Driver(rng, case), sensors, recorder))
    return recorder.log(name)


def _drive(case: Case, plant: Plant, hidden: Hidden, parts: tuple) -> None:
    driver, sensors, recorder = parts
    x, warm = settled_state(plant, v_x=3.0)
    readings, past = np.zeros(at.READINGS_SIZE), []
    full_advance(x, warm, (0.0, 0.0, 0.0), plant, _TICK, 0, readings)
    recorder.start(_sample(x, readings, sensors, hidden))
    command, pending = (0.0, 0.0, 0.0), []
    for tick in range(round(case.duration / _TICK)):
        if tick % _COMMAND == 0:
            if pending:
                recorder.hold(command, np.array(pending))
            command, pending = driver(tick * _TICK, float(x[at.V_X])), []
        past.append(command)
        if hidden.step is not None:
            plant = hidden.step(x, readings, plant)
        status = full_advance(x, warm, hidden.command(past), plant, _TICK / _STEPS, _STEPS, readings)
        if hidden.feel is not None:
            hidden.feel(x, readings, plant)
        if status >= SUNK:
            raise SolverFailure(f"the hidden run {case.seed} drowns at {tick * _TICK:.2f} s")
        if (tick + 1) % _SAMPLE == 0:
            pending.append(_sample(x, readings, sensors, hidden))
    recorder.hold(command, np.array(pending))


def _sample(x, readings, sensors: SensorSuite, hidden: Hidden) -> np.ndarray:
    sample = np.concatenate(sensors.sample(x, readings)[:3])
    hidden.sample(sample)
    return sample


# ------------------------------------------------------------------ what can be hidden


def _late(delay: float) -> Hidden:
    ticks = round(delay / _TICK)

    def command(past):
        return (past[max(len(past) - 1 - ticks, 0)][0], *past[-1][1:])

    return Hidden(command=command)


def _lagging(time: float) -> Hidden:
    held = []

    def command(past):
        if not held:
            held.append(past[-1][0])
        held[0] += (past[-1][0] - held[0]) * (1.0 - math.exp(-_TICK / time))
        return (held[0], *past[-1][1:])

    return Hidden(command=command)


def _turned(angle: float) -> Hidden:
    return Hidden(command=lambda past: (past[-1][0] + angle, *past[-1][1:]))


def _laden(share: float) -> Hidden:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        load = 1.0 + share
        return plant._replace(vehicle=v._replace(m=v.m * load, I_z=v.I_z * load, I_y=v.I_y * load))

    return Hidden(plant=plant)


def _pushed(force: Callable[[np.ndarray, Plant], tuple[float, float, float]]) -> Hidden:
    """A force on the body (forward, left [N], moment [N m]): kicks, and what the IMU feels of it."""

    def step(x, readings, plant):
        F_x, F_y, M_z = force(x, plant)
        m, I_z = plant.vehicle.m, plant.vehicle.I_z
        x[at.V_X] += F_x / m * _TICK
        x[at.V_Y] += F_y / m * _TICK
        x[at.YAW_RATE] += M_z / I_z * _TICK
        return plant

    def feel(x, readings, plant):
        F_x, F_y, M_z = force(x, plant)
        readings[at.A_X] += F_x / plant.vehicle.m
        readings[at.A_Y] += F_y / plant.vehicle.m
        readings[at.YAW_ACC] += M_z / plant.vehicle.I_z

    return Hidden(step=step, feel=feel)


def _dragging(area: float) -> Hidden:
    def plant(plant: Plant) -> Plant:
        v = plant.vehicle
        return plant._replace(vehicle=v._replace(drag_area=v.drag_area + area))

    return Hidden(plant=plant)


def _resisting(share: float) -> Hidden:
    def force(x, plant):
        held = math.copysign(min(abs(x[at.V_X]) / 0.2, 1.0), x[at.V_X])
        return -share * plant.vehicle.m * GRAVITY * held, 0.0, 0.0

    return _pushed(force)


def _slipping(slope: float) -> Hidden:
    """Under each axle a disc of soil that moves with it, with the n that its slip makes."""
    base: list[float] = []

    def step(x, readings, plant):
        if not base:
            base.append(plant.soil.n)
        discs = np.empty((2, 4))
        for i, axle in enumerate((readings[: at.AXLE], readings[at.AXLE : at.MOTION])):
            n = base[0] + slope * (math.hypot(axle[at.SLIP], 1e-2) - 1e-2)
            discs[i] = (axle[at.WHEEL_X], axle[at.WHEEL_Y], 0.5, n)
        return plant._replace(soil_map=SoilMap(0.3, discs))

    return Hidden(step=step)


def _bordered(step: float) -> Hidden:
    """Half of the world is a disc so large that its rim is a straight border."""

    def plant(plant: Plant) -> Plant:
        radius, border = 2000.0, 35.0
        disc = np.array([[border + radius, 0.0, radius, plant.soil.n + step]])
        return plant._replace(soil_map=SoilMap(1.0, disc))

    return Hidden(plant=plant)


def _biased(channel: int) -> Callable[[float], Hidden]:
    def make(bias: float) -> Hidden:
        def sample(sample: np.ndarray) -> None:
            sample[channel] += bias

        return Hidden(sample=sample)

    return make


#: Effect -> how to hide it, from its size. None of these uses the finder's own laws.
HIDERS: dict[str, Callable[[float], Hidden]] = {
    "steer_delay": _late,
    "steer_lag": _lagging,
    "steer_offset": _turned,
    "payload": _laden,
    "rolling_resistance": _resisting,
    "aero_drag": _dragging,
    "slip_sinkage": _slipping,
    "n_step": _bordered,
    "gyro_bias_yaw": _biased(4),
    "accel_bias_y": _biased(1),
}


# ------------------------------------------------------------------ what no library holds


def _overgrown(share: float) -> Hidden:
    """A patch of scrub that brakes whoever drives through it."""

    def force(x, plant):
        inside = 0.5 * (math.tanh((x[at.X] - 40.0) / 2.0) - math.tanh((x[at.X] - 70.0) / 2.0))
        return -share * plant.vehicle.m * GRAVITY * inside, 0.0, 0.0

    return _pushed(force)


def _roped(share: float) -> Hidden:
    """A rope to a post that pulls the more, the further the vehicle goes."""

    def force(x, plant):
        away = max(x[at.X] - 20.0, 0.0) / 50.0
        pull = -share * plant.vehicle.m * GRAVITY * away
        return pull * math.cos(x[at.YAW]), -pull * math.sin(x[at.YAW]), 0.0

    return _pushed(force)


def _blown(share: float) -> Hidden:
    """A side wind in gusts, behind the centre of gravity."""
    time = [0.0]

    def force(x, plant):
        time[0] += 0.5 * _TICK  # asked twice a tick
        push = share * plant.vehicle.m * GRAVITY * math.sin(0.7 * time[0]) ** 2
        return push * math.sin(x[at.YAW]), push * math.cos(x[at.YAW]), -0.5 * push * math.cos(x[at.YAW])

    return _pushed(force)


def _engine(share: float) -> Hidden:
    """An engine that brakes when nobody asks it to drive."""

    def force(x, plant):
        idle = 1.0 - math.tanh(max(x[at.DRIVE], 0.0) / 600.0)
        return -share * plant.vehicle.m * GRAVITY * idle, 0.0, 0.0

    return _pushed(force)


#: Forces for which the library has no name, by their size as a share of the weight.
STRANGERS: dict[str, Callable[[float], Hidden]] = {
    "vegetation": _overgrown,
    "tow_rope": _roped,
    "side_wind": _blown,
    "engine_braking": _engine,
}
