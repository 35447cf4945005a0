"""Preset ``full``, equations of motion of a vehicle with four wheels.

Those of the half-car (`full_dynamics`) with a roll angle and with a contact for every wheel: Newton's law
in heading axes that stay horizontal, the contact points carried along by the body's pitch and roll about
its CG, vertical springs over the ground under each wheel. Lateral load transfer follows from the levers:
the side forces act h_cg below the CG, and the wheels stand half a track beside it. Held at zero roll, with
both wheels of an axle in one place, the equations are those of the half-car.

Left out: products of inertia, gyroscopic moments of the wheels, and what the sinkage of one wheel does to
the anti-roll bar (the bar works on the angle between the body and the undeformed ground).
"""

from __future__ import annotations

from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import (
    AxleMotion,
    AxleReaction,
    AxleStance,
    Plant,
    Pose,
    Velocity,
    axle_motion,
    borne_contact,
    slope_motion,
    suspension_load,
)
from offroad_env.physics.contact import ContactFrame, Support, slope_frame
from offroad_env.physics.four_wheel_geometry import (
    Attitude,
    Levers,
    WheelPlace,
    attitude,
    four_wheels,
    levers,
    one_wheel,
    wheel_place,
    wheel_row,
    wheel_spin,
)
from offroad_env.physics.full_dynamics import (
    AxleTorques,
    actuators,
    available_torque,
    axle_torques,
    body_forces,
    body_motion,
    resisting_torque,
    unreacted_arm,
)
from offroad_env.physics.hooks import change_load
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleSpring, FloatArray, FourWheel, SpringState, Vehicle
from offroad_env.physics.ruts import follow_rut

__all__ = [
    "FourWheelForces",
    "four_wheel_derivative",
    "given_torque",
    "note_motions",
    "noted_motion",
    "wheel_forces",
]

# Until a wheel's contact is solved, its row of the readings holds how the wheel moves.
(_X, _Y, _H, _H_DOT, _H_DDOT, _U_L, _U_C, _G_L, _G_C, _EXTENSION, _RATE) = range(11)

#: Stops are so many times as stiff as the spring, and take this share of its static deflection to get there.
_STOP_STIFFNESS, _STOP_SEAM = 10.0, 0.05


class FourWheelForces(NamedTuple):
    """What all wheels do to the vehicle, in heading axes."""

    status: float  #: worst of their contacts
    F_x: float  #: forward [N]
    F_y: float  #: to the left [N]
    M_z: float  #: yaw moment [N m]
    F_s: float  #: of the suspension, relative to static equilibrium, up [N]
    pitch_lift: float  #: pitch moment of the vertical forces [N m]
    roll_lift: float  #: roll moment of the vertical forces [N m]
    pitch_push: float  #: pitch moment of the horizontal forces [N m]
    roll_push: float  #: roll moment of the horizontal forces [N m]


class WheelLoad(NamedTuple):
    """What presses a wheel on ground that does not yield."""

    N_0: float  #: [N]
    k: float  #: how much less it is per sinkage [N/m]
    inertia: float  #: what the wheel's own mass has of it [N]


@merged_kernel
def _note_motion(
    plant: Plant, x: FloatArray, body: Attitude, place: WheelPlace, lever: Levers, row: FloatArray
) -> None:
    """How a wheel moves over the ground, and how far its suspension is extended, into ``row``."""
    sin, cos = body.yaw
    yaw_rate, pitch_rate, roll_rate = x[at.YAW_RATE], x[at.PITCH_RATE], x[at.ROLL_RATE]
    pose = Pose(x[at.X] - lever.across * sin, x[at.Y] + lever.across * cos, body.yaw)
    forward = x[at.V_X] + lever.push_pitch * pitch_rate - lever.across * yaw_rate
    velocity = Velocity(forward, x[at.V_Y] + lever.push_roll * roll_rate, yaw_rate)
    motion = axle_motion(plant.ground, pose, velocity, lever.reach, place.steer)
    row[_X], row[_Y], row[_H] = motion.x, motion.y, motion.H
    row[_H_DOT], row[_H_DDOT] = motion.H_dot, motion.H_ddot
    row[_G_L], row[_G_C] = motion.g_l, motion.g_c
    rate = x[at.V_Z] + lever.lift_pitch * pitch_rate + lever.lift_roll * roll_rate - motion.H_dot
    row[_EXTENSION], row[_RATE] = x[at.Z] + lever.height - motion.H, rate
    # The suspension carries the contact point sideways as it extends: the roll centre's height.
    sin_d, cos_d = place.steer
    row[_U_L] = motion.u_l + sin_d * place.scrub * rate
    row[_U_C] = motion.u_c + cos_d * place.scrub * rate


@inline_kernel
def noted_motion(row: FloatArray) -> AxleMotion:
    """The motion that `note_motions` has left in a wheel's row."""
    return AxleMotion(
        row[_X],
        row[_Y],
        row[_H],
        row[_H_DOT],
        row[_H_DDOT],
        row[_U_L],
        row[_U_C],
        row[_G_L],
        row[_G_C],
    )


