"""What sensors on the vehicle measure, without and with their errors."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = [
    "CHANNELS",
    "GNSS",
    "IMU",
    "NOISE_SD",
    "OFFSET",
    "SCALE",
    "WHEEL",
    "ImuMount",
    "ImuReading",
    "Vector",
    "column",
    "cross",
    "imu_reading",
    "sense",
]

# Channels of a sample, in this order.
(A_X, A_Y, A_Z, PITCH_RATE, YAW_RATE) = range(5)  # [m/s^2, rad/s]
(WHEEL_F, WHEEL_R) = (5, 6)  # wheel speed r omega [m/s]
(GNSS_X, GNSS_Y, GNSS_SPEED, GNSS_COURSE) = range(7, 11)  # [m, m, m/s, rad]
IMU, WHEEL, GNSS = slice(0, 5), slice(5, 7), slice(7, 11)
CHANNELS = 11

# Rows of the array of errors, one column per channel.
(OFFSET, SCALE, NOISE_SD) = range(3)


class ImuMount(NamedTuple):
    """Where and how an IMU sits on the vehicle, and what its accelerometers feel."""

    lever: FloatArray  #: (3,) position relative to the CG, body axes x forward, y left, z up [m]
    rotation: FloatArray  #: (3, 3) columns: the sensor's axes in body axes
    body_axes: float  #: 1.0 = pitches with the body; 0.0 = held level, in heading axes
    gravity: float  #: 0.0 = kinematic acceleration; g = specific force [m/s^2]


class ImuReading(NamedTuple):
    """What an IMU reads, in its own axes."""

    a_x: float  #: [m/s^2]
    a_y: float  #: [m/s^2]
    a_z: float  #: [m/s^2]
    pitch_rate: float  #: nose up positive [rad/s]
    yaw_rate: float  #: to the left positive [rad/s]


class Vector(NamedTuple):
    """Three components: forward, to the left, up."""

    x: float
    y: float
    z: float


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product a x b."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@kernel
def column(matrix: FloatArray, j: int, vector: Vector) -> float:
    """Component of ``vector`` along column ``j``."""
    along: float = matrix[0, j] * vector.x + matrix[1, j] * vector.y + matrix[2, j] * vector.z
    return along


@kernel
def imu_reading(
    acceleration_cg: tuple[float, float, float],
    yaw_rate: float,
    pitch_rate: float,
    yaw_acc: float,
    pitch_acc: float,
    pitch: float,
    mount: ImuMount,
) -> ImuReading:
    """Exact reading of an IMU anywhere on the rigid body.

    Heading axes are x forward and y left, both level, z up; they turn with the yaw rate. The body is
    pitched in them, so its angular velocity is (0, -pitch_rate, yaw_rate): the y axis points left, and
    turning about it by the right-hand rule lowers the nose. Its derivative is
    (pitch_rate yaw_rate, -pitch_acc, yaw_acc), since the pitch axis itself turns. At the lever arm r

        a = a_cg + omega_dot x r + omega x (omega x r).

    Parameters
    ----------
    acceleration_cg : (forward, left, up) inertial acceleration of the CG in heading axes [m/s^2]
    yaw_rate, pitch_rate : d(yaw)/dt, d(pitch)/dt, nose up positive [rad/s]
    yaw_acc, pitch_acc : their derivatives [rad/s^2]
    pitch : nose up [rad]
    mount : ImuMount

    Returns
    -------
    The reading in the sensor's axes. The gyro about the left axis reads -pitch_rate; it is published
    with the sign of pitch_rate.
    """
    cos, sin = 1.0, 0.0
    if mount.body_axes > 0.5:
        cos, sin = math.cos(pitch), math.sin(pitch)
    x, y, z = mount.lever[0], mount.lever[1], mount.lever[2]
    lever = Vector(x * cos - z * sin, y, x * sin + z * cos)
    omega = Vector(0.0, -pitch_rate, yaw_rate)
    swing = cross(Vector(pitch_rate * yaw_rate, -pitch_acc, yaw_acc), lever)
    centripetal = cross(omega, cross(omega, lever))
    forward, left, up = acceleration_cg
    forward = forward + swing.x + centripetal.x
    left = left + swing.y + centripetal.y
    up = up + swing.z + centripetal.z + mount.gravity
    body_a = Vector(forward * cos + up * sin, left, up * cos - forward * sin)
    body_omega = Vector(yaw_rate * sin, -pitch_rate, yaw_rate * cos)
    R = mount.rotation
    return ImuReading(
        column(R, 0, body_a),
        column(R, 1, body_a),
        column(R, 2, body_a),
        -column(R, 1, body_omega),
        column(R, 2, body_omega),
    )


@kernel
def sense(
    x: FloatArray,
    readings: FloatArray,
    mount: ImuMount,
    errors: FloatArray,
    noise: FloatArray,
    due: tuple[bool, bool],
    out: FloatArray,
) -> None:
    """One sample of every sensor, with its errors, into ``out``.

    Parameters
    ----------
    x, readings : state of the vehicle and readings of the model at that state (``physics.state``)
    mount : ImuMount, misalignment included
    errors : (3, CHANNELS) offset, scale error and noise standard deviation of every channel; for the GNSS
        speed and course the noise of the two velocity components [m/s]
    noise : (CHANNELS,) standard normal numbers
    due : (wheel speed, GNSS), true where the sensor delivers at this instant; else its channels are NaN
    out : (CHANNELS,)
    """
    yaw_rate, pitch_rate = x[at.YAW_RATE], x[at.PITCH_RATE]
    acceleration = (readings[at.A_X], readings[at.A_Y], readings[at.A_Z])
    yaw_acc, pitch_acc = readings[at.YAW_ACC], readings[at.PITCH_ACC]
    imu = imu_reading(acceleration, yaw_rate, pitch_rate, yaw_acc, pitch_acc, x[at.PITCH], mount)
    out[A_X], out[A_Y], out[A_Z] = imu.a_x, imu.a_y, imu.a_z
    out[PITCH_RATE], out[YAW_RATE] = imu.pitch_rate, imu.yaw_rate
    out[WHEEL_F], out[WHEEL_R] = readings[at.R_OMEGA], readings[at.AXLE + at.R_OMEGA]
    out[GNSS_X], out[GNSS_Y] = x[at.X], x[at.Y]
    for i in range(GNSS_SPEED):
        out[i] = out[i] * (1.0 + errors[SCALE, i]) + errors[OFFSET, i] + errors[NOISE_SD, i] * noise[i]
    # The receiver measures the velocity's two components; at rest its course is therefore arbitrary.
    cos, sin = math.cos(x[at.YAW]), math.sin(x[at.YAW])
    v_X = x[at.V_X] * cos - x[at.V_Y] * sin + errors[NOISE_SD, GNSS_SPEED] * noise[GNSS_SPEED]
    v_Y = x[at.V_X] * sin + x[at.V_Y] * cos + errors[NOISE_SD, GNSS_COURSE] * noise[GNSS_COURSE]
    out[GNSS_SPEED], out[GNSS_COURSE] = math.hypot(v_X, v_Y), math.atan2(v_Y, v_X)
    if not due[0]:
        out[WHEEL_F:GNSS_X] = math.nan
    if not due[1]:
        out[GNSS_X:] = math.nan
