"""What the two vehicle models share: axles on uneven ground, and the record of a plant."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, merged_kernel
from offroad_env.physics.contact import ContactFrame, Support, slope_frame
from offroad_env.physics.ground import ground_readings, sinkage_exponent
from offroad_env.physics.hooks import change_soil, change_wheel_forces
from offroad_env.physics.numerics import GRAVITY, smooth_step
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import (
    AxleContact,
    AxleForces,
    AxlePlace,
    AxleSpring,
    ContactOptions,
    FloatArray,
    FourWheel,
    Ground,
    Soil,
    SoilField,
    SoilMap,
    SpringState,
    Structure,
    Vehicle,
    Wheel,
    WheelMotion,
)
from offroad_env.physics.slip import slip_ratio
from offroad_env.physics.soil_field import local_soil
from offroad_env.physics.structured_contact import contact_solution

__all__ = [
    "AxleLoad",
    "AxleMotion",
    "AxleReaction",
    "AxleStance",
    "Directions",
    "Plant",
    "Pose",
    "Velocity",
    "axle_contact",
    "axle_motion",
    "borne_contact",
    "contact_columns",
    "contact_options",
    "contact_shape",
    "readings_size",
    "slope_motion",
    "soil_at",
    "soil_under",
    "state_size",
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
    effects: FloatArray | None = None  #: rows of `hooks`; None = the base model, without any trace of them
    four_wheel: FourWheel | None = None  #: None = two axles, without any trace of four wheels
    structure: Structure | None = None  #: laws of the wheels; None = Wong-Reece wheels, without ruts
    soil_field: SoilField | None = None  #: natural soil; None = the same soil everywhere but for the map


class Directions(NamedTuple):
    """(sin, cos) of the angles of a vehicle."""

    yaw: tuple[float, float]
    pitch: tuple[float, float]
    steer: tuple[float, float]  #: of the axle's wheels


class Pose(NamedTuple):
    """Where the CG is in the plane, and where the vehicle heads."""

    X: float  #: [m]
    Y: float  #: [m]
    yaw: tuple[float, float]  #: (sin, cos)


class Velocity(NamedTuple):
    """How the vehicle moves in the plane, in heading axes."""

    forward: float  #: speed of the CG, or of what carries the axle [m/s]
    left: float  #: [m/s]
    yaw_rate: float  #: [rad/s]


class AxleMotion(NamedTuple):
    """An axle over the ground."""

    x: float  #: position of the wheel [m]
    y: float  #: [m]
    H: float  #: height of the ground there [m]
    H_dot: float  #: its time derivative along the wheel's path [m/s]
    H_ddot: float  #: its second one, grad(H).a neglected: the paper's contact assumption [m/s^2]
    u_l: float  #: horizontal velocity along the wheel [m/s]
    u_c: float  #: across it, to the left (BT tan beta) [m/s]
    g_l: float  #: ground slope along the wheel [-]
    g_c: float  #: across it [-]


class AxleStance(NamedTuple):
    """The ground that an axle stands on."""

    x: float  #: position of the wheel [m]
    y: float  #: [m]
    H: float  #: height of the ground [m]
    g_l: float  #: its slope along the wheel [-]
    g_c: float  #: across it, to the left [-]
    arm: float  #: distance of the axle ahead of the CG [m]


class AxleLoad(NamedTuple):
    """Load of an axle on ground that does not yield."""

    N_0: float  #: (BT N) [N]
    inertia: float  #: what the wheel's own mass has of it [N]


class AxleReaction(NamedTuple):
    """What the ground does to an axle, in the wheel's horizontal axes."""

    status: float  #: of the contact
    F_l: float  #: along the wheel [N]
    F_c: float  #: across it, to the left [N]
    V: float  #: up [N]
    torque: float  #: against the wheels' rotation [N m]


@inline_kernel
def state_size(plant: Plant) -> int:
    """How many numbers the state of a plant's vehicle has."""
    return at.STATE_SIZE if plant.four_wheel is None else at.FOUR_WHEEL_SIZE


@inline_kernel
def readings_size(plant: Plant) -> int:
    """How many readings an evaluation of a plant gives."""
    return at.READINGS_SIZE if plant.four_wheel is None else at.FOUR_WHEEL_READINGS


@inline_kernel
def with_pressure(soil: Soil, n: float, factor: float) -> Soil:
    """The same soil with exponent ``n`` and ``factor`` times the sinkage moduli."""
    return replace(soil, k_c=factor * soil.k_c, k_phi=factor * soil.k_phi, n=n)


@inline_kernel
def with_exponent(soil: Soil, n: float) -> Soil:
    """The same soil with another sinkage exponent."""
    return replace(soil, n=n)


@inline_kernel
def contact_columns(structure: Structure | None) -> int:
    """Numbers in a wheel's row of the contact state."""
    if structure is None:
        return at.CONTACT_SIZE
    return at.STRUCTURED_CONTACT_SIZE


def contact_shape(structure: Structure | None, four_wheel: FourWheel | None = None) -> tuple[int, int]:
    """Shape of a contact state, (axles or wheels, numbers): the warm start of each contact, and the ruts."""
    columns = at.CONTACT_SIZE if structure is None else at.STRUCTURED_CONTACT_SIZE
    return 2 if four_wheel is None else at.WHEEL_COUNT, columns


@inline_kernel
def soil_at(plant: Plant, X: float, Y: float) -> Soil:
    """The plant's soil at (X, Y) [m], before any effect."""
    n = sinkage_exponent(plant.soil_map, plant.soil.n, X, Y)
    return local_soil(plant.soil_field, with_exponent(plant.soil, n), X, Y)


