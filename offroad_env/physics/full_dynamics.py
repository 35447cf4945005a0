"""Preset ``full``, equations of motion of the half-car: wheel spin, slopes, drag, actuators.

Translation is Newton's law in heading axes that stay horizontal: v_x and v_y are horizontal, v_z
vertical. Each wheel's contact force is resolved in the local slope frame, so gravity along a
slope enters through the contact normals, as it does in nature, and energy is conserved: contact
forces, suspension and gravity exchange exactly their power at these velocities. The lever of the
contact point below the CG (``h_cg``) moves it by h_cg * pitch, which gives load transfer under
braking and its reaction on the wheels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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
    slope_motion,
    static_loads,
    suspension_force,
    suspension_load,
)
from offroad_env.physics.contact import Support
from offroad_env.physics.hooks import change_body_forces, change_load
from offroad_env.physics.numerics import AIR_DENSITY, sin_cos
from offroad_env.physics.records import (
    AxleSpring,
    BodyForces,
    FloatArray,
    SpringState,
    Structure,
    Vehicle,
)
from offroad_env.physics.ruts import follow_rut

__all__ = [
    "AxleTorques",
    "actuators",
    "available_torque",
    "axle_torques",
    "body_forces",
    "body_motion",
    "half_car_derivative",
    "resisting_torque",
    "unreacted_arm",
]


#: Power [W] of a vehicle that has none, as one that is towed: nothing is divided by zero.
_LEAST_POWER = 1e-9
#: Shortest time constant of an actuator: one step of the model, which integrates the lags explicitly [s].
SHORTEST_LAG = 0.005


class AxleTorques(NamedTuple):
    """Torques on the wheels of both axles."""

    drive_f: float  #: [N m]
    brake_f: float  #: [N m]
    drive_r: float  #: [N m]
    brake_r: float  #: [N m]


class AxlePush(NamedTuple):
    """What an axle does to the vehicle, in heading axes."""

    status: float  #: of its contact
    F_x: float  #: forward [N]
    F_y: float  #: to the left [N]
    F_s: float  #: of the suspension, relative to static equilibrium, up [N]
    V: float  #: vertical force on the wheels [N]
    arm: float  #: of the horizontal forces, ahead of the CG [m]


@merged_kernel
def _full_axle(
    plant: Plant,
    x: FloatArray,
    directions: Directions,
    arm: float,
    spring: AxleSpring,
    warm: FloatArray,
    axle: int,
    readings: FloatArray,
) -> AxlePush:
    """One axle ``arm`` [m] ahead of the CG on its slope; ``axle``: its row of the contact state ``warm``."""
    sin, cos = directions.pitch
    sin_d, cos_d = directions.steer
    v = plant.vehicle
    forward, pitch_rate = x[at.V_X], x[at.PITCH_RATE]
    reach = arm
    if plant.half_car > 0.5:
        reach += v.h_cg * sin
        forward += v.h_cg * cos * pitch_rate
    pose = Pose(x[at.X], x[at.Y], directions.yaw)
    velocity = Velocity(forward, x[at.V_Y], x[at.YAW_RATE])
    motion = axle_motion(plant.ground, pose, velocity, reach, directions.steer)
    N_0, inertia, k = spring.static_load, 0.0, spring.k
    if plant.half_car > 0.5:
        z = x[at.Z] + arm * sin
        z_dot = x[at.V_Z] + arm * cos * pitch_rate
        state = SpringState(z - motion.H, z_dot - motion.H_dot)
        N_0, inertia = suspension_load(spring, state, v.m_w, motion.H_ddot)
        N_0 = change_load(plant.effects, N_0, state, spring)
    else:
        k = 0.0
    turning = slope_motion(motion, v.r * x[at.OMEGA_F + axle])
    stance = AxleStance(motion.x, motion.y, motion.H, motion.g_l, motion.g_c, arm)
    support = Support(N_0, k, v.wheels_per_axle)
    if axle > 0:
        follow_rut(plant.structure, warm[0], warm[axle], v.b, motion.x, motion.y)
    found = axle_contact(plant, turning, stance, support, warm[axle], readings)
    return AxlePush(
        found.status,
        found.F_l * cos_d - found.F_c * sin_d,
        found.F_l * sin_d + found.F_c * cos_d,
        suspension_force(found.V, spring.static_load, inertia),
        found.V,
        reach,
    )


@inline_kernel
def resisting_torque(vehicle: Vehicle, omega: float, load: float, brake: float, v_eps: float) -> float:
    """What brakes and rolling resistance hold against the spin [N m]; ``brake`` [N m].

    tanh over ``v_eps`` lets a held wheel creep instead of chattering around zero.
    """
    held = math.tanh(vehicle.r * omega / (0.5 * v_eps))
    return (brake + vehicle.rolling_resistance * load * vehicle.r) * held


@inline_kernel
def _spin_acceleration(
    vehicle: Vehicle,
    omega: float,
    soil_torque: float,
    load: float,
    torques: tuple[float, float],
    v_eps: float,
) -> float:
    """Angular acceleration of an axle's wheels [rad/s^2]; ``torques`` = (drive, brake) [N m]."""
    drive, brake = torques
    resisting = resisting_torque(vehicle, omega, load, brake, v_eps)
    return (drive - resisting - soil_torque) / (vehicle.wheels_per_axle * vehicle.I_w)


