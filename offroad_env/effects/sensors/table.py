"""Sensor errors: what a sensor adds to the quantity that it measures, one row an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from offroad_env.effects.protocol import Change, Effect, Parameter, SensorErrors, Setup, rotated

__all__ = ["TABLE"]

_row = partial(Effect, family="sensor", hook="sensor", sensors_only=True)

#: Places in `SensorErrors.offset`.
_A_X, _A_Y, _A_Z, _PITCH_RATE, _YAW_RATE = range(5)
#: Axes of the IMU's lever arm.
_FORWARD, _UP = 0, 2

_ACCELEROMETER = "IEEE Std 1293, accelerometer model equation: {}"
_GYRO = "IEEE Std 952, gyro model equation: bias"
_NAVIGATION = "Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems (2013): {}"


def _of_errors(changed: Callable[[SensorErrors, float], SensorErrors]) -> Change:
    """A change of the sensor errors alone, from them and the size."""

    def change(setup: Setup, size: float) -> Setup:
        return replace(setup, errors=changed(setup.errors, size))

    return change


def _of_lever(axis: int) -> Change:
    """The IMU further along one axis of the body [m]."""

    def change(setup: Setup, size: float) -> Setup:
        lever = setup.mount.lever.copy()
        lever[axis] += size
        return replace(setup, mount=setup.mount._replace(lever=lever))

    return change


TABLE = (
    _row(
        id="accel_bias_x",
        size=Parameter(name="bias", unit="m/s^2", low=-100.0, high=100.0),
        plausible=lambda vehicle: 1.0,
        sentence="a_x reads {size} too much",
        source=_ACCELEROMETER.format("bias"),
        look_alikes=("imu_misalignment_pitch", "grade"),
        separated_by="standing still, then turned by 180 degrees",
        needs=(("a_x",),),
        change=_of_errors(lambda errors, bias: errors.shifted(_A_X, bias)),
    ),
    _row(
        id="accel_bias_y",
        size=Parameter(name="bias", unit="m/s^2", low=-100.0, high=100.0),
        plausible=lambda vehicle: 1.0,
        sentence="a_y reads {size} too much",
        source=_ACCELEROMETER.format("bias"),
        look_alikes=("imu_misalignment_roll", "bank"),
        separated_by="standing still, then turned by 180 degrees",
        needs=(("a_y",),),
        change=_of_errors(lambda errors, bias: errors.shifted(_A_Y, bias)),
    ),
    _row(
        id="accel_bias_z",
        size=Parameter(name="bias", unit="m/s^2", low=-100.0, high=100.0),
        plausible=lambda vehicle: 1.0,
        sentence="a_z reads {size} too much",
        source=_ACCELEROMETER.format("bias"),
        look_alikes=("accel_scale",),
        separated_by="standing still",
        needs=(("a_z",),),
        change=_of_errors(lambda errors, bias: errors.shifted(_A_Z, bias)),
    ),
    _row(
        id="accel_scale",
        size=Parameter(name="share", unit="-", low=-0.9, high=3.0),
        plausible=lambda vehicle: 0.1,
        sentence="the accelerometers read {size} of the true value too much",
        source=_ACCELEROMETER.format("scale factor"),
        look_alikes=("accel_bias_z",),
        separated_by="standing still on each of its sides",
        change=_of_errors(lambda errors, share: replace(errors, accel_scale=errors.accel_scale + share)),
    ),
    _row(
        id="antenna_x",
        size=Parameter(name="distance", unit="m", low=-10.0, high=10.0),
        plausible=lambda vehicle: vehicle.l_f + vehicle.l_r,
        sentence="the positions are those of a point {size} further ahead on the vehicle than stated",
        source=_NAVIGATION.format("lever arm of the antenna"),
        look_alikes=("pose_delay",),
        separated_by="tight turns at walking pace",
        needs=(("x", "y"),),
        change=_of_errors(lambda errors, distance: replace(errors, antenna=errors.antenna + distance)),
    ),
    _row(
        id="gyro_bias_pitch",
        size=Parameter(name="bias", unit="rad/s", low=-20.0, high=20.0),
        plausible=lambda vehicle: 0.05,
        sentence="pitch_rate reads {size} too much",
        source=_GYRO,
        separated_by="standing still",
        needs=(("pitch_rate",),),
        change=_of_errors(lambda errors, bias: errors.shifted(_PITCH_RATE, bias)),
    ),
    _row(
        id="gyro_bias_yaw",
        size=Parameter(name="bias", unit="rad/s", low=-20.0, high=20.0),
        plausible=lambda vehicle: 0.05,
        sentence="yaw_rate reads {size} too much",
        source=_GYRO,
        look_alikes=("steer_offset",),
        separated_by="standing still",
        needs=(("yaw_rate",),),
        change=_of_errors(lambda errors, bias: errors.shifted(_YAW_RATE, bias)),
    ),
    _row(
        id="imu_misalignment_pitch",
        size=Parameter(name="angle", unit="rad", low=-0.6, high=0.6),
        plausible=lambda vehicle: 0.1,
        sentence="the IMU is pitched nose up by {size}",
        source=_NAVIGATION.format("mounting misalignment of the IMU"),
        look_alikes=("accel_bias_x", "grade"),
        separated_by="driving the same line both ways",
        change=lambda setup, angle: replace(setup, mount=rotated(setup.mount, 0.0, angle)),
    ),
    _row(
        id="imu_misalignment_roll",
        size=Parameter(name="angle", unit="rad", low=-0.6, high=0.6),
        plausible=lambda vehicle: 0.1,
        sentence="the IMU is rolled to the right by {size}",
        source=_NAVIGATION.format("mounting misalignment of the IMU"),
        look_alikes=("accel_bias_y", "bank"),
        separated_by="driving the same line both ways",
        change=lambda setup, angle: replace(setup, mount=rotated(setup.mount, angle, 0.0)),
    ),
    _row(
        id="lever_arm_x",
        size=Parameter(name="distance", unit="m", low=-10.0, high=10.0),
        plausible=lambda vehicle: 0.5,
        sentence="the IMU sits {size} further ahead of the centre of gravity than stated",
        source=_NAVIGATION.format("lever arm of the IMU"),
        separated_by="hard turns and bumps",
        change=_of_lever(_FORWARD),
    ),
    _row(
        id="lever_arm_z",
        size=Parameter(name="distance", unit="m", low=-10.0, high=10.0),
        plausible=lambda vehicle: 0.5,
        sentence="the IMU sits {size} further above the centre of gravity than stated",
        source=_NAVIGATION.format("lever arm of the IMU"),
        separated_by="hard turns and bumps",
        change=_of_lever(_UP),
    ),
    _row(
        id="pose_delay",
        size=Parameter(name="delay", unit="s", low=-0.5, high=1.0),
        plausible=lambda vehicle: 0.3,
        sentence="position, heading and speed over ground are {size} older than their time stamps",
        source=_NAVIGATION.format("time synchronisation of sensors"),
        look_alikes=("antenna_x",),
        separated_by="braking and turning hard",
        needs=(("x", "y", "yaw", "speed", "course"),),
        change=_of_errors(lambda errors, delay: replace(errors, pose_delay=errors.pose_delay + delay)),
    ),
    _row(
        id="wheel_radius_scale",
        size=Parameter(name="share", unit="-", low=-0.5, high=1.0),
        plausible=lambda vehicle: 0.1,
        sentence="the wheel speeds read {size} of the true value too much",
        source="Borenstein & Feng, IEEE Trans. Robotics and Automation 12 (1996): error of the wheel radius",
        separated_by="towing the vehicle with free wheels past a satellite receiver",
        needs=(("omega_f", "omega_r"),),
        change=_of_errors(lambda errors, share: replace(errors, wheel_scale=errors.wheel_scale + share)),
    ),
)
