"""What sensors on the vehicle measure, without and with their errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel

__all__ = [
    "CHANNELS",
    "GNSS",
    "IMU",
    "NOISE_SD",
    "OFFSET",
    "SCALE",
    "WHEEL",
    "ImuMount",
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

    lever: np.ndarray  #: (3,) position relative to the CG, body axes x forward, y left, z up [m]
    rotation: np.ndarray  #: (3, 3) columns: the sensor's axes in body axes
    body_axes: float  #: 1.0 = pitches with the body; 0.0 = held level, in heading axes
    gravity: float  #: 0.0 = kinematic acceleration; g = specific force [m/s^2]


@kernel
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _column(matrix, j, vector):
    """Component of ``vector`` along column ``j``."""
    return matrix[0, j] * vector[0] + matrix[1, j] * vector[1] + matrix[2, j] * vector[2]


@kernel
def imu_reading(acceleration_cg, yaw_rate, pitch_rate, yaw_acc, pitch_acc, pitch, mount):
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
    (a_x, a_y, a_z, pitch_rate, yaw_rate) in the sensor's axes [m/s^2, rad/s]. The gyro about the left
    axis reads -pitch_rate; it is published with the sign of pitch_rate.
    """
    cos, sin = 1.0, 0.0
    if mount.body_axes > 0.5:
        cos, sin = math.cos(pitch), math.sin(pitch)
    x, y, z = mount.lever[0], mount.lever[1], mount.lever[2]
    lever = (x * cos - z * sin, y, x * sin + z * cos)
    omega = (0.0, -pitch_rate, yaw_rate)
    swing = _cross((pitch_rate * yaw_rate, -pitch_acc, yaw_acc), lever)
    centripetal = _cross(omega, _cross(omega, lever))
    forward = acceleration_cg[0] + swing[0] + centripetal[0]
    left = acceleration_cg[1] + swing[1] + centripetal[1]
    up = acceleration_cg[2] + swing[2] + centripetal[2] + mount.gravity
    body_a = (forward * cos + up * sin, left, up * cos - forward * sin)
    body_omega = (yaw_rate * sin, -pitch_rate, yaw_rate * cos)
    R = mount.rotation
    return (
        _column(R, 0, body_a),
        _column(R, 1, body_a),
        _column(R, 2, body_a),
        -_column(R, 1, body_omega),
        _column(R, 2, body_omega),
    )


@kernel
def sense(x, readings, mount, errors, noise, due, out):
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
    a_x, a_y, a_z, pitching, yawing = imu_reading(
        acceleration, yaw_rate, pitch_rate, yaw_acc, pitch_acc, x[at.PITCH], mount
    )
    out[A_X], out[A_Y], out[A_Z], out[PITCH_RATE], out[YAW_RATE] = a_x, a_y, a_z, pitching, yawing
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
