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
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.contact import NO_ROOT
from offroad_env.physics.hooks import change_body_forces, change_load
from offroad_env.physics.numerics import AIR_DENSITY, all_finite, sin_cos
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

__all__ = ["WORK_ROWS", "full_advance", "full_continue", "full_derivative", "full_step"]

#: L-stable choice of the two-stage Rosenbrock method.
_GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
#: Error of a rim speed, as a share of v_eps, above which a step is halved; the shortest part of a step.
_SPIN_ERROR, _SHORTEST = 0.2, 0.1
#: Rows of the scratch array of `full_step`.
WORK_ROWS = 7
# The row that holds the Jacobian, front and rear: torque and traction over slip speed (`_slip_stiffness`),
# what brakes and bearings hold (`_held_spin_stiffness`), side force over side speed (`_side_stiffness`).
_SLIP_TORQUE, _SLIP_FORCE, _HELD, _SIDE = 0, 2, 4, 6


@merged_kernel
def _full_axle(plant, x, angles, arm, suspension, warm, readings):
    """(status, F_forward, F_left, F_s, V, arm) of one axle in heading axes, on its slope.

    ``angles`` = (sin, cos) of yaw, pitch and steering; ``suspension`` = (N_static, k, c, omega).
    """
    N_static, k, c, omega = suspension
    yaw, (sin, cos), (sin_d, cos_d) = angles
    v = plant.vehicle
    forward, pitch_rate = x[at.V_X], x[at.PITCH_RATE]
    reach = arm
    if plant.half_car > 0.5:
        reach += v.h_cg * sin
        forward += v.h_cg * cos * pitch_rate
    wx, wy, H, H_dot, H_ddot, u_l, u_c, g_l, g_c = axle_motion(
        plant.ground,
        (x[at.X], x[at.Y], yaw),
        (forward, x[at.V_Y], x[at.YAW_RATE]),
        reach,
        (sin_d, cos_d),
    )
    N_0, inertia = N_static, 0.0
    if plant.half_car > 0.5:
        z = x[at.Z] + arm * sin
        z_dot = x[at.V_Z] + arm * cos * pitch_rate
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
    F_s = suspension_force(V, N_static, inertia)
    return status, F_l * cos_d - F_c * sin_d, F_l * sin_d + F_c * cos_d, F_s, V, reach


@inline_kernel
def _spin_acceleration(vehicle, omega, soil_torque, load, torques, v_eps):
    """Angular acceleration of an axle's wheels [rad/s^2]; ``torques`` = (drive, brake) [N m].

    Brakes and rolling resistance oppose the spin; tanh over ``v_eps`` lets a held wheel creep
    instead of chattering around zero.
    """
    drive, brake = torques
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
    yaw, pitch, wheel = sin_cos(x[at.YAW]), sin_cos(x[at.PITCH]), sin_cos(x[at.STEER])
    drive_f, brake_f, drive_r, brake_r = _axle_torques(v, x)
    torques = drive_f, brake_f
    worst = traction = side = lift = pitching = yawing = 0.0
    # A loop and not two calls: each axle would be translated on its own.
    for axle in range(2):
        arm, suspension = v.l_f, (N_f, v.k_f, v.c_f, x[at.OMEGA_F])
        if axle == 1:
            arm, suspension = -v.l_r, (N_r, v.k_r, v.c_r, x[at.OMEGA_R])
            wheel, torques = (0.0, 1.0), (drive_r, brake_r)
        seen = readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        status, F_x, F_y, F_s, V, reach = _full_axle(
            plant, x, (yaw, pitch, wheel), arm, suspension, warm[axle], seen
        )
        d[at.OMEGA_F + axle] = _spin_acceleration(v, suspension[3], seen[at.TORQUE], V, torques, plant.v_eps)
        worst = max(worst, status)
        traction += F_x
        side += F_y
        lift += F_s
        pitching += F_s * arm
        yawing += F_y * reach
    v_x, v_y, yaw_rate = x[at.V_X], x[at.V_Y], x[at.YAW_RATE]
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    drag = 0.5 * AIR_DENSITY * v.drag_area * speed
    forces = (traction - drag * v_x, side - drag * v_y, yawing)
    F_x, F_y, M_z = change_body_forces(plant.effects, forces, x, v)
    a_x, a_y = F_x / v.m, F_y / v.m
    a_z = pitch_acc = 0.0
    if plant.half_car > 0.5:
        a_z = lift / v.m
        pitch_acc = (pitching + traction * v.h_cg) * pitch[1] / v.I_y
    yaw_acc = M_z / v.I_z

    d[at.X] = v_x * yaw[1] - v_y * yaw[0]
    d[at.Y] = v_x * yaw[0] + v_y * yaw[1]
    d[at.YAW] = yaw_rate
    d[at.Z] = x[at.V_Z]
    d[at.PITCH] = x[at.PITCH_RATE]
    d[at.V_X] = a_x + v_y * yaw_rate
    d[at.V_Y] = a_y - v_x * yaw_rate
    d[at.V_Z] = a_z
    d[at.PITCH_RATE] = pitch_acc
    d[at.YAW_RATE] = yaw_acc
    _actuators(v, x, command, d)
    readings[at.A_X], readings[at.A_Y], readings[at.A_Z] = a_x, a_y, a_z
    readings[at.YAW_ACC], readings[at.PITCH_ACC] = yaw_acc, pitch_acc
    readings[at.STATUS] = worst


