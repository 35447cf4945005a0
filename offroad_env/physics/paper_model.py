"""Preset ``paper``: half-car + bicycle exactly as Buzhardt & Tallapragada (ACC 2021) write it.

Slip is a constant, the drive is a body force F_u, steering acts at once, gravity does nothing
along a slope, and an inertial vertical speed stands in the body-frame equations (a parked,
undamped, bouncing car is pumped; kept on purpose). Two departures, both outside what the paper
defines: static axle loads from the CG instead of m g/2 each, and wheels that can leave the ground.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel, merged_kernel
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.hooks import change_body_forces, change_load
from offroad_env.physics.numerics import all_finite, copy_into, lane_rows, sin_cos
from offroad_env.physics.vehicle_model import (
    axle_contact,
    axle_motion,
    static_loads,
    suspension_force,
    suspension_load,
)

__all__ = ["paper_advance", "paper_derivative", "paper_step", "simulate_paper"]


@merged_kernel
def _paper_axle(plant, x, angles, arm, suspension, warm, readings):
    """(status, F_x, F_y, F_s) of one axle in body axes.

    ``angles`` = (sin, cos) of yaw, pitch and steering; ``suspension`` = (N_static, k, c).
    """
    N_static, k, c = suspension
    yaw, (sin, cos), (sin_d, cos_d) = angles
    motion = axle_motion(
        plant.ground,
        (x[at.X], x[at.Y], yaw),
        (x[at.V_X], x[at.V_Y], x[at.YAW_RATE]),
        arm,
        (sin_d, cos_d),
    )
    wx, wy, H, H_dot, H_ddot, u_l, u_c, _, _ = motion
    m_w = plant.vehicle.m_w
    N_0, inertia = N_static, 0.0
    if plant.half_car > 0.5:
        z, z_dot = x[at.Z] + arm * sin, x[at.V_Z] + arm * cos * x[at.PITCH_RATE]
        N_0, inertia = suspension_load(N_static, k, c, m_w, (z, z_dot, H, H_dot, H_ddot))
        N_0 = change_load(plant.effects, N_0, (z - H, z_dot - H_dot), (N_static, k, c))
    else:
        k = 0.0
    # r omega from the constant slip: the paper's s when driving, referred to v when braking.
    rim = u_l / (1.0 - plant.slip) if plant.slip >= 0.0 else u_l * (1.0 + plant.slip)
    status, F_l, F_c, V, _ = axle_contact(
        plant, (rim, u_l, u_c), (wx, wy, H, 0.0, 0.0, arm), (N_0, k), warm, readings
    )
    F_s = suspension_force(V, N_static, inertia)
    return status, F_l * cos_d - F_c * sin_d, F_l * sin_d + F_c * cos_d, F_s


@kernel
def paper_derivative(x, inputs, plant, warm, d, readings):
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
        arm, suspension = v.l_f, (N_f, v.k_f, v.c_f)
        if axle == 1:
            arm, suspension, wheel = -v.l_r, (N_r, v.k_r, v.c_r), (0.0, 1.0)
        seen = readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        status, F_x, F_y, F_s = _paper_axle(plant, x, (yaw, pitch, wheel), arm, suspension, warm[axle], seen)
        worst = max(worst, status)
        force_x += F_x
        force_y += F_y
        lift += F_s
        pitching += F_s * arm
        yawing += F_y * arm
    F_x, F_y, M_z = change_body_forces(plant.effects, (force_x + F_u, force_y, yawing), x, v)
    a_x, a_y = F_x / v.m, F_y / v.m
    a_z = pitch_acc = 0.0
    if plant.half_car > 0.5:
        a_z = lift / v.m
        pitch_acc = pitching * pitch[1] / v.I_y
    yaw_acc = M_z / v.I_z

    v_x, v_y, v_z, yaw_rate = x[at.V_X], x[at.V_Y], x[at.V_Z], x[at.YAW_RATE]
    d[at.X] = v_x * yaw[1] - v_y * yaw[0]
    d[at.Y] = v_x * yaw[0] + v_y * yaw[1]
    d[at.YAW] = yaw_rate
    d[at.Z] = v_z
    d[at.PITCH] = x[at.PITCH_RATE]
    d[at.V_X] = a_x + v_y * yaw_rate * pitch[1] + v_z * x[at.PITCH_RATE]
    d[at.V_Y] = a_y + v_z * yaw_rate * pitch[0] - v_x * yaw_rate * pitch[1]
    d[at.V_Z] = a_z
    d[at.PITCH_RATE] = pitch_acc
    d[at.YAW_RATE] = yaw_acc
    d[10:] = 0.0
    if not math.isnan(prescribed):
        a_x += prescribed - d[at.V_X]
        d[at.V_X] = prescribed
    readings[at.A_X], readings[at.A_Y], readings[at.A_Z] = a_x, a_y, a_z
    readings[at.YAW_ACC], readings[at.PITCH_ACC] = yaw_acc, pitch_acc
    readings[at.STATUS] = worst


@kernel
def paper_step(x, warm, inputs, plant, dt, work, readings):
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
    status = readings[at.STATUS]
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
def paper_advance(x, warm, held, plant, dt, steps, readings):
    """``steps`` steps of ``dt`` under held inputs, in place; returns the worst contact status.

    ``readings`` become those of the state reached. Stops at a state that is not finite or has no
    contact solution, with status NO_ROOT.
    """
    work, inputs = np.empty((3, x.shape[0])), np.empty((3, 3))
    for i in range(3):
        inputs[i, 0], inputs[i, 1], inputs[i, 2] = held
    worst = 0.0
    for _ in range(steps):
        worst = max(worst, paper_step(x, warm, inputs, plant, dt, work, readings))
        if worst >= NO_ROOT or not all_finite(x):
            return NO_ROOT
    paper_derivative(x, held, plant, warm, work[0], readings)
    return max(worst, readings[at.STATUS])


@kernel
def simulate_paper(x, warm, inputs, plant, dt, states, readings):
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
