"""Manoeuvres that could be driven next: a menu, and the fitted model in each.

Speeds are multiples of the log's own, and steering is as sharp as a sideways acceleration allows, so that
the menu suits a vehicle of a kilogram as well as one of a tonne.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit import autoregressive, stretches_of
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.run_model import RunModel, drives
from estimators.discrepancy.model.windows import FIT
from estimators.logs.config import StartSpec, TerrainSpec
from estimators.logs.log import Log
from offroad_env.effects import Setup
from offroad_env.errors import DataError, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.physics.records import Vehicle
from offroad_env.simulation.simulator import settled_state

__all__ = ["MENU", "Manoeuvre", "driven"]

#: Sideways acceleration that steering aims at [m/s^2], and the largest angle [rad].
_SIDEWAYS, _SHARPEST = 2.0, 0.35
#: Gain of the speed controller [1/s]; resistance that it counts on, as a share of the weight.
_GAIN, _RESISTANCE = 1.5, 0.1
#: Least speed for which the steering is computed [m/s].
_SLOW = 0.3


@dataclass(frozen=True, kw_only=True)
class Manoeuvre:
    """A drive of some seconds.

    ``speed`` is the wanted speed as a multiple of the log's usual one at time t, None for rolling free;
    ``steer`` is the steering at time t as a multiple of the angle for the wanted sideways acceleration.
    """

    name: str
    sentence: str
    speed: Callable[[float], float | None]
    steer: Callable[[float], float] = lambda t: 0.0
    load: float = 0.0  #: extra load that is known, as a share of the mass [-]
    slope: float = 0.0  #: climb of the ground along the way, known [-]
    duration: float = 13.0  #: [s]


def _square(t: float, period: float) -> float:
    return 1.0 if t % period < 0.5 * period else -1.0


def _lively_speed(t: float) -> float:
    return 1.0 + 0.45 * math.sin(0.9 * t) + 0.2 * math.sin(2.1 * t)


def _lively_steer(t: float) -> float:
    return 0.6 * math.sin(1.1 * t) + 0.5 * math.sin(2.3 * t)


MENU = (
    Manoeuvre(name="steady", sentence="drive straight on at one speed", speed=lambda t: 1.0),
    Manoeuvre(
        name="speed_steps",
        sentence="drive straight on in steps of speed, slow and fast in turn",
        speed=lambda t: (0.6, 1.5, 0.8, 1.8)[int(t / 4.0) % 4],
    ),
    Manoeuvre(
        name="coast_down",
        sentence="speed up, then roll out straight on without drive or brake",
        speed=lambda t: 1.7 if t % 8.0 < 3.5 else None,
    ),
    Manoeuvre(
        name="brake",
        sentence="speed up and brake hard, straight on, several times",
        speed=lambda t: 1.6 if t % 4.0 < 2.8 else 0.4,
    ),
    Manoeuvre(
        name="slalom",
        sentence="drive a slalom at one speed",
        speed=lambda t: 1.0,
        steer=lambda t: math.sin(3.0 * t),
    ),
    Manoeuvre(
        name="step_steer",
        sentence="steer in steps, left and right, at one speed",
        speed=lambda t: 1.0,
        steer=lambda t: 0.8 * _square(t, 4.0),
    ),
    Manoeuvre(
        name="circle",
        sentence="drive a circle, slow, then faster",
        speed=lambda t: 0.5 + 0.08 * t,
        steer=lambda t: 1.0,
    ),
    Manoeuvre(
        name="both_ways",
        sentence="drive a line, turn round, and drive it back",
        speed=lambda t: 1.0 if t < 5.0 or t > 12.0 else 0.8,
        steer=lambda t: 1.6 if 5.0 < t < 12.0 else 0.0,
        duration=17.0,
    ),
    Manoeuvre(
        name="hill",
        sentence="drive up a slope of known 10 % in steps of speed",
        speed=lambda t: 0.7 if t % 6.0 < 3.0 else 1.2,
        slope=0.1,
    ),
    Manoeuvre(
        name="loaded",
        sentence="drive lively with a known load of 20 % of the mass",
        speed=_lively_speed,
        steer=_lively_steer,
        load=0.2,
    ),
    Manoeuvre(
        name="lively",
        sentence="speed up, brake and steer both ways all the time",
        speed=_lively_speed,
        steer=_lively_steer,
    ),
)


class _Drive(NamedTuple):
    """A manoeuvre as the model drives it."""

    commands: np.ndarray  #: (K, 3) as the model's kernels take them
    states: np.ndarray  #: (K + 1, 15)
    warm: np.ndarray  #: (2, 3) warm start of the settled vehicle


def driven(fit: FitResult, manoeuvre: Manoeuvre, *, usual: float) -> FitResult:
    """The fitted model in a manoeuvre, with the sensors, rates and noise of its first log.

    Only the derivatives of the predictions are needed, no data: those of the result are empty.

    Parameters
    ----------
    usual
        Usual speed of the log [m/s].

    Raises
    ------
    SolverFailure
        When the vehicle cannot drive this.
    DataError
        When nothing of it can be compared, as on hard ground where the vehicle stands.
    """
    source = drives(fit.runs)[0]
    config = source.log.config
    vehicle, load = source.log.vehicle, 1.0 + manoeuvre.load
    config = replace(
        config,
        vehicle=vehicle._replace(m=load * vehicle.m, I_z=load * vehicle.I_z, I_y=load * vehicle.I_y),
        terrain=TerrainSpec(kind="waves", plane=(0.0, manoeuvre.slope, 0.0)),
        start=StartSpec(v_x=usual * (manoeuvre.speed(0.0) or 1.0)),
        hold="zoh",
    )
    blank = replace(source.log, config=config)
    setup = fit.problem.setup(RunModel(blank, whole=FIT, nuisances=fit.problem.nuisances), fit.point)
    drive = _controlled(setup, source, manoeuvre, usual)
    run = RunModel(_planned(blank, source, drive), whole=FIT, nuisances=fit.problem.nuisances)
    if not len(run.windows):
        raise DataError(f"no window of {manoeuvre.name} can be compared")
    problem = LeastSquaresProblem([run])
    starts = (drive.states[run.windows.first],)
    warm = (np.repeat(drive.warm[None], len(run.windows), axis=0),)
    point = replace(fit.point, starts=starts, warm=warm, centre=starts)
    return FitResult(
        linearisation=Linearisation.at(problem, point),
        jacobian=Jacobian(),
        noise=autoregressive(fit).on(stretches_of(problem)),
    )


def _controlled(setup: Setup, source: RunModel, manoeuvre: Manoeuvre, usual: float) -> _Drive:
    """Drive the manoeuvre under speed and steering control.

    A loop of its own beside `offroad_env.simulation.drive.simulate_drive`: that one samples sensors and
    has the full model only; here the driver sees the state, and either model is driven at the log's step.
    """
    plant = setup.plant if source.driven else setup.plant._replace(vehicle=source.log.vehicle)
    vehicle, full = plant.vehicle, setup.model == "full"
    x, warm = settled_state(plant, v_x=usual * (manoeuvre.speed(0.0) or 1.0))
    settled, readings = warm.copy(), np.zeros(at.READINGS_SIZE)
    count = round(manoeuvre.duration / source.step)
    commands, states = np.empty((count, 3)), np.empty((count + 1, at.STATE_SIZE))
    states[0] = x
    for k in range(count):
        t = k * source.step
        command = _command(x, vehicle, manoeuvre, t, usual)
        if full:
            status = full_advance(x, warm, command, plant, source.dt, source.steps, readings)
        else:
            force = (command[1] - command[2]) / vehicle.r
            command = (command[0], force, math.nan)
            status = paper_advance(x, warm, command, plant, source.dt, source.steps, readings)
        if status >= SUNK:
            raise SolverFailure(f"the vehicle cannot drive {manoeuvre.name}: stuck at {t:.1f} s")
        commands[k], states[k + 1] = command, x
    return _Drive(commands, states, settled)


def _command(
    x: np.ndarray, vehicle: Vehicle, manoeuvre: Manoeuvre, t: float, usual: float
) -> tuple[float, float, float]:
    """Steering [rad], drive and brake torque [N m] at time ``t`` [s], for a ``usual`` speed [m/s]."""
    v = max(float(x[at.V_X]), _SLOW)
    angle = min(_SIDEWAYS * (vehicle.l_f + vehicle.l_r) / max(v, 0.5 * usual) ** 2, _SHARPEST)
    steer = min(max(manoeuvre.steer(t) * angle, -vehicle.steer_max), vehicle.steer_max)
    wanted = manoeuvre.speed(t)
    if wanted is None:
        return steer, 0.0, 0.0
    resistance = (_RESISTANCE + manoeuvre.slope) * GRAVITY
    torque = vehicle.m * vehicle.r * (_GAIN * (wanted * usual - v) + resistance)
    drive = min(max(torque, 0.0), vehicle.drive_torque_max)
    return steer, drive, min(max(-torque, 0.0), vehicle.brake_torque_max)


def _planned(blank: Log, source: RunModel, drive: _Drive) -> Log:
    """A log of the manoeuvre: its inputs, and every sensor's stamps at its own rate."""
    commands, states, count = drive.commands, drive.states, len(drive.commands)
    t, held = source.step * np.arange(count + 1), np.vstack([commands, commands[-1:]])
    channels = {}
    for name in source.log.channels:
        times, _ = source.log.samples(name)
        every = max(round(float(np.median(np.diff(times))) / source.step), 1) if len(times) > 1 else count
        stamps = np.full(count + 1, np.nan)
        stamps[::every] = 0.0
        channels[name] = stamps
    channels["steer"] = held[:, 0]
    if "drive_force" in channels:
        channels["drive_force"] = held[:, 1]
    axles = [name for name in ("torque_f", "torque_r") if name in channels]
    for i, name in enumerate(axles):
        channels[name] = (held[:, 1] - held[:, 2]) * (i == 0)
    if not source.driven:
        channels |= {
            name: states[:, i]
            for name, i in (("omega_f", at.OMEGA_F), ("omega_r", at.OMEGA_R))
            if name in channels
        }
    return replace(blank, t=t, channels=channels, references={})
