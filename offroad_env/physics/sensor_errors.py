"""Sensors whose errors have a memory: drift, latency, lost samples, counts of an encoder, saturation.

What such a sensor delivers depends on more than the present state. A record of `SENSING` holds both what is
constant in an episode and what the sensors remember, so that one vehicle and a thousand run the same code.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.imu import (
    CHANNELS,
    GNSS,
    GNSS_COURSE,
    GNSS_SPEED,
    GNSS_X,
    GNSS_Y,
    IMU,
    NOISE_SD,
    OFFSET,
    SCALE,
    WHEEL,
    WHEEL_F,
    ImuMount,
    imu_reading,
)
from offroad_env.physics.imu_attitude import Attitude, imu_reading_at_attitude
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.records import FloatArray

__all__ = ["DEPTH", "IMU_LOSS", "NOISE_COLUMNS", "SENSING", "WHEEL_LOSS", "sense_into", "sense_with_memory"]

#: Samples of the IMU that the sensors remember: latency and window together stay below.
DEPTH = 64
#: Columns of the memory: the channels (velocities X, Y in place of speed and course), then the way that each
#: wheel's rim has rolled [m].
_ROLLED = CHANNELS
_COLUMNS = CHANNELS + 2
_INERTIAL = 5
#: Sensors that lose samples, in this order.
(IMU_LOSS, WHEEL_LOSS, GNSS_LOSS) = range(3)
#: Standard normal numbers of a sample: white noise of every channel, then what drives the drift of the five
#: inertial channels, that of the position, and the loss of samples of the three sensors.
_BIAS_NOISE, _DRIFT_NOISE, _LOSS_NOISE = CHANNELS, CHANNELS + _INERTIAL, CHANNELS + _INERTIAL + 2
NOISE_COLUMNS = _LOSS_NOISE + 3

#: Constants and memory of the sensors of one vehicle.
SENSING = np.dtype(
    [
        ("active", "f8"),  # 0: these sensors have no memory, `imu.sense` is all
        # constant in an episode
        ("dt", "f8"),  # time from sample to sample [s]
        ("limit", "f8", _INERTIAL),  # at which a channel saturates
        ("keep", "f8", _INERTIAL),  # share of the drifting bias that is left after a sample
        ("push", "f8", _INERTIAL),  # sd of what is added to it
        ("fix_keep", "f8"),  # the same for the error of the position
        ("fix_push", "f8"),
        ("pitch", "f8"),  # way of the rim from one count of the encoder to the next [m]; 0: no encoder
        ("phase", "f8", 2),  # share of a count by which each encoder has gone on at the start
        ("window", "i8"),  # samples over which counts are taken
        ("late", "i8", 3),  # samples by which IMU, wheel speeds and GNSS are late
        ("lose", "f8", 3),  # a good sensor fails where its normal number lies below
        ("recover", "f8", 3),  # a failed one works again where it lies below
        # memory
        ("count", "i8"),  # samples so far
        ("bias", "f8", _INERTIAL),  # drifting part
        ("fix_error", "f8", 2),  # drifting part, X and Y [m]
        ("lost", "f8", 3),  # 1: the sensor delivers nothing at present
        ("last", "f8", _INERTIAL),  # what the IMU has delivered last
        ("past", "f8", (DEPTH, _COLUMNS)),  # what sensors without errors would have measured
    ]
)


@inline_kernel
def _row(memory: np.record, back: int) -> FloatArray:
    """What was true ``back`` samples before the present one."""
    row: FloatArray = memory.past[:][(memory.count + DEPTH - back) % DEPTH]
    return row


@kernel
def _inertial_truth(x: FloatArray, readings: FloatArray, mount: ImuMount, row: FloatArray) -> None:
    """The exact reading of the IMU; its attitude has roll where the state does."""
    acceleration = (readings[at.A_X], readings[at.A_Y], readings[at.A_Z])
    yaw_rate, pitch_rate = x[at.YAW_RATE], x[at.PITCH_RATE]
    yaw_acc, pitch_acc = readings[at.YAW_ACC], readings[at.PITCH_ACC]
    reading = imu_reading(acceleration, yaw_rate, pitch_rate, yaw_acc, pitch_acc, x[at.PITCH], mount)
    if x.shape[0] > at.STATE_SIZE:
        rates = (yaw_rate, pitch_rate, x[at.ROLL_RATE], yaw_acc, pitch_acc, readings[at.ROLL_ACC])
        reading = imu_reading_at_attitude(acceleration, Attitude(x[at.PITCH], x[at.ROLL], *rates), mount)
    row[0], row[1], row[2] = reading.a_x, reading.a_y, reading.a_z
    row[3], row[4] = reading.pitch_rate, reading.yaw_rate


@kernel
def _start_past(memory: np.record, row: FloatArray) -> None:
    """Before the first sample the vehicle has moved as it does now."""
    for back in range(1, DEPTH):
        before, time = _row(memory, back), back * memory.dt
        copy_into(before, row)
        for i in range(2):
            before[GNSS_X + i] = row[GNSS_X + i] - time * row[GNSS_SPEED + i]
            before[_ROLLED + i] = row[_ROLLED + i] - time * row[WHEEL_F + i]


@kernel
def _note_truth(x: FloatArray, readings: FloatArray, mount: ImuMount, memory: np.record) -> None:
    """Write what sensors without errors measure now into the memory."""
    row = _row(memory, 0)
    _inertial_truth(x, readings, mount, row)
    row[WHEEL_F], row[WHEEL_F + 1] = readings[at.R_OMEGA], readings[at.AXLE + at.R_OMEGA]
    cos, sin = math.cos(x[at.YAW]), math.sin(x[at.YAW])
    row[GNSS_X], row[GNSS_Y] = x[at.X], x[at.Y]
    row[GNSS_SPEED] = x[at.V_X] * cos - x[at.V_Y] * sin
    row[GNSS_COURSE] = x[at.V_X] * sin + x[at.V_Y] * cos
    if memory.count == 0:
        phase = memory.phase[:]
        row[_ROLLED], row[_ROLLED + 1] = phase[0] * memory.pitch, phase[1] * memory.pitch
        _start_past(memory, row)
        return
    before = _row(memory, 1)
    for i in range(2):
        mean_speed = 0.5 * (before[WHEEL_F + i] + row[WHEEL_F + i])
        row[_ROLLED + i] = before[_ROLLED + i] + memory.dt * mean_speed


@kernel
def gilbert_loss(memory: np.record, sensor: int, number: float) -> bool:
    """Whether a sample is lost: a sensor that works or does not (Gilbert, Bell Syst. Tech. J. 39, 1960).

    ``number`` is standard normal; the first sample of an episode is never lost.
    """
    lost = memory.lost[:]
    if memory.count > 0:
        threshold = memory.recover[sensor] if lost[sensor] > 0.5 else memory.lose[sensor]
        if number < threshold:
            lost[sensor] = 1.0 - lost[sensor]
    return bool(lost[sensor] > 0.5)


@kernel
def encoder_speed(rolled: float, rolled_before: float, pitch: float, time: float) -> float:
    """Speed of a rim from the counts of an encoder within ``time`` [s], one every ``pitch`` [m]."""
    return (math.floor(rolled / pitch) - math.floor(rolled_before / pitch)) * pitch / time


@kernel
def _sense_imu(memory: np.record, errors: FloatArray, noise: FloatArray, out: FloatArray) -> None:
    """Accelerometers and gyros: late, scaled, with constant and drifting bias and noise, saturated.

    A lost sample repeats the last one, as a bus does that holds its last message.
    """
    seen, bias, last = _row(memory, memory.late[IMU_LOSS]), memory.bias[:], memory.last[:]
    for i in range(_INERTIAL):
        bias[i] = memory.keep[i] * bias[i] + memory.push[i] * noise[_BIAS_NOISE + i]
        measured = seen[i] * (1.0 + errors[SCALE, i]) + errors[OFFSET, i] + bias[i]
        measured += errors[NOISE_SD, i] * noise[i]
        out[i] = min(max(measured, -memory.limit[i]), memory.limit[i])
    if gilbert_loss(memory, IMU_LOSS, noise[_LOSS_NOISE + IMU_LOSS]):
        copy_into(out[IMU], last)
    copy_into(last, out[IMU])


@kernel
def _sense_wheels(memory: np.record, errors: FloatArray, noise: FloatArray, out: FloatArray) -> None:
    """Wheel speeds: late, counted, scaled, with noise; a lost sample is NaN."""
    late, window = memory.late[WHEEL_LOSS], memory.window
    now, before = _row(memory, late), _row(memory, late + window)
    for i in range(WHEEL_F, WHEEL_F + 2):
        speed = now[i]
        if memory.pitch > 0.0:
            rolled = now[i - WHEEL_F + _ROLLED]
            speed = encoder_speed(rolled, before[i - WHEEL_F + _ROLLED], memory.pitch, window * memory.dt)
        out[i] = speed * (1.0 + errors[SCALE, i]) + errors[OFFSET, i] + errors[NOISE_SD, i] * noise[i]
    if gilbert_loss(memory, WHEEL_LOSS, noise[_LOSS_NOISE + WHEEL_LOSS]):
        out[WHEEL] = math.nan


@kernel
def _sense_gnss(memory: np.record, errors: FloatArray, noise: FloatArray, out: FloatArray) -> None:
    """Position and velocity: late, with offset, correlated error and noise; a lost fix is NaN."""
    seen, drift = _row(memory, memory.late[GNSS_LOSS]), memory.fix_error[:]
    for i in range(2):
        j = GNSS_X + i
        out[j] = seen[j] + errors[OFFSET, j] + drift[i] + errors[NOISE_SD, j] * noise[j]
    v_X = seen[GNSS_SPEED] + errors[NOISE_SD, GNSS_SPEED] * noise[GNSS_SPEED]
    v_Y = seen[GNSS_COURSE] + errors[NOISE_SD, GNSS_COURSE] * noise[GNSS_COURSE]
    out[GNSS_SPEED], out[GNSS_COURSE] = math.hypot(v_X, v_Y), math.atan2(v_Y, v_X)
    if gilbert_loss(memory, GNSS_LOSS, noise[_LOSS_NOISE + GNSS_LOSS]):
        out[GNSS] = math.nan


@kernel
def sense_with_memory(
    x: FloatArray,
    readings: FloatArray,
    mount: ImuMount,
    errors: FloatArray,
    noise: FloatArray,
    due: tuple[bool, bool],
    memory: np.record,
    out: FloatArray,
) -> None:
    """One sample of every sensor, with errors that have a memory, into ``out``.

    Parameters
    ----------
    x, readings, mount, errors, due, out : as for `imu.sense`; of a state with roll, the roll as well
    noise : (NOISE_COLUMNS,) standard normal numbers
    memory : of the type `SENSING`; moves on by one sample
    """
    _note_truth(x, readings, mount, memory)
    _sense_imu(memory, errors, noise, out)
    fix_error = memory.fix_error[:]
    for i in range(2):
        fix_error[i] = memory.fix_keep * fix_error[i] + memory.fix_push * noise[_DRIFT_NOISE + i]
    out[WHEEL_F:] = math.nan
    if due[0]:
        _sense_wheels(memory, errors, noise, out)
    if due[1]:
        _sense_gnss(memory, errors, noise, out)
    memory.count += 1


@kernel
def sense_into(
    x: FloatArray,
    readings: FloatArray,
    mount: ImuMount,
    errors: FloatArray,
    noise: FloatArray,
    due: tuple[bool, bool],
    memories: np.ndarray,
    out: FloatArray,
) -> None:
    """`sense_with_memory` with the first record of ``memories`` (1,), for callers from Python."""
    sense_with_memory(x, readings, mount, errors, noise, due, memories[0], out)