@inline_kernel
def soil_under(plant: Plant, readings: FloatArray) -> Soil:
    """The soil under an axle whose place and exponent ``readings`` hold."""
    if plant.soil_field is None:
        return with_exponent(plant.soil, readings[at.EXPONENT])
    there = soil_at(plant, readings[at.WHEEL_X], readings[at.WHEEL_Y])
    return with_exponent(there, readings[at.EXPONENT])


@inline_kernel
def contact_options(plant: Plant) -> ContactOptions:
    """How the plant's contacts are computed."""
    return ContactOptions(plant.v_eps, plant.resultant, plant.fine)


@inline_kernel
def slope_motion(motion: AxleMotion, rim_speed: float) -> WheelMotion:
    """Velocities in the slope of the ground, of a hub that moves horizontally with ``motion``."""
    g_l, g_c = motion.g_l, motion.g_c
    q_l = math.sqrt(1.0 + g_l * g_l)
    v_l = motion.u_l * q_l + g_l * g_c * motion.u_c / q_l
    v_c = motion.u_c * math.sqrt(q_l * q_l + g_c * g_c) / q_l
    return WheelMotion(rim_speed, v_l, v_c)


@inline_kernel
def static_loads(vehicle: Vehicle) -> tuple[float, float]:
    """(front, rear) static axle loads m g l_r/L and m g l_f/L [N] (the paper writes m g/2)."""
    total = vehicle.m * GRAVITY / (vehicle.l_f + vehicle.l_r)
    return total * vehicle.l_r, total * vehicle.l_f


@merged_kernel
def axle_motion(
    ground: Ground, pose: Pose, velocity: Velocity, arm: float, steer: tuple[float, float]
) -> AxleMotion:
    """Motion of the axle ``arm`` [m] ahead of the CG; ``steer`` = (sin, cos) of the steering angle."""
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
    return AxleMotion(
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
def suspension_load(spring: AxleSpring, state: SpringState, m_w: float, H_ddot: float) -> AxleLoad:
    """Load of an axle on ground that does not yield (BT N), and the share of the wheel, of mass ``m_w`` [kg].

    The load at sinkage h is N_0 - k h; the sinkage rate is neglected in the damper. Where the spring is
    slack the wheel hangs free: damper and inertia of the wheel, which presume that it follows the
    ground, fade out below 0.2 of the static load, so a falling vehicle feels the ground only when its
    wheels reach it.
    """
    pressing = spring.static_load - spring.k * state.height
    follows = smooth_step(pressing / (0.2 * spring.static_load))
    inertia = m_w * H_ddot * follows
    return AxleLoad(pressing - spring.c * state.rate * follows + inertia, inertia)


@inline_kernel
def suspension_force(N: float, N_static: float, inertia: float) -> float:
    """Force of the suspension on the body, relative to static equilibrium [N].

    In contact N - N_static - m_w H_ddot, the paper's spring and damper. In the air the ground
    never pulls: N = 0 leaves -N_static, the weight.
    """
    return N - N_static - inertia


@merged_kernel
def axle_contact(
    plant: Plant,
    motion: WheelMotion,
    stance: AxleStance,
    support: Support,
    warm: FloatArray,
    readings: FloatArray,
) -> AxleReaction:
    """Solve one axle's contact and note it in ``readings``, the axle's part of the readings."""
    frame = slope_frame(stance.g_l, stance.g_c)
    reaction: AxleReaction = borne_contact(plant, motion, stance, support, frame, warm, readings)
    return reaction


@merged_kernel
def borne_contact(
    plant: Plant,
    motion: WheelMotion,
    stance: AxleStance,
    support: Support,
    bearing: ContactFrame,
    warm: FloatArray,
    readings: FloatArray,
) -> AxleReaction:
    """`axle_contact` where the z components of ``bearing`` say how the forces add to what bears the load."""
    vehicle, arm = plant.vehicle, stance.arm
    place = AxlePlace(stance.x, stance.y, arm, plant.v_eps)
    soil = change_soil(plant.effects, soil_at(plant, stance.x, stance.y), motion, place)
    frame = slope_frame(stance.g_l, stance.g_c)
    wheel = Wheel(vehicle.r, vehicle.b)
    options = contact_options(plant)
    solution = contact_solution(plant.structure, soil, wheel, motion, bearing, support, warm, options)
    F_n, h = solution.F_n, solution.sinkage
    forces = AxleForces(solution.F_l, solution.F_c, solution.torque)
    contact = AxleContact(F_n, h, arm, plant.v_eps, vehicle.r, vehicle.b, vehicle.wheels_per_axle)
    F_x, F_y, T = change_wheel_forces(plant.effects, forces, motion, contact)
    readings[at.N] = F_n
    readings[at.F_L] = F_x
    readings[at.F_C] = F_y
    readings[at.TORQUE] = T
    readings[at.SINKAGE] = h
    readings[at.SLIP] = slip_ratio(motion.rim_speed, motion.v_l, plant.v_eps)
    readings[at.R_OMEGA] = motion.rim_speed
    readings[at.V_L] = motion.v_l
    readings[at.V_C] = motion.v_c
    readings[at.EXPONENT] = soil.n
    readings[at.WHEEL_X] = stance.x
    readings[at.WHEEL_Y] = stance.y
    readings[at.HEIGHT] = stance.H
    return AxleReaction(
        solution.status,
        F_x * frame.l_x + F_y * frame.c_x + F_n * frame.n_x,
        F_y * frame.c_y + F_n * frame.n_y,
        F_x * frame.l_z + F_y * frame.c_z + F_n * frame.n_z,
        T,
    )
