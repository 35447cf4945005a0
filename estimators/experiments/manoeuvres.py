"""Drives along which the information about the soil is computed: a menu, the paper's rows, recorded logs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.experiments.buzhardt_tallapragada import CHOICES, ROWS, row_plant, row_truth
from estimators.log_estimation import log_samples
from estimators.logs import Log, plant_of, start_of
from estimators.models.imu_prediction import step_full_copies, step_paper_copies
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import Plant, plant_model, settled_state

__all__ = [
    "MANOEUVRES",
    "Manoeuvre",
    "Stepper",
    "log_manoeuvre",
    "manoeuvre",
    "row_manoeuvre",
    "stepper",
]

#: ``step(copies (C, 15), warms (C, 2, 3), plant, command (3,))``: readings (C, 5) before the step, which is
#: then done in place.
Stepper = Callable[[np.ndarray, np.ndarray, Plant, np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """A drive: what is known of the vehicle, where it starts, and its commands."""

    name: str
    plant: Plant
    start: np.ndarray  #: (15,)
    warm: np.ndarray  #: (2, 3)
    commands: np.ndarray  #: (T, 3) held over a sample, as the kernels take them
    title: str  #: in words
    dt: float = 0.01  #: time between samples [s]

    def __post_init__(self) -> None:
        if self.plant.soil.rigid > 0.5:
            raise InvalidParameter(f"{self.name}: stands on hard ground, which has no soil parameters")

    @property
    def duration(self) -> float:
        """[s]"""
        return self.dt * len(self.commands)


def _keep_speed(v: float, target: float, plant: Plant) -> float:
    """Force [N], or torque [N m], that holds a speed: feed-forward for rolling and a proportional part."""
    vehicle = plant.vehicle
    push = vehicle.m * (1.0 + 1.5 * (target - v))
    return push * vehicle.r if plant_model(plant) == "full" else push


@dataclass(frozen=True, kw_only=True)
class _Course:
    """A manoeuvre of the menu: steering and speed as functions of time."""

    title: str
    steer: Callable[[float], float]  #: [rad]
    speed: Callable[[float], float]  #: [m/s]


#: The menu: name -> steering [rad] and speed to hold [m/s] over time.
MANOEUVRES: dict[str, _Course] = {
    "straight": _Course(title="straight at 5 m/s", steer=lambda t: 0.0, speed=lambda t: 5.0),
    "pulse": _Course(
        title="straight, speed up and brake every 4 s",
        steer=lambda t: 0.0,
        speed=lambda t: 5.0 + (2.0 if t % 4.0 < 2.0 else -2.0),
    ),
    "sine": _Course(
        title="steering 0.2 sin t at 5 m/s", steer=lambda t: 0.2 * math.sin(t), speed=lambda t: 5.0
    ),
    "circle": _Course(title="steering 0.2 at 5 m/s", steer=lambda t: 0.2, speed=lambda t: 5.0),
    "slalom": _Course(
        title="steering 0.3 sin 1.5 t while the speed swings by 2 m/s",
        steer=lambda t: 0.3 * math.sin(1.5 * t),
        speed=lambda t: 5.0 + 2.0 * math.sin(0.8 * t),
    ),
}


def stepper(plant: Plant, dt: float) -> Stepper:
    """The step of copies of a vehicle, which raises `SolverFailure` where one has no contact solution.

    Parameters
    ----------
    plant : Plant
        Its model, full or paper; the parameters are those of the plant given at each step.
    dt : float
        [s]
    """
    full = plant_model(plant) == "full"
    kernel = step_full_copies if full else step_paper_copies
    mount = ImuConfig(body_axes=full).mount()

    def step(copies: np.ndarray, warms: np.ndarray, plant: Plant, command: np.ndarray) -> np.ndarray:
        readings, exponents = np.empty((len(copies), 5)), np.full(len(copies), plant.soil.n)
        held = (float(command[0]), float(command[1]), float(command[2]))
        status = kernel(copies, warms, pack(plant), exponents, held, dt, mount, readings)
        if status >= SUNK or not (np.isfinite(copies).all() and np.isfinite(readings).all()):
            raise SolverFailure(f"no contact solution (status {status:g})")
        return readings

    return step


def manoeuvre(name: str, plant: Plant, *, duration: float = 10.0) -> Manoeuvre:
    """A drive of the menu on some plant.

    Parameters
    ----------
    name : str
        One of `MANOEUVRES`.
    plant : Plant
        Full or paper model.
    duration : float
        [s]

    Raises
    ------
    InvalidParameter, SolverFailure
        For an unknown name, or a plant that does not get through.
    """
    if name not in MANOEUVRES:
        raise InvalidParameter(f"manoeuvre must be one of {', '.join(MANOEUVRES)}, got {name!r}")
    course, dt = MANOEUVRES[name], Manoeuvre.dt
    step = stepper(plant, dt)
    start, warm = settled_state(plant, v_x=course.speed(0.0))
    x, own, commands = start[None].copy(), warm[None].copy(), []
    vehicle = plant.vehicle
    for k in range(round(duration / dt)):
        t = (k + 0.5) * dt
        push = _keep_speed(float(x[0, at.V_X]), course.speed(t), plant)
        if plant_model(plant) == "full":
            drive = min(max(push, 0.0), vehicle.drive_torque_max)
            command = np.array([course.steer(t), drive, min(max(-push, 0.0), vehicle.brake_torque_max)])
        else:
            command = np.array([course.steer(t), push, math.nan])
        step(x, own, plant, command)
        commands.append(command)
    return Manoeuvre(
        name=name, plant=plant, start=start, warm=warm, commands=np.array(commands), title=course.title
    )


def row_manoeuvre(number: int, *, duration: float = 20.0) -> Manoeuvre:
    """A row of the paper's table: its half-car, ground, steering and force.

    Parameters
    ----------
    number : int
        1 ... 8.
    duration : float
        [s]
    """
    if not 1 <= number <= len(ROWS):
        raise InvalidParameter(f"row must be in 1 ... {len(ROWS)}, got {number}")
    row = ROWS[number - 1]
    plant = row_plant(row)
    start, warm = settled_state(plant, v_x=CHOICES["start_speed"].value)
    commands = row_truth(row, duration=duration).inputs[1::2]  # at the middle of every sample
    title = f"row {number} of the paper: {row.soil}, H0 {row.H0:g} m, {row.steer_amplitude:g} rad"
    return Manoeuvre(name=f"row{number}", plant=plant, start=start, warm=warm, commands=commands, title=title)


def log_manoeuvre(log: Log) -> Manoeuvre:
    """The drive of a log: its vehicle, soil and ground as described, its commands, its settled start.

    Raises
    ------
    DataError
        For a log that no filter could use.
    """
    samples, plant = log_samples(log), plant_of(log)
    start, warm = start_of(log, plant)
    return Manoeuvre(
        name=log.name,
        plant=plant,
        start=start,
        warm=warm,
        commands=samples.commands[1:],
        title=f"log {log.name}",
        dt=samples.dt,
    )
