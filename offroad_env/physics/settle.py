"""Where a vehicle rests on its soil: the start of a simulation.

Started elsewhere, a vehicle falls or rises at first, and the first vertical acceleration reveals the
soil. Here both axles carry their static loads, follow the ground, and the wheels roll without torque.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import (
    AxleMotion,
    AxleReaction,
    AxleStance,
    Plant,
    Pose,
    Velocity,
    axle_contact,
    axle_motion,
    contact_columns,
    static_loads,
    with_exponent,
)
from offroad_env.physics.contact import CONTACT, Support
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.records import FloatArray, Structure, Wheel, WheelMotion
from offroad_env.physics.ruts import Place, follow_rut, prefill_track, track_spacing
from offroad_env.physics.slip import constant_slip_rim
from offroad_env.physics.structured_contact import deflection_on_soil

__all__ = ["settle"]


class Rolling(NamedTuple):
    """An axle of a vehicle that rolls straight on."""

    motion: AxleMotion
    arm: float  #: distance ahead of the CG [m]
    N_0: float  #: load [N]


@kernel
def _rest(plant: Plant, axle: Rolling, rim: float, warm: FloatArray, readings: FloatArray) -> AxleReaction:
    """Reaction of an axle whose wheels turn at the rim speed ``rim`` [m/s].

    The paper's model knows no slopes.
    """
    motion = axle.motion
    g_l, g_c = motion.g_l, motion.g_c
    if plant.resultant < 0.5:
        g_l = g_c = 0.0
    turning = WheelMotion(rim, motion.u_l, motion.u_c)
    stance = AxleStance(motion.x, motion.y, motion.H, g_l, g_c, axle.arm)
    support = Support(axle.N_0, 0.0, plant.vehicle.wheels_per_axle)
    return axle_contact(plant, turning, stance, support, warm, readings)


@merged_kernel
def _rolling_rim(plant: Plant, axle: Rolling, warm: FloatArray, readings: FloatArray) -> float:
    """Rim speed [m/s] of an axle whose soil torque is zero; 0 at rest.

    Regula falsi with halving (Illinois) between 0.5 and 1.5 of the travel speed.
    """
    u_l = axle.motion.u_l
    if u_l <= 0.0:
        return 0.0
    low, high, T_low, T_high = 0.5 * u_l, 1.5 * u_l, math.nan, math.nan
    rim, side = low, 0.0
    for _ in range(80):
        T = _rest(plant, axle, rim, warm, readings).torque
        if math.isnan(T_low):
            T_low, rim = T, high
            continue
        if math.isnan(T_high):
            T_high = T
        elif abs(T) < 1e-9 * axle.N_0 or high - low < 1e-12 * u_l:
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


@inline_kernel
def _come_straight(
    structure: Structure | None, row: FloatArray, place: Place, sinkage: float, wheelbase: float
) -> None:
    """The track of a wheel that has come straight to a place."""
    if structure is None:
        return
    prefill_track(structure, row, place, sinkage, track_spacing(wheelbase))


@kernel
def settle(
    plant: Plant, pose: tuple[float, float, float], v_x: float
) -> tuple[float, FloatArray, FloatArray]:
    """(worst status, state (15,), warm (2, 3)) of a vehicle settled on the soil at ``pose`` = (X, Y, yaw).

    ``v_x`` [m/s] is its horizontal speed; the axles carry N_static + m_w H_ddot, their heights
    and rates follow the ground. In the full model the wheels turn without soil torque; in the
    paper's the constant slip of the plant sets their speeds.
    """
    x, readings = np.zeros(at.STATE_SIZE), np.empty(at.READINGS_SIZE)
    warm = np.zeros((2, contact_columns(plant.structure)))
    v = plant.vehicle
    X, Y, yaw = pose
    x[at.X], x[at.Y], x[at.YAW], x[at.V_X] = X, Y, yaw, v_x
    loads, direction = static_loads(v), sin_cos(yaw)
    heights, rates = np.zeros(2), np.zeros(2)
    worst = CONTACT
    for i in range(2):
        arm = v.l_f if i == 0 else -v.l_r
        seen = readings[i * at.AXLE : (i + 1) * at.AXLE]
        motion = axle_motion(plant.ground, Pose(X, Y, direction), Velocity(v_x, 0.0, 0.0), arm, (0.0, 1.0))
        axle = Rolling(motion, arm, loads[i] + v.m_w * motion.H_ddot)
        if i == 1:
            follow_rut(plant.structure, warm[0], warm[1], v.b, motion.x, motion.y)
        if plant.resultant > 0.5:
            rim = _rolling_rim(plant, axle, warm[i], seen)
        else:
            rim = constant_slip_rim(plant.slip, motion.u_l)
        worst = max(worst, _rest(plant, axle, rim, warm[i], seen).status)
        x[at.OMEGA_F + i] = rim / v.r
        soil = with_exponent(plant.soil, seen[at.EXPONENT])
        load = axle.N_0 / v.wheels_per_axle
        lowered = seen[at.SINKAGE] + deflection_on_soil(plant.structure, soil, Wheel(v.r, v.b), load)
        heights[i], rates[i] = motion.H - lowered, motion.H_dot
        if i == 0:
            place = Place(motion.x, motion.y, direction)
            _come_straight(plant.structure, warm[0], place, seen[at.SINKAGE], v.l_f + v.l_r)
    if plant.half_car > 0.5:
        base = v.l_f + v.l_r
        sin = min(max((heights[0] - heights[1]) / base, -1.0), 1.0)
        x[at.PITCH] = math.asin(sin)
        x[at.Z] = heights[1] + v.l_r * sin
        x[at.PITCH_RATE] = (rates[0] - rates[1]) / (base * math.cos(x[at.PITCH]))
        x[at.V_Z] = (rates[0] * v.l_r + rates[1] * v.l_f) / base
    return worst, x, warm