@inline_kernel
def note_motions(plant: Plant, x: FloatArray, body: Attitude, readings: FloatArray) -> None:
    """How the wheels move over the ground, into their rows of the readings, for `noted_motion`."""
    v = plant.vehicle
    for wheel in range(at.WHEEL_COUNT):
        place = wheel_place(four_wheels(plant), v, x[at.STEER], wheel)
        _note_motion(plant, x, body, place, levers(v, body, place), wheel_row(readings, wheel))


@inline_kernel
def _beyond_stop(excess: float, spring: AxleSpring) -> tuple[float, float]:
    """(force [N], stiffness [N/m]) of a stop that is compressed by ``excess`` [m]."""
    if excess <= 0.0:
        return 0.0, 0.0
    seam = _STOP_SEAM * spring.static_load / spring.k
    stiffness = _STOP_STIFFNESS * spring.k
    whole = excess + seam
    return stiffness * excess * excess / whole, stiffness * excess * (excess + 2.0 * seam) / (whole * whole)


@merged_kernel
def _wheel_load(
    plant: Plant, place: WheelPlace, motion: AxleMotion, state: SpringState, other: float, sunk: float
) -> WheelLoad:
    """Load of a wheel by its spring, damper, anti-roll bar and stops.

    ``other`` is the extension [m] at the other wheel of the axle. The stops act on the wheel where it has
    sunk: their force is linearised at the sinkage ``sunk`` [m] of the last solution.
    """
    spring = place.spring
    N_0, inertia = suspension_load(spring, state, 0.5 * plant.vehicle.m_w, motion.H_ddot)
    N_0 = change_load(plant.effects, N_0, state, spring)
    N_0 -= place.anti_roll * (state.height - other) / max(place.track * place.track, 1e-6)
    extension = state.height + sunk
    up, up_slope = _beyond_stop(-extension - place.bump, spring)
    down, down_slope = _beyond_stop(extension - place.droop, spring)
    slope = up_slope + down_slope
    return WheelLoad(N_0 + up - down + slope * sunk, spring.k + slope, inertia)


@inline_kernel
def given_torque(four: FourWheel, command: tuple[float, ...], wheel: int, omega: float) -> float:
    """Torque of a wheel beside that of the driveline [N m], from the last four numbers of a command.

    They are torques [N m], or with a servo the wheels' speeds [rad/s], front left, front right, rear
    left, rear right. A command of three numbers gives none.
    """
    if len(command) > 3:
        given: float = command[3 + wheel]
        return four.servo * (given - omega) if four.servo > 0.0 else given
    return 0.0


@inline_kernel
def _driveline_torque(
    vehicle: Vehicle, four: FourWheel, x: FloatArray, torques: AxleTorques, wheel: int
) -> float:
    """Drive torque of a wheel [N m]: half of its axle's, and what turns a skid-steered vehicle.

    That is the largest drive torque as difference between right and left at full steering.
    """
    left = 1.0 - 2.0 * (wheel % 2)
    drive, share = torques.drive_f, vehicle.drive_front
    if wheel > 1:
        drive, share = torques.drive_r, 1.0 - vehicle.drive_front
    difference = four.skid * vehicle.drive_torque_max * x[at.STEER] / vehicle.steer_max
    split = share * x[at.SPLIT_F] + (1.0 - share) * x[at.SPLIT_R]
    return 0.5 * (drive - left * share * available_torque(vehicle, difference, split))


@inline_kernel
def _spin_up(wheel: int, acceleration: float, d: FloatArray) -> None:
    """Add the acceleration of a wheel [rad/s^2] to the mean and the split of its axle."""
    axle, left = wheel // 2, 1.0 - 2.0 * (wheel % 2)
    d[at.OMEGA_F + axle] += 0.5 * acceleration
    d[at.SPLIT_F + axle] -= 0.5 * left * acceleration


@inline_kernel
def _turn_wheels(four: FourWheel, d: FloatArray) -> None:
    """What locked differentials leave of the spin accelerations in ``d``."""
    mean = 0.5 * (d[at.OMEGA_F] + d[at.OMEGA_R])
    d[at.OMEGA_F] += four.lock_c * (mean - d[at.OMEGA_F])
    d[at.OMEGA_R] += four.lock_c * (mean - d[at.OMEGA_R])
    d[at.SPLIT_F] *= 1.0 - four.lock_f
    d[at.SPLIT_R] *= 1.0 - four.lock_r


@inline_kernel
def _bearing(frame: ContactFrame, place: WheelPlace) -> ContactFrame:
    """A contact's frame whose z components say what its forces press on the spring.

    The links carry the side force along the line from the contact point to the roll centre, so that a part
    of it lifts or presses the wheel (jacking; T. D. Gillespie, Fundamentals of Vehicle Dynamics, ch. 7). By
    virtual work that part is the motion to the left per extension, with which the wheel scrubs.
    """
    sin, cos = place.steer
    return replace(
        frame,
        l_z=frame.l_z - place.scrub * sin * frame.l_x,
        c_z=frame.c_z - place.scrub * (sin * frame.c_x + cos * frame.c_y),
        n_z=frame.n_z - place.scrub * (sin * frame.n_x + cos * frame.n_y),
    )


