"""A vehicle driven by a rule while its sensors sample it: the loop of every simulated drive.

The truth moves on tick by tick; the driver is asked at its own rate and sees time and speed only; the
sensors sample at theirs. `Faults` change the drive from outside: plant, commands, forces, readings, samples.

Three kinds of loop are not this one. The environment's control period is compiled for any number of episodes
(`offroad_env.environment.control_period`). The rows of the paper's table draw process noise at every step, in
the filters' own state (`estimators.experiments.simulated_rows`, `model_mismatch`). Runs under given commands
have no driver and no sensors (`offroad_env.simulation.simulator`, `fleet`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.axle import soil_at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.ground import sinkage_exponent
from offroad_env.physics.imu import GNSS, IMU, WHEEL
from offroad_env.simulation.sensor_presets import make_sensors
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.simulation.simulator import FULL_STEP, Plant, plant_model, settled_state

__all__ = ["Command", "DriveRecord", "Driver", "Faults", "Timing", "simulate_drive"]

#: Steering [rad], drive torque [N m], brake torque [N m].
Command = tuple[float, float, float]
#: (time [s], forward speed [m/s]) -> command.
Driver = Callable[[float, float], Command]

#: Parts of a tick between which the forces of a fault act: a wheel's spin settles in milliseconds.
_PARTS = 5
#: Accelerations of the body among the readings.
_MOTION = [at.A_X, at.A_Y, at.A_Z, at.YAW_ACC, at.PITCH_ACC]


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Rates of a drive; the defaults are those of the environment.

    Raises
    ------
    InvalidParameter
        When a time or a count is not positive.
    """

    tick: float = 2.0 * FULL_STEP  #: time over which what acts is held [s]
    steps: int = 2  #: steps of the integrator in a tick
    sample_ticks: int = 1  #: ticks from one sample of the sensors to the next
    command_ticks: int = 2  #: ticks from one command to the next

    def __post_init__(self) -> None:
        for name in ("tick", "steps", "sample_ticks", "command_ticks"):
            if not getattr(self, name) > 0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")

    @property
    def period(self) -> float:
        """Time between samples of the sensors [s]."""
        return self.tick * self.sample_ticks


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What departs from the plant in a drive, by what it does; every part may be left out."""

    plant: Callable[[Plant], Plant] = field(default=lambda plant: plant)  #: before the start
    command: Callable[[list[Command]], Command] = field(
        default=lambda past: past[-1]
    )  #: what acts, from the commands so far, one a tick
    step: Callable[[np.ndarray, np.ndarray, Plant], Plant] | None = (
        None  #: (state, readings, plant) -> plant of the next tick
    )
    kick: Callable[[np.ndarray, np.ndarray, Plant, float], None] | None = (
        None  #: (state, readings, plant, seconds): forces on the state in place, for so long
    )
    feel: Callable[[np.ndarray, np.ndarray, Plant], None] | None = (
        None  #: (state, readings, plant) after a tick: adds to the readings, in place
    )
    sample: Callable[[np.ndarray], None] = field(
        default=lambda sample: None
    )  #: errors of the sensors, on a sample (CHANNELS,) in place


@dataclass(frozen=True, kw_only=True)
class DriveRecord:
    """A drive; row k was sampled at ``t[k]``, and ``commands[k]`` was held before it."""

    plant: Plant  #: truth at the start
    timing: Timing
    t: np.ndarray  #: (T,) [s]
    commands: np.ndarray  #: (T, 3) steering [rad], drive, brake torque [N m]; the first row is zero
    samples: np.ndarray  #: (T, 11) measurements, channels of `offroad_env.physics.imu`; NaN between samples
    states: np.ndarray  #: (T, 15) truth, with four wheels (T, 19), see `offroad_env.physics.state`
    readings: np.ndarray  #: (T, 32) truth, with four wheels (T, 85), see `offroad_env.physics.state`

    @property
    def imu(self) -> np.ndarray:
        """(T, 5) a_x, a_y, a_z [m/s^2], pitch rate, yaw rate [rad/s]."""
        return self.samples[:, IMU]

    @property
    def wheel(self) -> np.ndarray:
        """(T, 2) front and rear wheel speed r omega [m/s]."""
        return self.samples[:, WHEEL]

    @property
    def gnss(self) -> np.ndarray:
        """(T, 4) X, Y [m], speed [m/s], course [rad]."""
        return self.samples[:, GNSS]

    @cached_property
    def n(self) -> np.ndarray:
        """(T,) true sinkage exponent under the centre of gravity [-]."""
        if self.plant.soil_field is not None:
            return np.array([soil_at(self.plant, x[at.X], x[at.Y]).n for x in self.states])
        soil_map, n = self.plant.soil_map, self.plant.soil.n
        return np.array([sinkage_exponent(soil_map, n, x[at.X], x[at.Y]) for x in self.states])


def simulate_drive(
    plant: Plant,
    driver: Driver,
    sensors: SensorSuite | str,
    seed: int | np.random.Generator | None = None,
    faults: Faults | None = None,
    *,
    duration: float,
    speed: float = 3.0,
    timing: Timing | None = None,
) -> DriveRecord:
    """Drive a vehicle of the full model, settled on its soil at the start, and record what is measured.

    Parameters
    ----------
    plant
        The true vehicle, soil and ground.
    driver
        Asked every `Timing.command_ticks` ticks for the command that is held until the next.
    sensors
        From `make_sensors`, or a name in `SENSORS`. Their period must be that of ``timing``.
    seed
        Of the sensors' errors, or the Generator that they take one number from; None where the caller has
        reset the sensors already.
    faults
        What departs from ``plant``.
    duration
        Of the record [s].
    speed
        At the start [m/s].
    timing
        Default: 100 samples and 50 commands a second.

    Raises
    ------
    InvalidParameter
        For a plant of the paper's model, or sensors of another period.
    SolverFailure
        When the vehicle leaves the range of the model, with the time it happened.
    """
    timing, faults = timing or Timing(), faults or Faults()
    sensors = make_sensors(sensors) if isinstance(sensors, str) else sensors
    _check(plant, sensors, timing)
    if seed is not None:
        sensors.reset(np.random.default_rng(seed), radius=plant.vehicle.r)
    truth = plant = faults.plant(plant)
    state, warm = settled_state(plant, v_x=speed)
    command, readings = (0.0, 0.0, 0.0), np.zeros(at.sizes(plant.four_wheel)[1])
    full_advance(state, warm, command, plant, timing.tick, 0, readings)
    past: list[Command] = []
    rows = [(command, _sample(state, readings, sensors, faults), state.copy(), readings.copy())]
    for tick in range(round(duration / timing.tick)):
        if tick % timing.command_ticks == 0:
            command = driver(tick * timing.tick, float(state[at.V_X]))
        past.append(command)
        if faults.step is not None:
            plant = faults.step(state, readings, plant)
        status = _advance(state, warm, faults.command(past), plant, readings, timing, faults)
        if faults.feel is not None:
            faults.feel(state, readings, plant)
        if status >= SUNK or not np.isfinite(state).all():
            when = (tick + 1) * timing.tick
            raise SolverFailure(f"the drive failed at t = {when:.2f} s (contact status {status:g})")
        if (tick + 1) % timing.sample_ticks == 0:
            rows.append((command, _sample(state, readings, sensors, faults), state.copy(), readings.copy()))
    commands, samples, states, seen = (np.array(column) for column in zip(*rows, strict=True))
    t = timing.period * np.arange(len(rows))
    return DriveRecord(
        plant=truth, timing=timing, t=t, commands=commands, samples=samples, states=states, readings=seen
    )


def _check(plant: Plant, sensors: SensorSuite, timing: Timing) -> None:
    if plant_model(plant) != "full":
        raise InvalidParameter("a driver drives the full model; this plant is of the paper's")
    if not math.isclose(sensors.period, timing.period, rel_tol=1e-9):
        raise InvalidParameter(
            f"the period of the sensors must be that of the drive, {timing.period:g} s, "
            f"got {sensors.period:g} s - imu.rate?"
        )


def _advance(
    state: np.ndarray,
    warm: np.ndarray,
    command: Command,
    plant: Plant,
    readings: np.ndarray,
    timing: Timing,
    faults: Faults,
) -> float:
    """One tick; returns the worst contact status.

    Forces of a fault act half before and half after each part of a tick, so that the readings lie between.
    """
    if faults.kick is None:
        step = timing.tick / timing.steps
        return float(full_advance(state, warm, command, plant, step, timing.steps, readings))
    worst, part, seen = 0.0, timing.tick / _PARTS, readings.copy()
    for i in range(_PARTS):
        before = state.copy()
        if i == _PARTS - 1:
            full_advance(state, warm, command, plant, part, 0, seen)
        faults.kick(state, readings, plant, 0.5 * part)
        worst = max(worst, float(full_advance(state, warm, command, plant, part, 1, readings)))
        faults.kick(state, readings, plant, 0.5 * part)
    worst = max(worst, float(full_advance(state, warm, command, plant, part, 0, readings)))
    readings[_MOTION] += _acceleration(before, state, part) - 0.5 * (seen + readings)[_MOTION]
    return worst


def _acceleration(before: np.ndarray, after: np.ndarray, span: float) -> np.ndarray:
    """(5,) mean accelerations of the body between two states, as among the readings.

    What an IMU measures changes the motion. A wheel settles within a part of a tick, and its force where the
    kicks of a fault leave it is not the mean: with grousers that add a fifth of the load to the thrust it
    differs by 0.05 m/s^2.
    """
    rate, middle = (after - before) / span, 0.5 * (after + before)
    turning = middle[at.YAW_RATE]
    forward = rate[at.V_X] - middle[at.V_Y] * turning
    left = rate[at.V_Y] + middle[at.V_X] * turning
    return np.array([forward, left, rate[at.V_Z], rate[at.YAW_RATE], rate[at.PITCH_RATE]])


def _sample(state: np.ndarray, readings: np.ndarray, sensors: SensorSuite, faults: Faults) -> np.ndarray:
    sample = sensors.sample(state, readings).channels
    faults.sample(sample)
    return sample
