"""Drives on unseen soils in steps of 0.1 s: what models of the motion are learnt from and tested on.

A drive is one of `estimators.experiments.unknown_soils` on level ground, with all other nuisances. At three
times every method predicts where the vehicle will be 3 s later under the commands that follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from estimators.experiments.unknown_soils import VEHICLE, SoilRun, draw_run
from estimators.filters.navigation import GYRO_BIAS, V_SIDE, NavigationFilter, NavigationNoise, V
from offroad_env.physics import state as at
from offroad_env.physics.imu import YAW_RATE
from offroad_env.simulation.sensors import GnssConfig
from offroad_env.world.vehicles import VEHICLES

__all__ = [
    "AT",
    "HORIZON",
    "INPUTS",
    "MOTION",
    "STEP",
    "DriveSequence",
    "Errors",
    "drive_of",
    "prediction_error",
    "sequence_of",
]

#: When predictions start, and how far they look ahead [s].
AT, HORIZON = (2.0, 5.0, 10.0), 3.0
#: Step of the sequences that models are learnt from [s].
STEP = 0.1
#: Columns of a sequence: motion [m/s, m/s, rad/s, m/s, m/s], rims less speed; inputs [rad, m/s^2].
MOTION = ("v_x", "v_y", "yaw_rate", "rim_f", "rim_r")
INPUTS = ("steer", "push")
_DURATION = AT[-1] + HORIZON


class Errors(NamedTuple):
    """Of a prediction at its end."""

    position: float  #: [m]
    speed: float  #: [m/s]


@dataclass(frozen=True, kw_only=True)
class DriveSequence:
    """A drive in steps of `STEP`, for models that are learnt; row k belongs to the time k `STEP`."""

    true: np.ndarray  #: (T, 5) motion
    measured: np.ndarray  #: (T, 5) the same from the sensors, by the navigation filter
    inputs: np.ndarray  #: (T - 1, 2) mean steering and push between two rows, after the nominal lags
    place: np.ndarray  #: (T, 3) true position [m] and heading [rad]


@cache
def drive_of(seed: int, split: str) -> SoilRun:
    """A drive on level ground with all other nuisances, long enough for the last prediction."""
    return draw_run("level", seed, split=split, duration=_DURATION)


def prediction_error(run: SoilRun, start: float, end: np.ndarray) -> Errors:
    """Error of a predicted end (4,), see `predicted`."""
    truth = run.record.states[round((start + HORIZON) / run.record.timing.period)]
    away = math.hypot(end[0] - truth[at.X], end[1] - truth[at.Y])
    return Errors(away, abs(float(end[3]) - float(truth[at.V_X])))


def _lagged(commands: np.ndarray, lag: float, dt: float) -> np.ndarray:
    """What acts when an actuator with this lag [s] follows commands (T,), each held for ``dt``."""
    share, found, value = 1.0 - math.exp(-dt / lag) if lag > 0.0 else 1.0, np.empty(len(commands)), 0.0
    for k, command in enumerate(commands):
        value += share * (command - value)
        found[k] = value
    return found


def sequence_of(run: SoilRun) -> DriveSequence:
    """A drive as models learn from it."""
    record, vehicle = run.record, VEHICLES[VEHICLE]
    dt, states = record.timing.period, record.states
    every = round(STEP / dt)
    speed = states[:, at.V_X]
    rims = vehicle.r * states[:, [at.OMEGA_F, at.OMEGA_R]] - speed[:, None]
    true = np.column_stack([speed, states[:, at.V_Y], states[:, at.YAW_RATE], rims])
    steer = _lagged(record.commands[1:, 0], vehicle.steer_lag, dt)
    torque = _lagged(record.commands[1:, 1] - record.commands[1:, 2], vehicle.torque_lag, dt)
    inputs = np.column_stack([steer, torque / (vehicle.m * vehicle.r)])
    return DriveSequence(
        true=true[::every],
        measured=_measured(run)[::every],
        inputs=inputs.reshape(-1, every, len(INPUTS)).mean(axis=1),
        place=states[::every, [at.X, at.Y, at.YAW]],
    )


def _measured(run: SoilRun) -> np.ndarray:
    """(T, 5) motion by navigation filter, gyro and wheel speeds, as the belief over soils has it."""
    record, rims = run.record, np.full(2, run.pose.v)
    navigation = NavigationFilter(VEHICLES[VEHICLE], NavigationNoise.of(GnssConfig(position_sd=1.5)))
    navigation.reset(*run.pose)
    rows = [[run.pose.v, 0.0, 0.0, 0.0, 0.0]]
    rate = 0.0
    for k in range(1, len(record.t)):
        steer = float(record.commands[k, 0])
        navigation.update(record.imu[k], record.wheel[k], steer, record.gnss[k], record.timing.period)
        if np.isfinite(record.wheel[k]).all():
            rims = record.wheel[k]
        x = navigation.x
        # The gyro is noisy: its mean over about 0.1 s.
        rate += 0.2 * (record.imu[k, YAW_RATE] - rate)
        rows.append([x[V], x[V_SIDE], rate - x[GYRO_BIAS], rims[0] - x[V], rims[1] - x[V]])
    return np.array(rows)
