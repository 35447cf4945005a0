"""Simulation of all windows of a run in one compiled call."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.imu import ImuMount, imu_reading
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.paper_vehicle import paper_advance
from offroad_env.physics.records import FloatArray, Vehicle

__all__ = [
    "Histories", "Timing", "WindowStarts", "actuator_states", "imu_rows", "run_full", "run_paper",
]  # fmt: skip


#: First steps of a window that are never taken as one: wheels that spin too fast grip within milliseconds.
_SINGLY = 4


class WindowStarts(NamedTuple):
    """What every window begins with."""

    states: FloatArray  #: (W, 15)
    warm: FloatArray  #: (W, 2, 3) warm starts of the contact solver
    actuators: (
        FloatArray  #: (K + 1, 3) their states are a run of their own, because nothing acts back on them
    )


class Timing(NamedTuple):
    """Steps of the solver."""

    dt: float  #: [s]
    steps: int  #: of ``dt`` in a step of the grid
    stride: int = 1  #: steps of the grid that are taken as one, 1 or 2; what lies between is interpolated


class Histories(NamedTuple):
    """Simulated windows, one after the other; written by the kernels. What follows a failure is NaN."""

    states: FloatArray  #: (R, 15)
    readings: FloatArray  #: (R, 32)


@inline_kernel
def _copy_rows(target: FloatArray, source: FloatArray) -> None:
    """``target[:] = source`` for (M, N) arrays, compiled far sooner."""
    for i in range(target.shape[0]):
        copy_into(target[i], source[i])


@inline_kernel
def _between(i: int, count: int, stride: int) -> bool:
    """Whether record ``i`` of a window of ``count`` steps is interpolated."""
    return stride > 1 and _SINGLY < i < count and (i - _SINGLY) % 2 == 1


@inline_kernel
def _fill_between(table: FloatArray, count: int, stride: int) -> None:
    """Interpolate the records (count + 1, N) of a window that no step has reached, by third order."""
    for i in range(1, count):
        if _between(i, count, stride):
            before, low, high = table[i - 3], table[i - 1], table[i + 1]
            for j in range(table.shape[1]):
                if i + 3 <= count:
                    table[i, j] = 0.5625 * (low[j] + high[j]) - 0.0625 * (before[j] + table[i + 3, j])
                else:
                    table[i, j] = 0.75 * low[j] + 0.375 * high[j] - 0.125 * before[j]


@inline_kernel
def _forget(row: FloatArray) -> None:
    """Make every number of a row NaN."""
    for i in range(row.shape[0]):
        row[i] = math.nan


@kernel
def run_full(
    starts: WindowStarts,
    spans: np.ndarray,
    commands: FloatArray,
    rims: FloatArray,
    plant: Plant,
    timing: Timing,
    out: Histories,
) -> FloatArray:
    """Run every window of the full model; returns the worst contact status of each, (W,).

    Parameters
    ----------
    spans : (W, 2) first instant and number of steps
    commands : (K, 3) held over each step of the grid, see `full_derivative`
    rims : (K + 1, 2) wheel speeds [rad/s] that hold instead of the balance of torques, or (0, 2)
    """
    states, readings = out.states, out.readings
    dt, steps, stride = timing.dt, timing.steps, timing.stride
    worst = np.zeros(spans.shape[0])
    x, warm = np.empty(at.STATE_SIZE), np.empty((starts.warm.shape[1], starts.warm.shape[2]))
    work = np.empty((WORK_ROWS, at.READINGS_SIZE))
    row = 0
    for w in range(spans.shape[0]):
        first, count = spans[w, 0], spans[w, 1]
        copy_into(x, starts.states[w])
        _copy_rows(warm, starts.warm[w])
        copy_into(x[at.STEER :], starts.actuators[first])
        for i in range(count + 1):
            if worst[w] >= SUNK:
                _forget(states[row])
                _forget(readings[row])
            elif not _between(i, count, stride):
                k = first + max(i - 1, 0)
                span = 2 if _between(i - 1, count, stride) else 1
                command = _mean_command(commands, k, span)
                seen, onward = readings[row], (span * dt, steps if i > 0 else 0)
                if rims.shape[0] > 0:
                    status = _with_rims(x, warm, command, rims[k : k + 2], plant, onward, (work, seen))
                else:
                    if i == 0:
                        full_derivative(x, command, plant, warm, work[0], seen)
                    else:  # each step goes on from the slope and readings that the last one has ended with
                        copy_into(seen, readings[row - span])
                    status = full_continue(x, warm, command, plant, onward, work, seen)
                worst[w] = max(worst[w], status)
                copy_into(states[row], x)
            row += 1
        _fill_between(states[row - count - 1 : row], count, stride)
        _fill_between(readings[row - count - 1 : row], count, stride)
    return worst


@inline_kernel
def _mean_command(commands: FloatArray, k: int, span: int) -> tuple[float, float, float]:
    """Mean of the commands (K, 3) over the ``span`` steps of the grid that end with step ``k``."""
    share = 1.0 / span
    a, b, c = 0.0, 0.0, 0.0
    for i in range(k + 1 - span, k + 1):
        a += share * commands[i, 0]
        b += share * commands[i, 1]
        c += share * commands[i, 2]
    return a, b, c


@kernel
def _with_rims(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, float, float],
    rims: FloatArray,
    plant: Plant,
    timing: tuple[float, int],
    arrays: tuple[FloatArray, FloatArray],
) -> float:
    """A step of the grid in which the wheels turn as measured; returns the worst contact status.

    ``rims`` (2, 2) [rad/s] at its begin and end: each part of the step has the speed of its middle, since a
    speed that is held is half a step old, which matters for the traction. The state at
    the begin has no part.
    """
    work, seen = arrays
    dt, steps = timing
    worst = 0.0
    for j in range(steps):
        share = (j + 0.5) / steps
        x[at.OMEGA_F] = rims[0, 0] + share * (rims[1, 0] - rims[0, 0])
        x[at.OMEGA_R] = rims[0, 1] + share * (rims[1, 1] - rims[0, 1])
        full_derivative(x, command, plant, warm, work[0], seen)
        worst = max(worst, full_continue(x, warm, command, plant, (dt, 1), work, seen))
    end = min(steps, 1)
    x[at.OMEGA_F], x[at.OMEGA_R] = rims[end, 0], rims[end, 1]
    full_derivative(x, command, plant, warm, work[0], seen)
    return float(max(worst, seen[at.STATUS]))


@kernel
def run_paper(
    starts: WindowStarts,
    spans: np.ndarray,
    commands: FloatArray,
    plant: Plant,
    timing: Timing,
    out: Histories,
) -> FloatArray:
    """`run_full` for the paper's model; ``commands`` see `paper_derivative`."""
    states, readings = out.states, out.readings
    dt, steps = timing.dt, timing.steps
    worst = np.zeros(spans.shape[0])
    x, warm = np.empty(at.STATE_SIZE), np.empty((starts.warm.shape[1], starts.warm.shape[2]))
    row = 0
    for w in range(spans.shape[0]):
        first, count = spans[w, 0], spans[w, 1]
        copy_into(x, starts.states[w])
        _copy_rows(warm, starts.warm[w])
        for i in range(count + 1):
            if worst[w] >= SUNK:
                _forget(states[row])
                _forget(readings[row])
            else:
                k = max(first + i - 1, 0)
                command = (commands[k, 0], commands[k, 1], commands[k, 2])
                status = paper_advance(x, warm, command, plant, dt, steps if i > 0 else 0, readings[row])
                worst[w] = max(worst[w], status)
                copy_into(states[row], x)
            row += 1
    return worst


