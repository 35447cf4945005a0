"""Simulation of the windows of a log: a lead-in along the smoothed motion, then open loop on the inputs.

In the lead-in the vehicle starts settled on its soil. Position, heading, horizontal velocity, yaw rate and
mean wheel speeds are set to the smoothed values at every step of the solver; everything else (heave, pitch,
roll, differences of left and right, ruts, shear of the soil) follows from the model. After it nothing is set.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.replay.inputs import InputRows
from estimators.replay.planar_smoother import V_X, PlanarMotion
from offroad_env.errors import SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant, readings_size
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_dynamics import SHORTEST_LAG
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import settled_state

__all__ = ["Predicted", "predict_windows"]

#: Columns of what a lead-in sets: x, y, yaw, v_x, v_y, yaw rate, mean wheel speeds.
(_X, _Y, _YAW, _V_X, _V_Y, _YAW_RATE, _OMEGA_F, _OMEGA_R) = range(8)


class Predicted(NamedTuple):
    """Simulated windows, without their lead-in; what follows a failure is NaN."""

    states: FloatArray  #: (W, K + 1, S) states as `physics.state` has them
    a_y: FloatArray  #: (W, K + 1) acceleration of the CG to the left, level [m/s^2]


class Starts(NamedTuple):
    """Settled vehicles at the begin of the lead-ins."""

    states: FloatArray  #: (W, S)
    warm: FloatArray  #: (W, ...)
    first: np.ndarray  #: (W,) instant; -1 where the soil does not carry the vehicle


class Stepping(NamedTuple):
    """Steps of the solver."""

    dt: float  #: [s]
    steps: int  #: in a step of the grid
    lead: int  #: steps of the grid in a lead-in


@kernel
def _set_motion(x: FloatArray, held: FloatArray, k: int, share: float) -> None:
    """Set the planar motion to that between the instants k and k + 1; wheels without a sensor go on."""
    for i in range(held.shape[1]):
        value = held[k, i] + share * (held[k + 1, i] - held[k, i])
        if not math.isnan(value):
            place = at.X
            if i < 3:
                place = at.X + i
            elif i < 5:
                place = at.V_X + i - 3
            elif i == 5:
                place = at.YAW_RATE
            else:
                place = at.OMEGA_F + i - 6
            x[place] = value


@kernel
def _command(
    x: FloatArray,
    inputs: InputRows,
    exact: tuple[bool, bool],
    k: int,
    shares: tuple[float, float],
    gain: float,
) -> tuple[float, float, float]:
    """What the actuators are given within a step of the grid, between the shares (begin, end) of it.

    An actuator whose lag the log does not name must not add one: it is set to the input, and given what
    takes it to the input's next value.
    """
    begin, end = shares
    given = np.empty(3)
    for i in range(3):
        u_0 = inputs.begin[k, i] + begin * (inputs.end[k, i] - inputs.begin[k, i])
        u_1 = inputs.begin[k, i] + end * (inputs.end[k, i] - inputs.begin[k, i])
        given[i] = u_0
        if exact[min(i, 1)]:
            x[at.STEER + i] = u_0
            given[i] = u_0 + (u_1 - u_0) / gain
    return given[0], given[1], given[2]


@kernel
def _split(plant: Plant, inputs: InputRows, k: int) -> Plant:
    """The plant with the torques shared between the axles as logged."""
    vehicle = replace(
        plant.vehicle, drive_front=inputs.front_share[k, 0], brake_front=inputs.front_share[k, 1]
    )
    return replace(plant, vehicle=vehicle)


@kernel
def _run(
    starts: Starts, held: FloatArray, inputs: InputRows, plant: Plant, stepping: Stepping, out: Predicted
) -> None:
    """All windows, one after the other, into ``out``, which holds NaN."""
    dt, steps, lead = stepping
    lags = plant.vehicle.steer_lag, plant.vehicle.torque_lag
    exact = lags[0] < SHORTEST_LAG, lags[1] < SHORTEST_LAG
    # Heun's method, by which the solver integrates the actuators, makes this share of the way in a step.
    gain = dt / SHORTEST_LAG - 0.5 * (dt / SHORTEST_LAG) ** 2
    work, seen = np.empty((WORK_ROWS, readings_size(plant))), np.empty(readings_size(plant))
    last = lead + out.a_y.shape[1] - 1
    for w in range(starts.first.shape[0]):
        if starts.first[w] < 0:
            continue
        x, warm = starts.states[w].copy(), starts.warm[w].copy()
        for i in range(3):
            x[at.STEER + i] = inputs.actuators[starts.first[w], i]
        worst = 0.0
        for i in range(last + 1):
            k = starts.first[w] + i
            local = _split(plant, inputs, k)
            for j in range(steps if i < last else 1):
                if i < lead or (i == lead and j == 0):
                    _set_motion(x, held, k, j / steps)
                command = _command(x, inputs, exact, k, (j / steps, (j + 1.0) / steps), gain)
                full_derivative(x, command, local, warm, work[0], seen)
                if j == 0 and i >= lead:
                    copy_into(out.states[w, i - lead], x)
                    out.a_y[w, i - lead] = seen[at.A_Y]
                if i < last:
                    worst = max(worst, full_continue(x, warm, command, local, (dt, 1), work, seen))
            if not worst < SUNK:
                break


def _settled(plant: Plant, motion: PlanarMotion, first: np.ndarray) -> Starts:
    """Vehicles at rest on their soil where the lead-ins begin."""
    states, warms, begin = [], [], first.copy()
    for w, k in enumerate(first):
        x, y, yaw, v_x = motion.states[k, : V_X + 1].tolist()
        try:
            state, warm = settled_state(plant, x=x, y=y, yaw=yaw, v_x=max(v_x, 0.0))
        except SolverFailure:
            begin[w] = -1
            continue
        states.append(state)
        warms.append(warm)
    if not states:
        raise SolverFailure("the soil carries the vehicle at the start of no window")
    carried = np.cumsum(begin >= 0) - 1
    order = np.maximum(carried, 0)
    return Starts(np.array(states)[order], np.array(warms)[order], begin)


def predict_windows(
    plant: Plant,
    motion: PlanarMotion,
    inputs: InputRows,
    windows: np.ndarray,
    lengths: tuple[int, int],
    steps: int,
) -> Predicted:
    """Predict all windows of a log.

    Parameters
    ----------
    windows : array (W,)
        Instant at which each lead-in begins.
    lengths
        Steps of the grid in a lead-in, and in a window.
    steps
        Of the solver in a step of the grid.

    Raises
    ------
    SolverFailure
        Where the soil does not carry the vehicle.
    """
    lead, count = lengths
    starts = _settled(plant, motion, windows)
    held = np.column_stack([motion.states[:, : V_X + 2], motion.yaw_rate, motion.omega_f, motion.omega_r])
    shape = (len(windows), count + 1)
    out = Predicted(np.full((*shape, starts.states.shape[1]), math.nan), np.full(shape, math.nan))
    _run(starts, np.ascontiguousarray(held), inputs, plant, Stepping(motion.step / steps, steps, lead), out)
    return out
