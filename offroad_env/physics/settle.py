"""Where a vehicle rests: the start of every honest simulation.

An unsettled start hands the soil to the first vertical acceleration sample; here both axles
carry their static loads, follow the ground, and the wheels roll without torque.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel, merged_kernel
from offroad_env.physics.contact import CONTACT
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.vehicle_model import axle_contact, axle_motion, static_loads

__all__ = ["settle"]


@kernel
def _rest(plant, motion, place, N_0, warm, readings):
    """(status, soil torque) of an axle that carries ``N_0`` [N]; ``place`` = (arm [m], rim speed [m/s]).

    The paper's model knows no slopes.
    """
    wx, wy, H, _, _, u_l, u_c, g_l, g_c = motion
    arm, rim = place
    if plant.resultant < 0.5:
        g_l = g_c = 0.0
    status, _, _, _, torque = axle_contact(
        plant, (rim, u_l, u_c), (wx, wy, H, g_l, g_c, arm), (N_0, 0.0), warm, readings
    )
    return status, torque


@merged_kernel
def _rolling_rim(plant, motion, arm, N_0, warm, readings):
    """Rim speed [m/s] of an axle ``arm`` [m] ahead of the CG whose soil torque is zero; 0 at rest.

    Regula falsi with halving (Illinois) between 0.5 and 1.5 of the travel speed.
    """
    u_l = motion[5]
    if u_l <= 0.0:
        return 0.0
    low, high, T_low, T_high = 0.5 * u_l, 1.5 * u_l, math.nan, math.nan
    rim, side = low, 0.0
    for _ in range(80):
        _, T = _rest(plant, motion, (arm, rim), N_0, warm, readings)
        if math.isnan(T_low):
            T_low, rim = T, high
            continue
        if math.isnan(T_high):
            T_high = T
        elif abs(T) < 1e-9 * N_0 or high - low < 1e-12 * u_l:
            break
        elif T > 0.0:
            high, T_high = rim, T
            T_low *= 0.5 if side > 0.0 else 1.0
            side = 1.0
        else:
            low, T_low = rim, T
            T_high *= 0.5 if side < 0.0 else 1.0
            side = -1.0
        rim = (low * T_high - high * T_low) / (T_high - T_low)
    return rim


@kernel
def settle(plant, pose, v_x):
    """(worst status, state (15,), warm (2, 3)) of a vehicle settled on the soil at ``pose`` = (X, Y, yaw).

    ``v_x`` [m/s] is its horizontal speed; the axles carry N_static + m_w H_ddot, their heights
    and rates follow the ground. In the full model the wheels turn without soil torque; in the
    paper's the constant slip of the plant sets their speeds.
    """
    x, warm, readings = np.zeros(at.STATE_SIZE), np.zeros((2, 3)), np.empty(at.READINGS_SIZE)
    v = plant.vehicle
    X, Y, yaw = pose
    x[at.X], x[at.Y], x[at.YAW], x[at.V_X] = X, Y, yaw, v_x
    loads, direction = static_loads(v), sin_cos(yaw)
    heights, rates = np.zeros(2), np.zeros(2)
    worst = CONTACT
    for i in range(2):
        arm = v.l_f if i == 0 else -v.l_r
        seen = readings[i * at.AXLE : (i + 1) * at.AXLE]
        motion = axle_motion(plant.ground, (X, Y, direction), (v_x, 0.0, 0.0), arm, (0.0, 1.0))
        _, _, H, H_dot, H_ddot, u_l, _, _, _ = motion
        N_0 = loads[i] + v.m_w * H_ddot
        if plant.resultant > 0.5:
            rim = _rolling_rim(plant, motion, arm, N_0, warm[i], seen)
        else:
            rim = u_l / (1.0 - plant.slip) if plant.slip >= 0.0 else u_l * (1.0 + plant.slip)
        status, _ = _rest(plant, motion, (arm, rim), N_0, warm[i], seen)
        worst = max(worst, status)
        x[at.OMEGA_F + i] = rim / v.r
        heights[i], rates[i] = H - seen[at.SINKAGE], H_dot
    if plant.half_car > 0.5:
        base = v.l_f + v.l_r
        sin = min(max((heights[0] - heights[1]) / base, -1.0), 1.0)
        x[at.PITCH] = math.asin(sin)
        x[at.Z] = heights[1] + v.l_r * sin
        x[at.PITCH_RATE] = (rates[0] - rates[1]) / (base * math.cos(x[at.PITCH]))
        x[at.V_Z] = (rates[0] * v.l_r + rates[1] * v.l_f) / base
    return worst, x, warm