@inline_kernel
def available_torque(vehicle: Vehicle, torque: float, omega: float) -> float:
    """Drive torque held below the power limit: T / sqrt(1 + (T omega / P)^2), smooth [N m]."""
    share = torque * omega / max(vehicle.power_max, _LEAST_POWER)
    return torque / math.sqrt(1.0 + share * share)


@inline_kernel
def axle_torques(vehicle: Vehicle, x: FloatArray) -> AxleTorques:
    """Torques from the actuator states."""
    mean = vehicle.drive_front * x[at.OMEGA_F] + (1.0 - vehicle.drive_front) * x[at.OMEGA_R]
    drive = available_torque(vehicle, x[at.DRIVE], mean)
    front, brake_front = vehicle.drive_front, vehicle.brake_front
    return AxleTorques(
        front * drive,
        brake_front * x[at.BRAKE],
        (1.0 - front) * drive,
        (1.0 - brake_front) * x[at.BRAKE],
    )


@inline_kernel
def actuators(vehicle: Vehicle, x: FloatArray, command: tuple[float, float, float], d: FloatArray) -> None:
    """First-order lags into ``d``; the steering rate saturates smoothly at ``steer_rate``.

    ``command`` as `equations.full_derivative` takes it. A lag of zero is carried out as `SHORTEST_LAG`.
    """
    steer, drive, brake = command
    reach = max(vehicle.steer_lag, SHORTEST_LAG) * vehicle.steer_rate
    d[at.STEER] = vehicle.steer_rate * math.tanh((steer - x[at.STEER]) / reach)
    lag = max(vehicle.torque_lag, SHORTEST_LAG)
    d[at.DRIVE] = (drive - x[at.DRIVE]) / lag
    d[at.BRAKE] = (brake - x[at.BRAKE]) / lag


@inline_kernel
def body_forces(plant: Plant, x: FloatArray, traction: float, side: float, yawing: float) -> BodyForces:
    """Forces of the wheels ([N], [N], [N m] in heading axes) and of the air on the body."""
    v_x, v_y = x[at.V_X], x[at.V_Y]
    drag = 0.5 * AIR_DENSITY * plant.vehicle.drag_area * math.sqrt(v_x * v_x + v_y * v_y)
    forces = BodyForces(traction - drag * v_x, side - drag * v_y, yawing, x[at.BRAKE])
    return change_body_forces(plant.effects, forces, x, plant.vehicle)


