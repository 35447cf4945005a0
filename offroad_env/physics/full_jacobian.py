"""The stiff directions of the half-car: what its integrator takes implicitly.

Near standstill and at small slips a wheel's spin, its traction and its side force answer to a change of
speed within milliseconds. The approximate Jacobian holds these and nothing else: the slip along each
wheel, what brakes and bearings hold, and the side speed of each axle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import Plant, contact_options, soil_under
from offroad_env.physics.full_dynamics import axle_torques
from offroad_env.physics.hard_ground import hard_ground_forces
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.records import FloatArray, Structure, Vehicle, Wheel, WheelMotion
from offroad_env.physics.structured_contact import reaction_at_sinkage, rut_section_of

__all__ = [
    "Slope",
    "axle_stiffnesses",
    "held_spin_stiffness",
    "side_stiffness",
    "slip_stiffness",
    "solve_axle_stages",
]

# The row that holds the Jacobian, front and rear: torque and traction over slip speed (`slip_stiffness`),
# what brakes and bearings hold (`held_spin_stiffness`), side force over side speed (`side_stiffness`).
_SLIP_TORQUE, _SLIP_FORCE, _HELD, _SIDE = 0, 2, 4, 6


class Slope(NamedTuple):
    """Where a step begins to go."""

    derivative: FloatArray  #: of the state
    dt: float  #: length of the step [s]


@merged_kernel
def _plain_reaction(
    plant: Plant, motion: WheelMotion, warm: FloatArray, readings: FloatArray
) -> tuple[float, float]:
    """(F_l, torque) of an axle for ``motion`` by the base model's law, sinkage and load of ``readings``."""
    v = plant.vehicle
    if plant.soil.rigid > 0.5:
        hard = hard_ground_forces(plant.soil, v.r, readings[at.N], motion, plant.v_eps)
        return hard.F_x, hard.torque
    soil = soil_under(plant, readings)
    wheel = Wheel(v.r, v.b)
    options = contact_options(plant)
    one = reaction_at_sinkage(
        plant.structure,
        soil,
        wheel,
        motion,
        readings[at.SINKAGE],
        readings[at.N] / v.wheels_per_axle,
        rut_section_of(plant.structure, warm),
        options,
    )
    return v.wheels_per_axle * one.F_x, v.wheels_per_axle * one.torque


@inline_kernel
def _reaction_before(
    effects: FloatArray | None, plant: Plant, motion: WheelMotion, warm: FloatArray, readings: FloatArray
) -> tuple[float, float]:
    """(F_l, torque) of an axle that a change of its slip starts from; effects have changed the readings'."""
    if effects is None:
        return readings[at.F_L], readings[at.TORQUE]
    return _plain_reaction(plant, motion, warm, readings)


@inline_kernel
def _slip_change(
    structure: Structure | None, omega: float, small: float, ahead: float, v_eps: float
) -> float:
    """Change of a rim speed over which its stiffness is taken [m/s]; ``ahead``: what the step begins with.

    Where shear follows the soil's path, slip that changes its sign does so at the bottom of the wheel first,
    and the torque grows like the root of the slip: the tangent says little of what a step meets, the secant
    over as much as the wheel is about to gain does.
    """
    if structure is None:
        return math.copysign(small, omega)
    return math.copysign(min(max(abs(ahead), small), v_eps), ahead)


@merged_kernel
def slip_stiffness(
    plant: Plant, omega: float, ahead: float, warm: FloatArray, readings: FloatArray
) -> tuple[float, float]:
    """(dT/ds [N s], dF_l/ds [N s/m]) of an axle, s = r omega - v_l [m/s], neither negative.

    One more evaluation at fixed sinkage and load. ``ahead``: change of ``omega`` [rad/s] that the step would
    begin with.
    """
    rim, v_l, v_c = plant.vehicle.r * omega, readings[at.V_L], readings[at.V_C]
    # A step well inside the regularised band, large against rounding; the same forwards and backwards.
    small = 1e-4 * (abs(rim) + plant.v_eps)
    change = _slip_change(plant.structure, omega, small, plant.vehicle.r * ahead, plant.v_eps)
    force, torque = _plain_reaction(plant, WheelMotion(rim + change, v_l, v_c), warm, readings)
    before = WheelMotion(rim, v_l, v_c)
    force_before, torque_before = _reaction_before(plant.effects, plant, before, warm, readings)
    return max((torque - torque_before) / change, 0.0), max((force - force_before) / change, 0.0)


@inline_kernel
def held_spin_stiffness(vehicle: Vehicle, omega: float, load: float, brake: float, v_eps: float) -> float:
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
def side_stiffness(readings: FloatArray) -> float:
    """-F_c/v_c of an axle [N s/m]: the secant, at least as steep as the tangent; 0 without side slip."""
    v_c = readings[at.V_C]
    return max(-readings[at.F_C] / v_c, 0.0) if abs(v_c) > 1e-9 else 0.0


@kernel
def axle_stiffnesses(
    plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray, slope: Slope, stiffness: FloatArray
) -> None:
    """What the Jacobian holds, into ``stiffness`` (8,)."""
    v = plant.vehicle
    torques = axle_torques(v, x)
    brake = torques.brake_f
    for axle in range(2):
        omega, seen = x[at.OMEGA_F + axle], readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        ahead = slope.dt * slope.derivative[at.OMEGA_F + axle]
        torque, force = slip_stiffness(plant, omega, ahead, warm[axle], seen)
        stiffness[_SLIP_TORQUE + axle], stiffness[_SLIP_FORCE + axle] = torque, force
        stiffness[_HELD + axle] = held_spin_stiffness(v, omega, seen[at.N], brake, plant.v_eps)
        stiffness[_SIDE + axle] = side_stiffness(seen)
        brake = torques.brake_r


@inline_kernel
def _implicit_slips(
    plant: Plant, x: FloatArray, stiffness: FloatArray, gamma_dt: float, k: FloatArray
) -> None:
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
def _implicit_sides(
    plant: Plant, x: FloatArray, stiffness: FloatArray, gamma_dt: float, k: FloatArray
) -> None:
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
def solve_axle_stages(
    plant: Plant, x: FloatArray, stiffness: FloatArray, gamma_dt: float, k: FloatArray
) -> None:
    """Solve (1 - gamma dt J) k = right side, in place, along and then across the wheels."""
    _implicit_slips(plant, x, stiffness, gamma_dt, k)
    _implicit_sides(plant, x, stiffness, gamma_dt, k)