@merged_kernel
def _wheel_reaction(
    plant: Plant, place: WheelPlace, omega: float, other: float, warm: FloatArray, row: FloatArray
) -> tuple[AxleReaction, float]:
    """(what the ground does to a wheel, load of its own mass [N]); its row becomes its readings."""
    motion = noted_motion(row)
    state = SpringState(row[_EXTENSION], row[_RATE])
    load = _wheel_load(plant, place, motion, state, other, warm[0])
    stance = AxleStance(motion.x, motion.y, motion.H, motion.g_l, motion.g_c, place.arm)
    turning = slope_motion(motion, plant.vehicle.r * omega)
    bearing = _bearing(slope_frame(motion.g_l, motion.g_c), place)
    reaction = borne_contact(plant, turning, stance, Support(load.N_0, load.k, 1.0), bearing, warm, row)
    return reaction, load.inertia


@kernel
def wheel_forces(
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> FourWheelForces:
    """Forces of all wheels; their spin accelerations go into ``d``, their readings into ``readings``."""
    v, four, wheel_plant = plant.vehicle, four_wheels(plant), one_wheel(plant)
    body, torques = attitude(x), axle_torques(v, x)
    note_motions(plant, x, body, readings)
    d[at.OMEGA_F] = d[at.OMEGA_R] = d[at.SPLIT_F] = d[at.SPLIT_R] = 0.0
    worst = F_x = F_y = M_z = F_s = 0.0
    pitch_lift = roll_lift = pitch_push = roll_push = 0.0
    other = wheel_row(readings, 1)[_EXTENSION]
    for wheel in range(at.WHEEL_COUNT):
        place, row = wheel_place(four, v, x[at.STEER], wheel), wheel_row(readings, wheel)
        omega = wheel_spin(x, wheel)
        lever = levers(v, body, place)
        extension = row[_EXTENSION]
        if wheel > 1:
            follow_rut(plant.structure, warm[wheel - 2], warm[wheel], v.b, row[_X], row[_Y])
        found, inertia = _wheel_reaction(wheel_plant, place, omega, other, warm[wheel], row)
        # A right wheel's neighbour is solved already, a left one's is still to come.
        other = extension
        if wheel == 1:
            other = wheel_row(readings, 3)[_EXTENSION]
        brake = torques.brake_f if wheel < 2 else torques.brake_r
        torque = _driveline_torque(v, four, x, torques, wheel) + given_torque(four, command, wheel, omega)
        torque -= resisting_torque(v, omega, found.V, 0.5 * brake, plant.v_eps) + row[at.TORQUE]
        _spin_up(wheel, torque / v.I_w, d)
        worst = max(worst, found.status)
        sin_d, cos_d = place.steer
        forward, side = found.F_l * cos_d - found.F_c * sin_d, found.F_l * sin_d + found.F_c * cos_d
        lifted = found.V - inertia
        F_x += forward
        F_y += side
        M_z += side * lever.reach - forward * lever.across
        F_s += lifted - place.spring.static_load
        pitch_lift += (lifted - place.spring.static_load) * lever.lift_pitch
        roll_lift += lifted * lever.lift_roll
        pitch_push += forward * (lever.push_pitch - unreacted_arm(plant.structure, v.r))
        roll_push += side * lever.push_roll
    _turn_wheels(four, d)
    return FourWheelForces(worst, F_x, F_y, M_z, F_s, pitch_lift, roll_lift, pitch_push, roll_push)


@inline_kernel
def _axle_readings(readings: FloatArray) -> None:
    """The axles' parts of the readings: sums of the wheels' forces, means of the rest."""
    for axle in range(2):
        first = at.WHEELS + 2 * axle * at.AXLE
        for i in range(at.AXLE):
            both = readings[first + i] + readings[first + at.AXLE + i]
            readings[axle * at.AXLE + i] = both if i < at.SINKAGE else 0.5 * both


@kernel
def four_wheel_derivative(
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """`equations.full_derivative` of a vehicle with four wheels."""
    v, four = plant.vehicle, four_wheels(plant)
    wheels = wheel_forces(x, command, plant, warm, d, readings)
    body = attitude(x)
    forces = body_forces(plant, x, wheels.F_x, wheels.F_y, wheels.M_z)
    pitch_acc = (wheels.pitch_lift + wheels.pitch_push) / v.I_y
    body_motion(v, x, body.yaw, forces, (wheels.F_s / v.m, pitch_acc), d, readings)
    d[at.ROLL] = x[at.ROLL_RATE]
    d[at.ROLL_RATE] = (wheels.roll_lift + wheels.roll_push) / four.I_x
    actuators(v, x, (command[0], command[1], command[2]), d)
    _axle_readings(readings)
    readings[at.ROLL_ACC] = d[at.ROLL_RATE]
    readings[at.STATUS] = wheels.status