@inline_kernel
def unreacted_arm(structure: Structure | None, r: float) -> float:
    """By how much the lever of traction about the CG is shorter than from the ground [m].

    Traction acts at the ground, and the body reacts to the shaft torque that makes it. Where shaft torques
    come from outside, traction acts at the axle of a wheel of radius ``r`` [m].
    """
    if structure is None:
        return 0.0
    return structure.external_torque * r


@kernel
def half_car_derivative(
    x: FloatArray,
    command: tuple[float, float, float],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """`equations.full_derivative` of a half-car."""
    v = plant.vehicle
    N_f, N_r = static_loads(v)
    yaw, pitch, wheel = sin_cos(x[at.YAW]), sin_cos(x[at.PITCH]), sin_cos(x[at.STEER])
    both = axle_torques(v, x)
    torques = both.drive_f, both.brake_f
    worst = traction = side = lift = pitching = yawing = 0.0
    # A loop and not two calls: each axle would be translated on its own.
    for axle in range(2):
        arm, spring, omega = v.l_f, AxleSpring(N_f, v.k_f, v.c_f), x[at.OMEGA_F]
        if axle == 1:
            arm, spring, omega = -v.l_r, AxleSpring(N_r, v.k_r, v.c_r), x[at.OMEGA_R]
            wheel, torques = (0.0, 1.0), (both.drive_r, both.brake_r)
        seen = readings[axle * at.AXLE : (axle + 1) * at.AXLE]
        push = _full_axle(plant, x, Directions(yaw, pitch, wheel), arm, spring, warm, axle, seen)
        d[at.OMEGA_F + axle] = _spin_acceleration(v, omega, seen[at.TORQUE], push.V, torques, plant.v_eps)
        worst = max(worst, push.status)
        traction += push.F_x
        side += push.F_y
        lift += push.F_s
        pitching += push.F_s * arm
        yawing += push.F_y * push.arm
    forces = body_forces(plant, x, traction, side, yawing)
    a_z = pitch_acc = 0.0
    if plant.half_car > 0.5:
        a_z = lift / v.m
        lever = v.h_cg - unreacted_arm(plant.structure, v.r)
        pitch_acc = (pitching + traction * lever) * pitch[1] / v.I_y
    body_motion(v, x, yaw, forces, (a_z, pitch_acc), d, readings)
    actuators(v, x, command, d)
    readings[at.STATUS] = worst


@inline_kernel
def body_motion(
    vehicle: Vehicle,
    x: FloatArray,
    yaw: tuple[float, float],
    forces: BodyForces,
    vertical: tuple[float, float],
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """Newton's law in heading axes, into ``d`` and ``readings``.

    ``yaw`` = (sin, cos); ``vertical`` = (heave [m/s^2], pitch acceleration [rad/s^2]).
    """
    sin, cos = yaw
    v_x, v_y, yaw_rate = x[at.V_X], x[at.V_Y], x[at.YAW_RATE]
    a_x, a_y = forces.F_x / vehicle.m, forces.F_y / vehicle.m
    a_z, pitch_acc = vertical
    yaw_acc = forces.M_z / vehicle.I_z
    d[at.X] = v_x * cos - v_y * sin
    d[at.Y] = v_x * sin + v_y * cos
    d[at.YAW] = yaw_rate
    d[at.Z] = x[at.V_Z]
    d[at.PITCH] = x[at.PITCH_RATE]
    d[at.V_X] = a_x + v_y * yaw_rate
    d[at.V_Y] = a_y - v_x * yaw_rate
    d[at.V_Z] = a_z
    d[at.PITCH_RATE] = pitch_acc
    d[at.YAW_RATE] = yaw_acc
    readings[at.A_X], readings[at.A_Y], readings[at.A_Z] = a_x, a_y, a_z
    readings[at.YAW_ACC], readings[at.PITCH_ACC] = yaw_acc, pitch_acc
