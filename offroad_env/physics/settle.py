"""Where a vehicle rests: the start of every honest simulation.

An unsettled start hands the soil to the first vertical acceleration sample; here both axles
carry their static loads, follow the ground, and the wheels roll without torque.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import CONTACT
from offroad_env.physics.vehicle_model import axle_contact, axle_motion, static_loads

__all__ = ["settle"]


@kernel
def _rolling_contact(plant, motion, N_static, warm, readings, first):
    """(status, r omega) of an axle under its static load whose soil torque is zero.

    Regula falsi with halving (Illinois) on the rim speed between locked and 2 v; at rest the rim
    does not turn.
    """
    wx, wy, H, _, H_ddot, u_l, u_c, g_l, g_c = motion
    place = (wx, wy, H, g_l, g_c)
    support = (N_static + plant.vehicle.m_w * H_ddot, 0.0)
    if u_l <= 0.0:
        status, _, _, _, _ = axle_contact(plant, (0.0, u_l, u_c), place, support, warm, readings, first)
        return status, 0.0
    low, high = 0.5 * u_l, 1.5 * u_l
    status, _, _, _, T_low = axle_contact(plant, (low, u_l, u_c), place, support, warm, readings, first)
    status, _, _, _, T_high = axle_contact(plant, (high, u_l, u_c), place, support, warm, readings, first)
    rim = u_l
    side = 0.0
    for _ in range(80):
        rim = (low * T_high - high * T_low) / (T_high - T_low)
        status, _, _, _, T = axle_contact(plant, (rim, u_l, u_c), place, support, warm, readings, first)
        if abs(T) < 1e-9 * N_static or high - low < 1e-12 * u_l:
            break
        if T > 0.0:
            high, T_high = rim, T
            if side > 0.0:
                T_low *= 0.5
            side = 1.0
        else:
            low, T_low = rim, T
            if side < 0.0:
                T_high *= 0.5
            side = -1.0
    return status, rim


@kernel
def settle(plant, pose, v_x, torque_free):
    """(worst status, state (15,), warm (2, 3)) of a vehicle settled on the soil at ``pose`` = (X, Y, yaw).

    ``v_x`` [m/s] is its horizontal speed; the axles carry N_static + m_w H_ddot, their heights
    and rates follow the ground. ``torque_free`` finds the rim speeds without soil torque (full
    model); otherwise the constant slip of the plant sets them (paper).
    """
    x, warm, readings = np.zeros(at.STATE_SIZE), np.zeros((2, 3)), np.empty(at.READINGS_SIZE)
    v = plant.vehicle
    X, Y, yaw = pose
    x[at.X], x[at.Y], x[at.YAW], x[at.V_X] = X, Y, yaw, v_x
    loads = static_loads(v)
    heights, rates = np.zeros(2), np.zeros(2)
    worst = CONTACT
    for i in range(2):
        arm = v.l_f if i == 0 else -v.l_r
        first = i * at.AXLE
        motion = axle_motion(plant.ground, pose, (v_x, 0.0, 0.0), arm, 0.0)
        wx, wy, H, H_dot, H_ddot, u_l, u_c, _, _ = motion
        if torque_free:
            status, rim = _rolling_contact(plant, motion, loads[i], warm[i], readings, first)
        else:
            rim = u_l / (1.0 - plant.slip) if plant.slip >= 0.0 else u_l * (1.0 + plant.slip)
            support = (loads[i] + v.m_w * H_ddot, 0.0)
            status, _, _, _, _ = axle_contact(
                plant, (rim, u_l, u_c), (wx, wy, H, 0.0, 0.0), support, warm[i], readings, first
            )
        worst = max(worst, status)
        x[at.OMEGA_F + i] = rim / v.r
        heights[i], rates[i] = H - readings[first + at.SINKAGE], H_dot
    if plant.half_car > 0.5:
        base = v.l_f + v.l_r
        sin = min(max((heights[0] - heights[1]) / base, -1.0), 1.0)
        x[at.PITCH] = math.asin(sin)
        x[at.Z] = heights[1] + v.l_r * sin
        x[at.PITCH_RATE] = (rates[0] - rates[1]) / (base * math.cos(x[at.PITCH]))
        x[at.V_Z] = (rates[0] * v.l_r + rates[1] * v.l_f) / base
    return worst, x, warm
