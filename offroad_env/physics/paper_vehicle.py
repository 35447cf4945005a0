"""Preset ``paper``: half-car + bicycle exactly as Buzhardt & Tallapragada (ACC 2021) write it.

Slip is a constant, the drive is a body force F_u, steering acts at once, gravity does nothing
along a slope, and an inertial vertical speed stands in the body-frame equations (a parked,
undamped, bouncing car is pumped; kept on purpose). Two departures, both outside what the paper
defines: static axle loads from the CG instead of m g/2 each, and wheels that can leave the ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import (
    AxleStance,
    Directions,
    Plant,
    Pose,
    Velocity,
    axle_contact,
    axle_motion,
    static_loads,
    suspension_force,
    suspension_load,
)
from offroad_env.physics.contact import NO_ROOT, SUNK, Support
from offroad_env.physics.hooks import change_body_forces, change_load
from offroad_env.physics.numerics import all_finite, copy_into, lane_rows, sin_cos
from offroad_env.physics.records import AxleSpring, BodyForces, FloatArray, SpringState, Vehicle, WheelMotion
from offroad_env.physics.slip import constant_slip_rim

__all__ = ["paper_advance", "paper_derivative", "paper_step", "simulate_paper"]


class PaperPush(NamedTuple):
    """What an axle does to the vehicle, in body axes."""

    status: float  #: of its contact
    F_x: float  #: forward [N]
    F_y: float  #: to the left [N]
    F_s: float  #: of the suspension, relative to static equilibrium, up [N]


@merged_kernel
def _paper_axle(
    plant: Plant,
    x: FloatArray,
    directions: Directions,
    arm: float,
    spring: AxleSpring,
    warm: FloatArray,
    readings: FloatArray,
) -> PaperPush:
    """One axle ``arm`` [m] ahead of the CG."""
    sin, cos = directions.pitch
    sin_d, cos_d = directions.steer
    pose = Pose(x[at.X], x[at.Y], directions.yaw)
    velocity = Velocity(x[at.V_X], x[at.V_Y], x[at.YAW_RATE])
    motion = axle_motion(plant.ground, pose, velocity, arm, directions.steer)
    N_0, inertia, k = spring.static_load, 0.0, spring.k
    if plant.half_car > 0.5:
        z, z_dot = x[at.Z] + arm * sin, x[at.V_Z] + arm * cos * x[at.PITCH_RATE]
        state = SpringState(z - motion.H, z_dot - motion.H_dot)
        N_0, inertia = suspension_load(spring, state, plant.vehicle.m_w, motion.H_ddot)
        N_0 = change_load(plant.effects, N_0, state, spring)
    else:
        k = 0.0
    turning = WheelMotion(constant_slip_rim(plant.slip, motion.u_l), motion.u_l, motion.u_c)
    stance = AxleStance(motion.x, motion.y, motion.H, 0.0, 0.0, arm)
    support = Support(N_0, k, plant.vehicle.wheels_per_axle)
    found = axle_contact(plant, turning, stance, support, warm, readings)
    return PaperPush(
        found.status,
        found.F_l * cos_d - found.F_c * sin_d,
        found.F_l * sin_d + found.F_c * cos_d,
        suspension_force(found.V, spring.static_load, inertia),
    )


@kernel
def paper_derivative(
    x: FloatArray,
    inputs: tuple[float, float, float],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """Time derivative of the state (BT bicycle 1-3, half-car 1-2) into ``d``.

    ``inputs`` = (steer [rad], F_u [N], v_x_dot [m/s^2] or NaN): a number prescribes the
    longitudinal speed instead of the force balance (BT section II-C, last experiment).
    """
    steer, F_u, prescribed = inputs
    v = plant.vehicle
    N_f, N_r = static_loads(v)
    yaw, pitch, wheel = sin_cos(x[at.YAW]), sin_cos(x[at.PITCH]), sin_cos(steer)
    worst = force_x = force_y = lift = pitching = yawing = 0.0
    # A loop and not two calls: each axle would be translated on its own.
    for axle in range(2):
        arm, spring = v.l_f, AxleSpring(N_f, v.k_f, v.c_f)
        if axle == 1:
            arm, spring, wheel = -v.l_r, AxleSpring(N_r, v.k_r, v.c_r), (0.0, 1.0)
        seen = readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        push = _paper_axle(plant, x, Directions(yaw, pitch, wheel), arm, spring, warm[axle], seen)
        worst = max(worst, push.status)
        force_x += push.F_x
        force_y += push.F_y
        lift += push.F_s
        pitching += push.F_s * arm
        yawing += push.F_y * arm
    pushed = BodyForces(force_x + F_u, force_y, yawing, max(-F_u, 0.0) * v.r)
    forces = change_body_forces(plant.effects, pushed, x, v)
    a_z = pitch_acc = 0.0
    if plant.half_car > 0.5:
        a_z = lift / v.m
        pitch_acc = pitching * pitch[1] / v.I_y
    _body_motion(v, x, (yaw, pitch), forces, (a_z, pitch_acc), d, readings)
    if not math.isnan(prescribed):
        readings[at.A_X] += prescribed - d[at.V_X]
        d[at.V_X] = prescribed
    readings[at.STATUS] = worst


@inline_kernel
def _body_motion(
    vehicle: Vehicle,
    x: FloatArray,
    directions: tuple[tuple[float, float], tuple[float, float]],
    forces: BodyForces,
    vertical: tuple[float, float],
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """Motion of the body (BT bicycle 1-3, half-car 1-2), into ``d`` and ``readings``.

    ``directions`` = (sin, cos) of yaw and pitch; ``vertical`` = (heave [m/s^2], pitch acceleration
    [rad/s^2]).
    """
    (sin, cos), (sin_p, cos_p) = directions
    a_x, a_y = forces.F_x / vehicle.m, forces.F_y / vehicle.m
    a_z, pitch_acc = vertical
    yaw_acc = forces.M_z / vehicle.I_z
    v_x, v_y, v_z, yaw_rate = x[at.V_X], x[at.V_Y], x[at.V_Z], x[at.YAW_RATE]
    d[at.X] = v_x * cos - v_y * sin
    d[at.Y] = v_x * sin + v_y * cos
    d[at.YAW] = yaw_rate
    d[at.Z] = v_z
    d[at.PITCH] = x[at.PITCH_RATE]
    d[at.V_X] = a_x + v_y * yaw_rate * cos_p + v_z * x[at.PITCH_RATE]
    d[at.V_Y] = a_y + v_z * yaw_rate * sin_p - v_x * yaw_rate * cos_p
    d[at.V_Z] = a_z
    d[at.PITCH_RATE] = pitch_acc
    d[at.YAW_RATE] = yaw_acc
    d[at.OMEGA_F :] = 0.0
    readings[at.A_X], readings[at.A_Y], readings[at.A_Z] = a_x, a_y, a_z
    readings[at.YAW_ACC], readings[at.PITCH_ACC] = yaw_acc, pitch_acc


@kernel
def paper_step(
    x: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    plant: Plant,
    dt: float,
    work: FloatArray,
    readings: FloatArray,
) -> float:
    """One classical Runge-Kutta step of order 4, in place.

    ``inputs`` (3, 3): rows are the inputs at t, t + dt/2 and t + dt. ``work`` (3, STATE_SIZE).
    Returns the worst contact status of the four stages. ``readings`` are those of the first
    stage, that is of the state at t.
    """
    k, total, stage = work[0], work[1], work[2]
    size = x.shape[0]
    later = lane_rows().reshape(-1)
    u_0 = (inputs[0, 0], inputs[0, 1], inputs[0, 2])
    u_1 = (inputs[1, 0], inputs[1, 1], inputs[1, 2])
    u_2 = (inputs[2, 0], inputs[2, 1], inputs[2, 2])
    paper_derivative(x, u_0, plant, warm, k, readings)
    status: float = readings[at.STATUS]
    for i in range(size):
        total[i] = k[i]
        stage[i] = x[i] + 0.5 * dt * k[i]
    paper_derivative(stage, u_1, plant, warm, k, later)
    status = max(status, later[at.STATUS])
    for i in range(size):
        total[i] += 2.0 * k[i]
        stage[i] = x[i] + 0.5 * dt * k[i]
    paper_derivative(stage, u_1, plant, warm, k, later)
    status = max(status, later[at.STATUS])
    for i in range(size):
        total[i] += 2.0 * k[i]
        stage[i] = x[i] + dt * k[i]
    paper_derivative(stage, u_2, plant, warm, k, later)
    status = max(status, later[at.STATUS])
    for i in range(size):
        x[i] += dt / 6.0 * (total[i] + k[i])
    return status


@merged_kernel
def paper_advance(
    x: FloatArray,
    warm: FloatArray,
    held: tuple[float, float, float],
    plant: Plant,
    dt: float,
    steps: int,
    readings: FloatArray,
) -> float:
    """``steps`` steps of ``dt`` under held inputs, in place; returns the worst contact status.

    ``readings`` become those of the state reached. Stops at a state that is not finite or has no
    contact solution, with status NO_ROOT.
    """
    work, inputs = np.empty((3, x.shape[0])), np.empty((3, 3))
    for i in range(3):
        inputs[i, 0], inputs[i, 1], inputs[i, 2] = held
    worst: float = 0.0
    for _ in range(steps):
        worst = max(worst, paper_step(x, warm, inputs, plant, dt, work, readings))
        if worst >= NO_ROOT or not all_finite(x):
            return NO_ROOT
    paper_derivative(x, held, plant, warm, work[0], readings)
    worst = max(worst, readings[at.STATUS])
    return worst


@kernel
def simulate_paper(
    x: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    plant: Plant,
    dt: float,
    states: FloatArray,
    readings: FloatArray,
) -> tuple[float, int]:
    """Run ``len(states) - 1`` steps from ``x``; returns (worst status, steps done).

    ``inputs`` (2 steps + 1, 3) at every half step; ``states`` (steps + 1, STATE_SIZE) and
    ``readings`` (steps + 1, READINGS_SIZE) are filled. Stops early at the first state that is not
    finite or has no contact solution.
    """
    steps = states.shape[0] - 1
    work = np.empty((3, x.shape[0]))
    worst = 0.0
    for i in range(steps):
        copy_into(states[i], x)
        status = paper_step(x, warm, inputs[2 * i : 2 * i + 3], plant, dt, work, readings[i])
        worst = max(worst, status)
        if status >= SUNK or not all_finite(x):
            return worst, i
    copy_into(states[steps], x)
    last = inputs[2 * steps]
    paper_derivative(x, (last[0], last[1], last[2]), plant, warm, work[0], readings[steps])
    return max(worst, readings[steps, at.STATUS]), steps