@merged_kernel
def _plain_reaction(plant, motion, readings):
    """(F_l, torque) of an axle for ``motion`` by the base model's law, sinkage and load of ``readings``."""
    v = plant.vehicle
    if plant.soil.rigid > 0.5:
        force, _, torque = rigid_forces(plant.soil, v.r, readings[at.N], motion, plant.v_eps)
        return force, torque
    force, _, _, torque = wheel_reaction(
        with_exponent(plant.soil, readings[at.EXPONENT]),
        Wheel(v.r, v.b),
        readings[at.SINKAGE],
        motion,
        plant.v_eps,
        (plant.resultant, plant.fine),
    )
    return v.wheels_per_axle * force, v.wheels_per_axle * torque


@inline_kernel
def _reaction_before(effects, plant, motion, readings):
    """(F_l, torque) of an axle that a change of its slip starts from; effects have changed the readings'."""
    if effects is None:
        return readings[at.F_L], readings[at.TORQUE]
    return _plain_reaction(plant, motion, readings)


@merged_kernel
def _slip_stiffness(plant, omega, readings):
    """(dT/ds [N s], dF_l/ds [N s/m]) of an axle, s = r omega - v_l [m/s], neither negative.

    One more evaluation at fixed sinkage and load.
    """
    rim, v_l, v_c = plant.vehicle.r * omega, readings[at.V_L], readings[at.V_C]
    # A step well inside the regularised band, large against rounding; the same forwards and backwards.
    change = math.copysign(1e-4 * (abs(rim) + plant.v_eps), omega)
    force, torque = _plain_reaction(plant, (rim + change, v_l, v_c), readings)
    force_before, torque_before = _reaction_before(plant.effects, plant, (rim, v_l, v_c), readings)
    return max((torque - torque_before) / change, 0.0), max((force - force_before) / change, 0.0)


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
def _implicit_slips(plant, x, stiffness, gamma_dt, k):
    """Solve (1 - gamma dt J) k = right side, in place, J = sum over axles of u w^T, and what holds the spin.

    w is the gradient of an axle's slip speed s = r omega - v_l, u what one unit of s does to the
    state through torque and traction: two stiff directions, hence a system of two by two. Without
    the traction in u, a wheel at walking pace on hard ground would pull with the force of the
    wrong speed.
    """
    v = plant.vehicle
    torque_f, torque_r = stiffness[_SLIP_TORQUE], stiffness[_SLIP_TORQUE + 1]
    force_f, force_r = stiffness[_SLIP_FORCE], stiffness[_SLIP_FORCE + 1]
    sin, cos = sin_cos(x[at.STEER])
    lever = v.h_cg * sin_cos(x[at.PITCH])[1] if plant.half_car > 0.5 else 0.0
    pitching = lever * lever / v.I_y
    inertia = v.wheels_per_axle * v.I_w
    free_f = 1.0 / (1.0 - gamma_dt * stiffness[_HELD])
    free_r = 1.0 / (1.0 - gamma_dt * stiffness[_HELD + 1])

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
    sin, cos = sin_cos(x[at.STEER])
    lever = v.h_cg * sin_cos(x[at.PITCH])[1] if plant.half_car > 0.5 else 0.0
    s_f, s_r = gamma_dt * stiffness[_SIDE], gamma_dt * stiffness[_SIDE + 1]
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
def _stiffness(plant, x, readings, stiffness):
    """What the Jacobian holds, into ``stiffness``: see `_SLIP_TORQUE` and what follows it."""
    v = plant.vehicle
    _, brake_f, _, brake_r = _axle_torques(v, x)
    brake = brake_f
    for axle in range(2):
        omega, seen = x[at.OMEGA_F + axle], readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        stiffness[_SLIP_TORQUE + axle], stiffness[_SLIP_FORCE + axle] = _slip_stiffness(plant, omega, seen)
        stiffness[_HELD + axle] = _held_spin_stiffness(v, omega, seen[at.N], brake, plant.v_eps)
        stiffness[_SIDE + axle] = _side_stiffness(seen)
        brake = brake_r


