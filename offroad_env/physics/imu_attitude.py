"""What an IMU measures on a body that also rolls."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import kernel
from offroad_env.physics.imu import ImuMount, ImuReading, Vector, column, cross

__all__ = ["Attitude", "imu_reading_at_attitude"]


class Attitude(NamedTuple):
    """Angles of a body over its heading, and the derivatives of all three angles."""

    pitch: float  #: nose up positive [rad]
    roll: float  #: about the body's forward axis, left side up positive [rad]
    yaw_rate: float  #: [rad/s]
    pitch_rate: float  #: [rad/s]
    roll_rate: float  #: [rad/s]
    yaw_acc: float  #: [rad/s^2]
    pitch_acc: float  #: [rad/s^2]
    roll_acc: float  #: [rad/s^2]


@kernel
def _spin_derivative(a: Attitude, sin: float, cos: float) -> Vector:
    """Derivative of the angular velocity, in the level axes of the heading, which turn with the yaw rate."""
    return Vector(
        a.roll_acc * cos - a.roll_rate * a.pitch_rate * sin + a.yaw_rate * a.pitch_rate,
        a.yaw_rate * a.roll_rate * cos - a.pitch_acc,
        a.yaw_acc + a.roll_acc * sin + a.roll_rate * a.pitch_rate * cos,
    )


@kernel
def _to_body(v: Vector, pitch: tuple[float, float], roll: tuple[float, float]) -> Vector:
    """Level heading axes to body axes: pitched nose up, then rolled; angles as (sin, cos)."""
    (sin, cos), (s, c) = pitch, roll
    along, up = v.x * cos + v.z * sin, v.z * cos - v.x * sin
    return Vector(along, v.y * c + up * s, up * c - v.y * s)


@kernel
def imu_reading_at_attitude(
    acceleration_cg: tuple[float, float, float], attitude: Attitude, mount: ImuMount
) -> ImuReading:
    """`imu.imu_reading` with roll: acceleration at the place of the IMU, in its axes, which roll as well.

    With the roll about the body's forward axis e = (cos pitch, 0, sin pitch), the angular velocity in level
    heading axes is (0, -pitch_rate, yaw_rate) + roll_rate e. Without roll the reading is that of
    `imu_reading`, which stays the law of the vehicles that cannot roll.

    Parameters
    ----------
    acceleration_cg : (forward, left, up) inertial acceleration of the CG in level heading axes [m/s^2]
    attitude : Attitude
    mount : ImuMount; an IMU that is held level (``body_axes`` 0) neither pitches nor rolls
    """
    a = attitude
    sin, cos, s, c = 0.0, 1.0, 0.0, 1.0
    if mount.body_axes > 0.5:
        sin, cos, s, c = math.sin(a.pitch), math.cos(a.pitch), math.sin(a.roll), math.cos(a.roll)
    x, y, z = mount.lever[0], mount.lever[1], mount.lever[2]
    across, height = y * c - z * s, y * s + z * c
    lever = Vector(x * cos - height * sin, across, x * sin + height * cos)
    omega = Vector(a.roll_rate * cos, -a.pitch_rate, a.yaw_rate + a.roll_rate * sin)
    swing = cross(_spin_derivative(a, sin, cos), lever)
    centripetal = cross(omega, cross(omega, lever))
    forward, left, up = acceleration_cg
    total = Vector(
        forward + swing.x + centripetal.x,
        left + swing.y + centripetal.y,
        up + swing.z + centripetal.z + mount.gravity,
    )
    sensed, turning = _to_body(total, (sin, cos), (s, c)), _to_body(omega, (sin, cos), (s, c))
    R = mount.rotation
    return ImuReading(
        column(R, 0, sensed),
        column(R, 1, sensed),
        column(R, 2, sensed),
        -column(R, 1, turning),
        column(R, 2, turning),
    )
