"""What the two vehicle models share: axles on uneven ground, and the record of a plant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, merged_kernel
from offroad_env.physics.contact import slope_frame, solve_contact
from offroad_env.physics.ground import ground_readings, sinkage_exponent
from offroad_env.physics.hooks import change_soil, change_wheel_forces
from offroad_env.physics.numerics import GRAVITY, smooth_step
from offroad_env.physics.records import Ground, Soil, SoilMap, Vehicle, Wheel
from offroad_env.physics.wheel_soil import slip_ratio

__all__ = [
    "Plant",
    "axle_contact",
    "axle_motion",
    "static_loads",
    "suspension_force",
    "suspension_load",
    "with_exponent",
    "with_pressure",
]


class Plant(NamedTuple):
    """Everything a model needs besides its state: truth and belief are two plants."""

    vehicle: Vehicle
    soil: Soil
    ground: Ground
    soil_map: SoilMap
    slip: float  #: constant slip of the paper's model [-]
    resultant: float  #: 1.0 = shear stresses share one strength
    half_car: float  #: 1.0 = heave and pitch move, 0.0 = bicycle with static loads
    v_eps: float  #: low-speed regularisation [m/s]
    fine: bool  #: reference quadrature instead of the fast one
    effects: np.ndarray | None = None  #: rows of `hooks`; None = the base model, without any trace of them


@inline_kernel
def with_pressure(soil, n, factor):
    """The same soil with exponent ``n`` and ``factor`` times the moduli (numba knows no ``_replace``)."""
    return Soil(
        factor * soil.k_c,
        factor * soil.k_phi,
        n,
        soil.c,
        soil.phi,
        soil.k_x,
        soil.k_y,
        soil.a_0,
        soil.a_1,
        soil.b_0,
        soil.b_1,
        soil.rigid,
        soil.mu,
        soil.C_alpha,
        soil.C_kappa,
    )


@inline_kernel
def with_exponent(soil, n):
    """The same soil with another sinkage exponent."""
    return with_pressure(soil, n, 1.0)


@inline_kernel
def static_loads(vehicle):
    """(front, rear) static axle loads m g l_r/L and m g l_f/L [N] (the paper writes m g/2)."""
    total = vehicle.m * GRAVITY / (vehicle.l_f + vehicle.l_r)
    return total * vehicle.l_r, total * vehicle.l_f


@merged_kernel
def axle_motion(ground, pose, velocity, arm, steer):
    """An axle over the ground.

    Parameters
    ----------
    pose : (X, Y, (sin yaw, cos yaw)) of the CG
    velocity : (forward, left, yaw rate) of the CG in heading axes
    arm : distance ahead of the CG [m]
    steer : (sin, cos) of the steering angle

    Returns
    -------
    (x, y, H, H_dot, H_ddot, u_l, u_c, g_l, g_c): wheel position [m], ground height [m], its first
    and second time derivative along the wheel's path by gradient and Hessian (grad(H).a
    neglected, the paper's contact assumption), horizontal velocity along and across the wheel
    [m/s] (BT tan beta), ground slopes along and across the wheel [-].
    """
    X, Y, (sin, cos) = pose
    forward, left, yaw_rate = velocity
    x, y = X + arm * cos, Y + arm * sin
    side = left + arm * yaw_rate
    v_X, v_Y = forward * cos - side * sin, forward * sin + side * cos
    H, H_X, H_Y, H_XX, H_XY, H_YY = ground_readings(ground, x, y)
    H_dot = H_X * v_X + H_Y * v_Y
    H_ddot = H_XX * v_X * v_X + 2.0 * H_XY * v_X * v_Y + H_YY * v_Y * v_Y
    sin_d, cos_d = steer
    g_x, g_y = H_X * cos + H_Y * sin, H_Y * cos - H_X * sin
    return (
        x,
        y,
        H,
        H_dot,
        H_ddot,
        forward * cos_d + side * sin_d,
        side * cos_d - forward * sin_d,
        g_x * cos_d + g_y * sin_d,
        g_y * cos_d - g_x * sin_d,
    )


@inline_kernel
def suspension_load(N_static, k, c, m_w, heights):
    """(N_0, inertia) of an axle: its load on ground that does not yield (BT N), and the share of the wheel.

    ``heights`` = (z_axle, z_axle_dot, H, H_dot, H_ddot). The load at sinkage h is N_0 - k h; the
    sinkage rate is neglected in the damper. Where the spring is slack the wheel hangs free: damper
    and inertia of the wheel, which presume that it follows the ground, fade out below 0.2 of the
    static load, so a falling vehicle feels the ground only when its wheels reach it.
    """
    z, z_dot, H, H_dot, H_ddot = heights
    spring = N_static - k * (z - H)
    follows = smooth_step(spring / (0.2 * N_static))
    inertia = m_w * H_ddot * follows
    return spring - c * (z_dot - H_dot) * follows + inertia, inertia


@inline_kernel
def suspension_force(N, N_static, inertia):
    """Force of the suspension on the body, relative to static equilibrium [N].

    In contact N - N_static - m_w H_ddot, the paper's spring and damper. In the air the ground
    never pulls: N = 0 leaves -N_static, the weight.
    """
    return N - N_static - inertia


@merged_kernel
def axle_contact(plant, motion, place, support, warm, readings):
    """Solve one axle's contact and note it in ``readings``, the axle's part of the readings.

    ``motion`` = (r omega, v_l, v_c), ``place`` = (x, y, H, g_l, g_c, arm), ``support`` = (N_0, k).
    Returns (status, F_l, F_c, V, torque) in the wheel's horizontal axes: along, across, up.
    """
    x, y, H, g_l, g_c, arm = place
    vehicle = plant.vehicle
    n = sinkage_exponent(plant.soil_map, plant.soil.n, x, y)
    soil = change_soil(plant.effects, with_exponent(plant.soil, n), motion, (x, y, arm, plant.v_eps))
    frame = slope_frame(g_l, g_c)
    status, F_x, F_y, F_n, T, h = solve_contact(
        soil,
        Wheel(vehicle.r, vehicle.b),
        motion,
        frame,
        (support[0], support[1], vehicle.wheels_per_axle),
        warm,
        (plant.v_eps, plant.resultant, plant.fine),
    )
    F_x, F_y, T = change_wheel_forces(
        plant.effects, (F_x, F_y, T), motion, (F_n, h, arm, plant.v_eps), vehicle
    )
    l_x, l_z, c_x, c_y, c_z, n_x, n_y, n_z = frame
    V = F_x * l_z + F_y * c_z + F_n * n_z
    readings[at.N] = F_n
    readings[at.F_L] = F_x
    readings[at.F_C] = F_y
    readings[at.TORQUE] = T
    readings[at.SINKAGE] = h
    readings[at.SLIP] = slip_ratio(motion[0], motion[1], plant.v_eps)
    readings[at.R_OMEGA] = motion[0]
    readings[at.V_L] = motion[1]
    readings[at.V_C] = motion[2]
    readings[at.EXPONENT] = soil.n
    readings[at.WHEEL_X] = x
    readings[at.WHEEL_Y] = y
    readings[at.HEIGHT] = H
    return status, F_x * l_x + F_y * c_x + F_n * n_x, F_y * c_y + F_n * n_y, V, T
