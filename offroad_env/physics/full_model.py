"""Preset ``full``: wheel spin, slopes, drag, actuators; the default of the environment.

Translation is Newton's law in heading axes that stay horizontal: v_x and v_y are horizontal, v_z
vertical. Each wheel's contact force is resolved in the local slope frame, so gravity along a
slope enters through the contact normals, as it does in nature, and the energy account closes:
contact forces, suspension and gravity exchange exactly what the velocities say. The lever of the
contact point below the CG (``h_cg``) moves it by h_cg * pitch, which gives load transfer under
braking and its reaction on the wheels.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact import NO_ROOT
from offroad_env.physics.hooks import change_body_forces, change_load
from offroad_env.physics.numerics import AIR_DENSITY
from offroad_env.physics.records import Wheel
from offroad_env.physics.vehicle_model import (
    axle_contact,
    axle_motion,
    static_loads,
    suspension_force,
    suspension_load,
    with_exponent,
)
from offroad_env.physics.wheel_soil import rigid_forces, wheel_reaction

__all__ = ["WORK_ROWS", "full_advance", "full_derivative", "full_step"]

#: L-stable choice of the two-stage Rosenbrock method.
_GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
#: Error of a rim speed, as a share of v_eps, above which a step is halved; the shortest part of a step.
_SPIN_ERROR, _SHORTEST = 0.2, 0.1
#: Rows of the scratch array of `full_step`.
WORK_ROWS = 6


@inline_kernel
def _full_axle(plant, x, wheel, arm, suspension, warm, readings):
    """(status, F_forward, F_left, F_s, V, arm) of one axle in heading axes, on its slope."""
    N_static, k, c = suspension
    steer, omega = wheel
    v = plant.vehicle
    forward, pitch, pitch_rate = x[at.V_X], x[at.PITCH], x[at.PITCH_RATE]
    reach = arm
    if plant.half_car > 0.5:
        reach += v.h_cg * math.sin(pitch)
        forward += v.h_cg * math.cos(pitch) * pitch_rate
    wx, wy, H, H_dot, H_ddot, u_l, u_c, g_l, g_c = axle_motion(
        plant.ground, (x[at.X], x[at.Y], x[at.YAW]), (forward, x[at.V_Y], x[at.YAW_RATE]), reach, steer
    )
    N_0, inertia = N_static, 0.0
    if plant.half_car > 0.5:
        z = x[at.Z] + arm * math.sin(pitch)
        z_dot = x[at.V_Z] + arm * math.cos(pitch) * pitch_rate
        N_0, inertia = suspension_load(N_static, k, c, v.m_w, (z, z_dot, H, H_dot, H_ddot))
        N_0 = change_load(plant.effects, N_0, (z - H, z_dot - H_dot), (N_static, k, c))
    else:
        k = 0.0
    q_l = math.sqrt(1.0 + g_l * g_l)
    v_l = u_l * q_l + g_l * g_c * u_c / q_l
    v_c = u_c * math.sqrt(q_l * q_l + g_c * g_c) / q_l
    status, F_l, F_c, V, _ = axle_contact(
        plant, (v.r * omega, v_l, v_c), (wx, wy, H, g_l, g_c, arm), (N_0, k), warm, readings
    )
    cos_d, sin_d = math.cos(steer), math.sin(steer)
    F_s = suspension_force(V, N_static, inertia)
    return status, F_l * cos_d - F_c * sin_d, F_l * sin_d + F_c * cos_d, F_s, V, reach


@inline_kernel
def _spin_acceleration(vehicle, omega, soil_torque, load, drive, brake, v_eps):
    """Angular acceleration of an axle's wheels [rad/s^2].

    Brakes and rolling resistance oppose the spin; tanh over ``v_eps`` lets a held wheel creep
    instead of chattering around zero.
    """
    held = math.tanh(vehicle.r * omega / (0.5 * v_eps))
    resisting = (brake + vehicle.rolling_resistance * load * vehicle.r) * held
    return (drive - resisting - soil_torque) / (vehicle.wheels_per_axle * vehicle.I_w)


@inline_kernel
def _available_torque(vehicle, torque, omega):
    """Drive torque held below the power limit: T / sqrt(1 + (T omega / P)^2), smooth."""
    share = torque * omega / vehicle.power_max
    return torque / math.sqrt(1.0 + share * share)


@inline_kernel
def _axle_torques(vehicle, x):
    """(drive_f, brake_f, drive_r, brake_r) [N m] from the actuator states."""
    mean = vehicle.drive_front * x[at.OMEGA_F] + (1.0 - vehicle.drive_front) * x[at.OMEGA_R]
    drive = _available_torque(vehicle, x[at.DRIVE], mean)
    front, brake_front = vehicle.drive_front, vehicle.brake_front
    return (
        front * drive,
        brake_front * x[at.BRAKE],
        (1.0 - front) * drive,
        (1.0 - brake_front) * x[at.BRAKE],
    )


@inline_kernel
def _actuators(vehicle, x, command, d):
    """First-order lags; the steering rate saturates smoothly at ``steer_rate``.

    A lag of zero is carried out as 5 ms, two steps.
    """
    steer, drive, brake = command
    reach = max(vehicle.steer_lag, 0.005) * vehicle.steer_rate
    d[at.STEER] = vehicle.steer_rate * math.tanh((steer - x[at.STEER]) / reach)
    lag = max(vehicle.torque_lag, 0.005)
    d[at.DRIVE] = (drive - x[at.DRIVE]) / lag
    d[at.BRAKE] = (brake - x[at.BRAKE]) / lag


@kernel
def full_derivative(x, command, plant, warm, d, readings):
    """Time derivative of the state into ``d``.

    ``command`` = (steer [rad], drive torque [N m, total at the wheels], brake torque [N m, total]).
    """
    v = plant.vehicle
    N_f, N_r = static_loads(v)
    front, rear = readings[: at.AXLE], readings[at.AXLE : at.MOTION]
    status_f, F_xf, F_yf, S_f, V_f, l_f = _full_axle(
        plant, x, (x[at.STEER], x[at.OMEGA_F]), v.l_f, (N_f, v.k_f, v.c_f), warm[0], front
    )
    status_r, F_xr, F_yr, S_r, V_r, l_r = _full_axle(
        plant, x, (0.0, x[at.OMEGA_R]), -v.l_r, (N_r, v.k_r, v.c_r), warm[1], rear
    )
    v_x, v_y, yaw_rate = x[at.V_X], x[at.V_Y], x[at.YAW_RATE]
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    drag = 0.5 * AIR_DENSITY * v.drag_area * speed
    traction = F_xf + F_xr
    F_x, F_y, M_z = change_body_forces(
        plant.effects, (traction - drag * v_x, F_yf + F_yr - drag * v_y, F_yf * l_f + F_yr * l_r), x, v
    )
    a_x, a_y = F_x / v.m, F_y / v.m
    a_z = pitch_acc = 0.0
    if plant.half_car > 0.5:
        cos = math.cos(x[at.PITCH])
        a_z = (S_f + S_r) / v.m
        pitch_acc = ((S_f * v.l_f - S_r * v.l_r) * cos + traction * v.h_cg * cos) / v.I_y
    yaw_acc = M_z / v.I_z

    cos_yaw, sin_yaw = math.cos(x[at.YAW]), math.sin(x[at.YAW])
    d[at.X] = v_x * cos_yaw - v_y * sin_yaw
    d[at.Y] = v_x * sin_yaw + v_y * cos_yaw
    d[at.YAW] = yaw_rate
    d[at.Z] = x[at.V_Z]
    d[at.PITCH] = x[at.PITCH_RATE]
    d[at.V_X] = a_x + v_y * yaw_rate
    d[at.V_Y] = a_y - v_x * yaw_rate
    d[at.V_Z] = a_z
    d[at.PITCH_RATE] = pitch_acc
    d[at.YAW_RATE] = yaw_acc
    drive_f, brake_f, drive_r, brake_r = _axle_torques(v, x)
    d[at.OMEGA_F] = _spin_acceleration(
        v, x[at.OMEGA_F], readings[at.TORQUE], V_f, drive_f, brake_f, plant.v_eps
    )
    d[at.OMEGA_R] = _spin_acceleration(
        v, x[at.OMEGA_R], readings[at.AXLE + at.TORQUE], V_r, drive_r, brake_r, plant.v_eps
    )
    _actuators(v, x, command, d)
    readings[at.A_X], readings[at.A_Y], readings[at.A_Z] = a_x, a_y, a_z
    readings[at.YAW_ACC], readings[at.PITCH_ACC] = yaw_acc, pitch_acc
    readings[at.STATUS] = max(status_f, status_r)


@kernel
def _slip_stiffness(plant, omega, readings):
    """(dT/ds [N s], dF_l/ds [N s/m]) of an axle, s = r omega - v_l [m/s], neither negative.

    One more evaluation at fixed sinkage and load.
    """
    v = plant.vehicle
    # A step well inside the regularised band, large against rounding; the same forwards and backwards.
    change = math.copysign(1e-4 * (abs(v.r * omega) + plant.v_eps), omega)
    motion = (v.r * omega + change, readings[at.V_L], readings[at.V_C])
    if plant.soil.rigid > 0.5:
        force, _, torque = rigid_forces(plant.soil, v.r, readings[at.N], motion, plant.v_eps)
    else:
        force, _, _, torque = wheel_reaction(
            with_exponent(plant.soil, readings[at.EXPONENT]),
            Wheel(v.r, v.b),
            readings[at.SINKAGE],
            motion,
            plant.v_eps,
            (plant.resultant, plant.fine),
        )
        force *= v.wheels_per_axle
        torque *= v.wheels_per_axle
    return (
        max((torque - readings[at.TORQUE]) / change, 0.0),
        max((force - readings[at.F_L]) / change, 0.0),
    )


@inline_kernel
def _held_spin_stiffness(vehicle, omega, load, brake, v_eps):
    """Secant of the brake and rolling-resistance torque from omega to rest / inertia [1/s], negative.

    The tangent vanishes outside the narrow band around rest, and a braked wheel would jump across
    it at every step; the secant brings it to rest.
    """
    scale = vehicle.r / (0.5 * v_eps)
    x = abs(scale * omega)
    secant = math.tanh(x) / x if x > 1e-6 else 1.0
    resisting = brake + vehicle.rolling_resistance * load * vehicle.r
    return -resisting * secant * scale / (vehicle.wheels_per_axle * vehicle.I_w)


@inline_kernel
def _implicit_slips(plant, x, stiffness, held, gamma_dt, k):
    """Solve (1 - gamma dt J) k = right side, in place, J = sum over axles of u w^T, and ``held``.

    w is the gradient of an axle's slip speed s = r omega - v_l, u what one unit of s does to the
    state through torque and traction: two stiff directions, hence a system of two by two. Without
    the traction in u, a wheel at walking pace on hard ground would pull with the force of the
    wrong speed.
    """
    v = plant.vehicle
    (torque_f, force_f), (torque_r, force_r) = stiffness
    cos, sin = math.cos(x[at.STEER]), math.sin(x[at.STEER])
    lever = v.h_cg * math.cos(x[at.PITCH]) if plant.half_car > 0.5 else 0.0
    pitching = lever * lever / v.I_y
    inertia = v.wheels_per_axle * v.I_w
    free_f, free_r = 1.0 / (1.0 - gamma_dt * held[0]), 1.0 / (1.0 - gamma_dt * held[1])

    forward = k[at.V_X] + lever * k[at.PITCH_RATE]
    left = k[at.V_Y] + v.l_f * k[at.YAW_RATE]
    c_f = v.r * free_f * k[at.OMEGA_F] - cos * forward - sin * left
    c_r = v.r * free_r * k[at.OMEGA_R] - forward
    # 1 - gamma dt w^T u, front and rear, and what each axle's traction does to the other's slip.
    along = 1.0 / v.m + pitching
    across = 1.0 / v.m + v.l_f * v.l_f / v.I_z
    m_ff = 1.0 + gamma_dt * (
        v.r * free_f * torque_f / inertia + force_f * (cos * cos * along + sin * sin * across)
    )
    m_rr = 1.0 + gamma_dt * (v.r * free_r * torque_r / inertia + force_r * along)
    m_fr, m_rf = gamma_dt * force_r * cos * along, gamma_dt * force_f * cos * along
    determinant = m_ff * m_rr - m_fr * m_rf
    s_f = gamma_dt * (m_rr * c_f - m_fr * c_r) / determinant
    s_r = gamma_dt * (m_ff * c_r - m_rf * c_f) / determinant

    k[at.OMEGA_F] = free_f * (k[at.OMEGA_F] - torque_f / inertia * s_f)
    k[at.OMEGA_R] = free_r * (k[at.OMEGA_R] - torque_r / inertia * s_r)
    traction = force_f * cos * s_f + force_r * s_r
    side = force_f * sin * s_f
    k[at.V_X] += traction / v.m
    k[at.V_Y] += side / v.m
    k[at.YAW_RATE] += side * v.l_f / v.I_z
    if plant.half_car > 0.5:
        k[at.PITCH_RATE] += traction * lever / v.I_y


@inline_kernel
def _side_stiffness(readings):
    """-F_c/v_c of an axle [N s/m]: the secant, at least as steep as the tangent; 0 without side slip."""
    v_c = readings[at.V_C]
    return max(-readings[at.F_C] / v_c, 0.0) if abs(v_c) > 1e-9 else 0.0


@inline_kernel
def _implicit_sides(plant, x, stiffness, gamma_dt, k):
    """Solve (1 - gamma dt J) k = right side, in place, J = - sum over axles of S M^-1 w w^T.

    w is the gradient of an axle's side speed v_c, S its stiffness: near standstill the side force
    is as stiff as the traction.
    """
    v = plant.vehicle
    cos, sin = math.cos(x[at.STEER]), math.sin(x[at.STEER])
    lever = v.h_cg * math.cos(x[at.PITCH]) if plant.half_car > 0.5 else 0.0
    s_f, s_r = gamma_dt * stiffness[0], gamma_dt * stiffness[1]
    m_ff = 1.0 + s_f * (
        sin * sin * (1.0 / v.m + lever * lever / v.I_y) + cos * cos * (1.0 / v.m + v.l_f * v.l_f / v.I_z)
    )
    m_rr = 1.0 + s_r * (1.0 / v.m + v.l_r * v.l_r / v.I_z)
    cross = cos * (1.0 / v.m - v.l_f * v.l_r / v.I_z)
    c_f = cos * (k[at.V_Y] + v.l_f * k[at.YAW_RATE]) - sin * (k[at.V_X] + lever * k[at.PITCH_RATE])
    c_r = k[at.V_Y] - v.l_r * k[at.YAW_RATE]
    determinant = m_ff * m_rr - s_f * s_r * cross * cross
    push_f = -s_f * (m_rr * c_f - s_r * cross * c_r) / determinant
    push_r = -s_r * (m_ff * c_r - s_f * cross * c_f) / determinant
    k[at.V_X] -= sin * push_f / v.m
    k[at.V_Y] += (cos * push_f + push_r) / v.m
    k[at.YAW_RATE] += (cos * v.l_f * push_f - v.l_r * push_r) / v.I_z
    if plant.half_car > 0.5:
        k[at.PITCH_RATE] -= sin * lever * push_f / v.I_y


@kernel
def _stiffness(plant, x, readings):
    """What the Jacobian holds: (slip, held, side), each front and rear."""
    v = plant.vehicle
    front, rear = readings[: at.AXLE], readings[at.AXLE : at.MOTION]
    _, brake_f, _, brake_r = _axle_torques(v, x)
    omega_f, omega_r = x[at.OMEGA_F], x[at.OMEGA_R]
    return (
        (_slip_stiffness(plant, omega_f, front), _slip_stiffness(plant, omega_r, rear)),
        (
            _held_spin_stiffness(v, omega_f, front[at.N], brake_f, plant.v_eps),
            _held_spin_stiffness(v, omega_r, rear[at.N], brake_r, plant.v_eps),
        ),
        (_side_stiffness(front), _side_stiffness(rear)),
    )


@kernel
def _solve_stages(plant, x, stiffness, gamma_dt, k):
    """Solve (1 - gamma dt J) k = right side, in place, along and then across the wheels."""
    slip, held, side = stiffness
    _implicit_slips(plant, x, slip, held, gamma_dt, k)
    _implicit_sides(plant, x, side, gamma_dt, k)


@kernel
def _stages(x, warm, command, plant, stiffness, dt, work):
    """(status, spin error [m/s]) of a step of ``dt`` from the slope work[0]; stages into work[1], work[2]."""
    slope, k_1, k_2, stage, later = work[0], work[1], work[2], work[3], work[4]
    size = x.shape[0]
    for i in range(size):
        k_1[i] = slope[i]
    _solve_stages(plant, x, stiffness, _GAMMA * dt, k_1)
    for i in range(size):
        stage[i] = x[i] + dt * k_1[i]
    full_derivative(stage, command, plant, warm, k_2, later)
    for i in range(size):
        k_2[i] -= 2.0 * k_1[i]
    _solve_stages(plant, x, stiffness, _GAMMA * dt, k_2)
    front, rear = k_1[at.OMEGA_F] + k_2[at.OMEGA_F], k_1[at.OMEGA_R] + k_2[at.OMEGA_R]
    return later[at.STATUS], 0.5 * dt * plant.vehicle.r * max(abs(front), abs(rear))


@kernel
def full_step(x, warm, command, plant, dt, work, readings):
    """One step of a two-stage Rosenbrock W-method of order 2, implicit in the wheels' slip, in place.

    Verwer, Spee, Blom & Hundsdorfer, SIAM J. Sci. Comput. 20 (1999), eq. 2.4: order 2 for any
    approximate Jacobian, so it may hold nothing but the stiff directions, and be the product of two
    factors, along and across the wheels. The spin rate constant reaches 1e4 1/s at walking pace,
    where an explicit method needs steps of 0.2 ms. Where a wheel grips or locks within a step, the
    two stages disagree, and the step is taken in parts. Returns the worst contact status;
    ``readings`` belong to the state before the step. ``work`` (6, READINGS_SIZE).
    """
    k_1, k_2, again = work[1], work[2], work[5]
    full_derivative(x, command, plant, warm, work[0], readings)
    stiffness = _stiffness(plant, x, readings)
    status = readings[at.STATUS]
    part, left = dt, dt
    while True:
        later, error = _stages(x, warm, command, plant, stiffness, part, work)
        if error > _SPIN_ERROR * plant.v_eps and part > _SHORTEST * dt:
            part *= 0.5
            continue
        status = max(status, later)
        for i in range(x.shape[0]):
            x[i] += part * (1.5 * k_1[i] + 0.5 * k_2[i])
        left -= part
        if left < 1e-9 * dt:
            return status
        full_derivative(x, command, plant, warm, work[0], again)
        stiffness = _stiffness(plant, x, again)
        status = max(status, again[at.STATUS])


@kernel
def full_advance(x, warm, command, plant, dt, steps, readings):
    """``steps`` steps of ``dt`` under a held command, in place; returns the worst contact status.

    ``readings`` become those of the state reached, so a sensor sees no lag. Stops at a state that
    is not finite or has no contact solution, with status NO_ROOT.
    """
    work = np.empty((WORK_ROWS, at.READINGS_SIZE))
    worst = 0.0
    for _ in range(steps):
        worst = max(worst, full_step(x, warm, command, plant, dt, work, readings))
        if worst >= NO_ROOT or not np.isfinite(x).all():
            return NO_ROOT
    full_derivative(x, command, plant, warm, work[0], readings)
    return max(worst, readings[at.STATUS])