@kernel
def actuator_states(vehicle: Vehicle, commands: FloatArray, dt: float, steps: int) -> FloatArray:
    """Steering [rad], drive and brake torque [N m] of the full model's actuators, (K + 1, 3).

    Heun's method with the model's own step, which is what its Rosenbrock method is without a Jacobian.
    The first command is taken to have held for long.
    """
    out = np.empty((commands.shape[0] + 1, 3))
    x, slope = np.empty(3), np.empty((2, 3))
    copy_into(x, commands[0])
    copy_into(out[0], x)
    reach = max(vehicle.steer_lag, 0.005) * vehicle.steer_rate
    lag = max(vehicle.torque_lag, 0.005)
    for k in range(commands.shape[0]):
        for _ in range(steps):
            for stage in range(2):
                for i in range(3):
                    value = x[i] + (dt * slope[0, i] if stage == 1 else 0.0)
                    if i == 0:
                        slope[stage, 0] = vehicle.steer_rate * math.tanh((commands[k, 0] - value) / reach)
                    else:
                        slope[stage, i] = (commands[k, i] - value) / lag
            for i in range(3):
                x[i] += 0.5 * dt * (slope[0, i] + slope[1, i])
        copy_into(out[k + 1], x)
    return out


@kernel
def imu_rows(states: FloatArray, readings: FloatArray, mount: ImuMount) -> FloatArray:
    """What the IMU should read at every record: a_x, a_y, a_z, pitch_rate, yaw_rate, (R, 5)."""
    out = np.empty((states.shape[0], 5))
    for i in range(states.shape[0]):
        x, r = states[i], readings[i]
        acceleration = (r[at.A_X], r[at.A_Y], r[at.A_Z])
        read = imu_reading(
            acceleration, x[at.YAW_RATE], x[at.PITCH_RATE], r[at.YAW_ACC], r[at.PITCH_ACC], x[at.PITCH], mount
        )
        for j in range(5):
            out[i, j] = read[j]
    return out
