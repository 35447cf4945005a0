"""Where the wheels of a four-wheel vehicle are, how they are steered, and what moves them."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import Plant, static_loads
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleSpring, FloatArray, FourWheel, Vehicle

__all__ = [
    "Attitude",
    "Levers",
    "WheelPlace",
    "attitude",
    "four_wheels",
    "levers",
    "one_wheel",
    "wheel_angle",
    "wheel_place",
    "wheel_row",
    "wheel_spin",
]


class Attitude(NamedTuple):
    """(sin, cos) of the angles of a body; yaw, then pitch (nose up), then roll (left side up)."""

    yaw: tuple[float, float]
    pitch: tuple[float, float]
    roll: tuple[float, float]


class WheelPlace(NamedTuple):
    """A wheel on its vehicle."""

    arm: float  #: distance ahead of the CG [m]
    side: float  #: distance to its left [m]
    track: float  #: of its axle [m]
    anti_roll: float  #: of its axle [N m/rad]
    bump: float  #: travel up to the bump stop [m]
    droop: float  #: travel down to the rebound stop [m]
    scrub: float  #: motion to the left per extension of the suspension [-]
    steer: tuple[float, float]  #: (sin, cos) of its angle
    spring: AxleSpring  #: its own


class Levers(NamedTuple):
    """Contact point of a wheel in heading axes, and how the body's motion moves it."""

    reach: float  #: ahead of the CG [m]
    across: float  #: to its left [m]
    height: float  #: above where it is at rest on level ground, for a CG that stays [m]
    lift_pitch: float  #: d(height)/d(pitch) [m/rad]
    lift_roll: float  #: d(height)/d(roll) [m/rad]
    push_pitch: float  #: motion ahead per pitch [m/rad]
    push_roll: float  #: motion to the left per roll [m/rad]


@inline_kernel
def four_wheels(plant: Plant) -> FourWheel:
    """What the plant, which is one of a vehicle with four wheels, holds of them."""
    return plant.four_wheel  # type: ignore[return-value]  # not None


@inline_kernel
def attitude(x: FloatArray) -> Attitude:
    """Angles of a body in the state ``x``."""
    return Attitude(sin_cos(x[at.YAW]), sin_cos(x[at.PITCH]), sin_cos(x[at.ROLL]))


@inline_kernel
def wheel_row(readings: FloatArray, wheel: int) -> FloatArray:
    """The part of the readings that belongs to a wheel: 0 ... 3 = front left, front right, rear left, ..."""
    first = at.WHEELS + wheel * at.AXLE
    return readings[first : first + at.AXLE]


@inline_kernel
def wheel_spin(x: FloatArray, wheel: int) -> float:
    """Spin of a wheel [rad/s]."""
    axle, left = wheel // 2, 1.0 - 2.0 * (wheel % 2)
    spin: float = x[at.OMEGA_F + axle] - left * x[at.SPLIT_F + axle]
    return spin


@inline_kernel
def one_wheel(plant: Plant) -> Plant:
    """The same plant for laws of an axle, whose only wheel is the one that is asked about."""
    return replace(plant, vehicle=replace(plant.vehicle, wheels_per_axle=1.0))


@inline_kernel
def wheel_angle(four: FourWheel, vehicle: Vehicle, steer: float, wheel: int) -> float:
    """Angle of a wheel [rad] for the mean angle ``steer`` of the front wheels.

    With ``ackermann`` = 1 all wheels' axes meet in the centre of the turn: tan(delta_i) = tan(delta) /
    (1 - y_i curvature) for a wheel y_i to the left (R. N. Jazar, Vehicle Dynamics, ch. 7: cot of the
    outer less cot of the inner angle is the track over the wheelbase).
    """
    left = 1.0 - 2.0 * (wheel % 2)
    mean = steer * (1.0 - four.skid)
    front, rear = math.tan(mean), math.tan(four.rear_steer * mean)
    curvature = (front - rear) / (vehicle.l_f + vehicle.l_r)
    track, tangent, toe = four.track_f, front, four.toe_f
    if wheel > 1:
        track, tangent, toe = four.track_r, rear, four.toe_r
    beside = 1.0 - four.ackermann * left * 0.5 * track * curvature
    # A centre of the turn inside the track turns the inner wheel beyond 90 degrees, not back to -90.
    angle = math.atan(tangent / beside) if beside > 0.0 else math.atan2(tangent, beside)
    return angle - left * toe


@inline_kernel
def wheel_place(four: FourWheel, vehicle: Vehicle, steer: float, wheel: int) -> WheelPlace:
    """A wheel on its vehicle, for the mean angle ``steer`` [rad] of the front wheels."""
    N_f, N_r = static_loads(vehicle)
    arm, track, N, k, c = vehicle.l_f, four.track_f, N_f, vehicle.k_f, vehicle.c_f
    anti_roll, bump, droop, centre = four.anti_roll_f, four.bump_f, four.droop_f, four.roll_centre_f
    if wheel > 1:
        arm, track, N, k, c = -vehicle.l_r, four.track_r, N_r, vehicle.k_r, vehicle.c_r
        anti_roll, bump, droop, centre = four.anti_roll_r, four.bump_r, four.droop_r, four.roll_centre_r
    left = 1.0 - 2.0 * (wheel % 2)
    scrub = -left * 2.0 * centre / max(track, 1e-3)
    angle = sin_cos(wheel_angle(four, vehicle, steer, wheel))
    spring = AxleSpring(0.5 * N, 0.5 * k, 0.5 * c)
    return WheelPlace(arm, 0.5 * left * track, track, anti_roll, bump, droop, scrub, angle, spring)


@inline_kernel
def levers(vehicle: Vehicle, body: Attitude, place: WheelPlace) -> Levers:
    """Contact point of a wheel below a body that pitches and rolls about its CG.

    Rigid in roll, small angles in pitch as in the half-car: without roll these are its levers.
    """
    sin, cos = body.pitch
    sin_r, cos_r = body.roll
    h = vehicle.h_cg
    across = place.side * cos_r + h * sin_r
    rise = place.side * sin_r + h * (1.0 - cos_r)
    return Levers(
        place.arm + h * sin,
        across,
        place.arm * sin + cos * rise,
        place.arm * cos - sin * rise,
        cos * across,
        h * cos,
        h * cos_r - place.side * sin_r,
    )