@kernel
def _solve_stages(plant, x, stiffness, gamma_dt, k):
    """Solve (1 - gamma dt J) k = right side, in place, along and then across the wheels."""
    _implicit_slips(plant, x, stiffness, gamma_dt, k)
    _implicit_sides(plant, x, stiffness, gamma_dt, k)


@merged_kernel
def _stages(x, warm, command, plant, dt, work):
    """(status, spin error [m/s]) of a step of ``dt`` from the slope work[0]; stages into work[1], work[2]."""
    slope, k_1, k_2, stage, later, stiffness = work[0], work[1], work[2], work[3], work[4], work[5]
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
def _step(x, warm, command, plant, dt, known, onward, arrays):
    """A step from the slope work[0] at ``x``, in place; returns the worst contact status on the way.

    ``known`` takes the Jacobian of the step before, in work[5]; ``onward`` leaves in work[0] and
    ``after`` the slope and readings of the state reached. Both are 0.0 or 1.0: for literal bools
    numba would compile every pair.
    ``arrays`` = (work, readings at ``x``, after). See `full_step`.
    """
    work, seen, after = arrays
    k_1, k_2 = work[1], work[2]
    part, left, worst = dt, dt, 0.0
    while True:
        if known < 0.5:
            _stiffness(plant, x, seen, work[5])
        while True:
            status, error = _stages(x, warm, command, plant, part, work)
            if not (error > _SPIN_ERROR * plant.v_eps and (known > 0.5 or part > _SHORTEST * dt)):
                break
            if known > 0.5:
                _stiffness(plant, x, seen, work[5])
                known = 0.0
            else:
                part *= 0.5
        worst = max(worst, status)
        for i in range(x.shape[0]):
            x[i] += part * (1.5 * k_1[i] + 0.5 * k_2[i])
        left -= part
        finished = left < 1e-9 * dt
        if onward > 0.5 or not finished:
            full_derivative(x, command, plant, warm, work[0], after)
            worst = max(worst, after[at.STATUS])
            seen = after
        if finished:
            return worst


@merged_kernel
def full_step(x, warm, command, plant, dt, work, readings):
    """One step of a two-stage Rosenbrock W-method of order 2, implicit in the wheels' slip, in place.

    Verwer, Spee, Blom & Hundsdorfer, SIAM J. Sci. Comput. 20 (1999), eq. 2.4: order 2 for any
    approximate Jacobian, so it may hold nothing but the stiff directions, be the product of two
    factors, along and across the wheels, and serve two steps. The spin rate constant reaches 1e4
    1/s at walking pace, where an explicit method needs steps of 0.2 ms. Where a wheel grips or
    locks within a step, the two stages disagree, and the step is taken in parts. Returns the worst
    contact status; ``readings`` belong to the state before the step. ``work`` (WORK_ROWS,
    READINGS_SIZE).
    """
    full_derivative(x, command, plant, warm, work[0], readings)
    status = _step(x, warm, command, plant, dt, 0.0, 0.0, (work, readings, work[6]))
    return max(status, readings[at.STATUS])


@merged_kernel
def full_continue(x, warm, command, plant, timing, work, readings):
    """`full_advance` from a state whose slope and readings are in ``work`` and ``readings`` already.

    As `full_advance` and this function leave them, under whatever command: that enters the slope
    through the actuators only. ``timing`` = (dt [s], steps). Every other step takes the Jacobian of
    the step before it.
    """
    dt, steps = timing
    worst = readings[at.STATUS]
    _actuators(plant.vehicle, x, command, work[0])
    for i in range(steps):
        arrays = (work, readings, readings)
        worst = max(worst, _step(x, warm, command, plant, dt, float(i % 2), 1.0, arrays))
        if worst >= NO_ROOT or not all_finite(x):
            return NO_ROOT
    return worst


@merged_kernel
def full_advance(x, warm, command, plant, dt, steps, readings):
    """``steps`` steps of ``dt`` under a held command, in place; returns the worst contact status.

    ``readings`` become those of the state reached, so a sensor sees no lag. Stops at a state that
    is not finite or has no contact solution, with status NO_ROOT.
    """
    work = np.empty((WORK_ROWS, at.READINGS_SIZE))
    full_derivative(x, command, plant, warm, work[0], readings)
    return full_continue(x, warm, command, plant, (dt, steps), work, readings)
