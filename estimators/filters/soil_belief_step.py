"""One sample of the online belief over whole soils (`estimators.filters.online_soil_belief`), as kernels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.navigation import GYRO_BIAS, V_SIDE, YAW, V, X, Y
from estimators.filters.online_base import MEAN_TIME, follow_command
from estimators.filters.soil_belief_points import (
    COPIES,
    GRADE,
    LOG_PRESSURE,
    PAIRS,
    SAMPLED,
    SIZE,
    Sigma,
    keep_in_range,
    place_sigma_points,
    plant_of_point,
)
from estimators.models.imu_prediction import Turning, mounted_reading
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_step
from offroad_env.physics.imu import A_X, A_Y, PITCH_RATE, YAW_RATE, ImuMount
from offroad_env.physics.numerics import GRAVITY, all_finite, copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.records import FloatArray
from offroad_env.physics.settle import settle

__all__ = [
    "AWAKE",
    "CHANNELS",
    "DISCREPANCY",
    "FLAGS",
    "HELD",
    "LEARNED",
    "NIS",
    "REJECTED",
    "REPAIRS",
    "RESETS",
    "SURPRISE",
    "TESTED",
    "UNSETTLED",
    "BeliefMemory",
    "BeliefRules",
    "learn_soil",
]

#: What copies are compared in: a_x, a_y, yaw rate, speed, rim speeds beyond it, front and rear.
CHANNELS = 6
_IMU_CHANNELS, _SPEED, _RIMS = 3, 3, 4
_USED = (A_X, A_Y, YAW_RATE)
#: Channels in which a wrong structure shows; wheels that spin up and roads show in the others.
_STRUCTURAL = (1, 2)
#: Where a channel's own error stands in the belief: biases of the inertial unit; none of the speed; rim
#: scale.
_OWN = (SAMPLED, SAMPLED + 1, SAMPLED + 2, -1, SAMPLED + 3, SAMPLED + 3)
(AWAKE, HELD, NIS, SURPRISE, UNSETTLED, REPAIRS, RESETS, DISCREPANCY, TESTED, REJECTED, LEARNED) = range(11)
FLAGS = 11
#: Halvings of a pair's distance until both of its soils carry the vehicle, and what a mean that does not
#: carry it gains in log pressure.
_TRIES, _FIRMER = 8, 0.3


class BeliefMemory(NamedTuple):
    """All that the filter remembers from sample to sample."""

    mean: FloatArray  #: (SIZE,) of the belief
    cov: FloatArray  #: (SIZE, SIZE)
    sigma: Sigma
    copies: FloatArray  #: (COPIES, 15) states
    warms: FloatArray  #: (COPIES, 2, columns) contact states
    last: FloatArray  #: (3,) last sample of a_x, a_y, yaw rate
    mean_innovation: FloatArray  #: (CHANNELS,) over `MEAN_TIME`
    short_innovation: FloatArray  #: (CHANNELS,) over ``short_time``
    discrepancy: FloatArray  #: (CHANNELS,) variance of errors that the model has beyond those assumed
    misfit: FloatArray  #: (CHANNELS,) variance of errors that neither the belief nor the sensors explain
    lean: FloatArray  #: (2,) by how much too fast the copies are for a slope of one towards X, Y [m/s]
    flags: FloatArray  #: (FLAGS,)


class BeliefRules(NamedTuple):
    """What is constant."""

    prior: FloatArray  #: (SIZE,) variances of the prior
    R: FloatArray  #: (CHANNELS,) variances of the measurement noise
    error: FloatArray  #: (CHANNELS,) variances of the errors that last, a part of it
    sensor: FloatArray  #: (CHANNELS,) variances of the sensors' white noise, another part
    drift: float  #: random walk, in standard deviations of the prior [1/sqrt(s)]
    lags: tuple[float, float]  #: of steering and torque [s]
    position_gain: float  #: gains [1/s]
    speed_gain: float
    side_gain: float
    yaw_rate_gain: float
    pitch_rate_gain: float
    hold_speed: float  #: [m/s]
    settle_time: float  #: [s]
    short_time: float  #: [s]
    memory_time: float  #: [s]
    misfit_time: float  #: [s]
    misfit: float
    test_time: float  #: [s]
    rejected_time: float  #: [s]
    surprise: float
    widening: float
    unsettled_time: float  #: [s]
    dt: float  #: [s]


@kernel
def _rest(memory: BeliefMemory, rules: BeliefRules, command: tuple[float, float, float]) -> None:
    """Hold, and let the actuators of the resting copies follow the command."""
    memory.flags[AWAKE], memory.flags[HELD] = 0.0, 1.0
    for i in range(COPIES):
        follow_command(memory.copies[i], command, rules.lags, rules.dt)


@kernel
def _settled(memory: BeliefMemory, plant: Plant, nav: FloatArray, i: int) -> bool:
    """Settle copy ``i`` on its own soil; whether the soil carries it."""
    own = plant_of_point(plant, memory.sigma.points[i])
    status, x, warm = settle(own, (nav[X], nav[Y], nav[YAW]), nav[V])
    if status >= SUNK or not all_finite(x):
        return False
    x[at.V_Y] = nav[V_SIDE]
    copy_into(x[at.STEER :], memory.copies[i, at.STEER :])
    copy_into(memory.copies[i], x)
    copy_into(memory.warms[i].reshape(-1), warm.reshape(-1))
    return True


@kernel
def _wake(memory: BeliefMemory, nav: FloatArray, plant: Plant) -> None:
    """Settle every copy on its own soil, rolling at the navigation filter's speed.

    The vehicle stands: a mean that does not carry it is firmer, a pair that does not is nearer to the mean.
    """
    scales = memory.sigma.scales
    scales[:] = 1.0
    for _ in range(_TRIES):
        place_sigma_points(memory.mean, memory.cov, memory.sigma)
        if _settled(memory, plant, nav, 0):
            break
        memory.mean[LOG_PRESSURE] += _FIRMER
    for i in range(SAMPLED):
        for _ in range(_TRIES):
            if _settled(memory, plant, nav, 1 + i) and (
                i >= PAIRS or _settled(memory, plant, nav, 1 + SAMPLED + i)
            ):
                break
            scales[i] *= 0.5
            place_sigma_points(memory.mean, memory.cov, memory.sigma)
    memory.last[:] = math.nan
    memory.short_innovation[:] = 0.0
    memory.lean[:] = 0.0
    memory.flags[AWAKE] = 1.0


@kernel
def _sleep(memory: BeliefMemory) -> None:
    """Hold, and start all copies again at the next sample."""
    copies = memory.copies
    copies[:, : at.STEER] = 0.0
    for i in range(COPIES):
        for j in range(at.STEER, at.STATE_SIZE):
            if not math.isfinite(copies[i, j]):
                copies[i, j] = 0.0
    memory.flags[AWAKE], memory.flags[HELD] = 0.0, 1.0


@kernel
def _pull(x: FloatArray, nav: FloatArray, imu: FloatArray, rules: BeliefRules) -> None:
    """Draw a copy towards what is measured: constant gains, wheels and heave left free."""
    dt = rules.dt
    x[at.X] += rules.position_gain * dt * (nav[X] - x[at.X])
    x[at.Y] += rules.position_gain * dt * (nav[Y] - x[at.Y])
    x[at.YAW] += rules.position_gain * dt * (nav[YAW] - x[at.YAW])
    x[at.V_X] += rules.speed_gain * dt * (nav[V] - x[at.V_X])
    x[at.V_Y] += rules.side_gain * dt * (nav[V_SIDE] - x[at.V_Y])
    x[at.YAW_RATE] += rules.yaw_rate_gain * dt * (imu[YAW_RATE] - nav[GYRO_BIAS] - x[at.YAW_RATE])
    x[at.PITCH_RATE] += rules.pitch_rate_gain * dt * (imu[PITCH_RATE] - x[at.PITCH_RATE])


@kernel
def _lean(memory: BeliefMemory, rules: BeliefRules, yaw: float) -> None:
    """Let the copies become too fast for an unknown slope, which does not act on them."""
    for i, along in enumerate((math.cos(yaw), math.sin(yaw))):
        memory.lean[i] += rules.dt * (GRAVITY * along - rules.speed_gain * memory.lean[i])


@kernel
def _add_slope(
    memory: BeliefMemory, mount: ImuMount, yaw: float, expected: FloatArray, rows: FloatArray
) -> None:
    """What an unknown slope of the ground does to the channels (CHANNELS,) and their rows, in place.

    Along it the vehicle accelerates less by g times the slope. An accelerometer that pitches with the body
    and measures gravity reads the force of the ground, whatever the slope; one that does not reads the
    acceleration.
    """
    unread = GRAVITY - mount.gravity * mount.body_axes
    for i, along in enumerate((math.cos(yaw), math.sin(yaw))):
        rows[0, GRADE + i] = -unread * along
        rows[_SPEED, GRADE + i] = -memory.lean[i]
        for j in (0, _SPEED):
            expected[j] += rows[j, GRADE + i] * memory.mean[GRADE + i]


@kernel
def _step_copies(
    memory: BeliefMemory,
    rules: BeliefRules,
    plant: Plant,
    command: tuple[float, float, float],
    mount: ImuMount,
    predicted: FloatArray,
) -> bool:
    """Read every copy and carry it over a step, each on its own soil; whether all kept their contact.

    ``predicted`` (COPIES, CHANNELS): the inertial unit before the step, speed and rims after it.
    """
    work, readings, imu = (
        np.empty((WORK_ROWS, at.READINGS_SIZE)),
        np.empty(at.READINGS_SIZE),
        np.empty(5),
    )
    sound = True
    for i in range(COPIES):
        x = memory.copies[i]
        motion = Turning(x[at.YAW_RATE], x[at.PITCH_RATE], x[at.PITCH])
        own = plant_of_point(plant, memory.sigma.points[i])
        status = full_step(x, memory.warms[i], command, own, rules.dt, work, readings)
        mounted_reading(motion, readings, mount, imu)
        for j in range(_IMU_CHANNELS):
            predicted[i, j] = imu[_USED[j]]
        predicted[i, _SPEED] = x[at.V_X]
        predicted[i, _RIMS] = plant.vehicle.r * x[at.OMEGA_F] - x[at.V_X]
        predicted[i, _RIMS + 1] = plant.vehicle.r * x[at.OMEGA_R] - x[at.V_X]
        if status >= SUNK or not all_finite(x) or not all_finite(predicted[i]):
            sound = False
    return sound


class Linearised(NamedTuple):
    """Prediction of the channels by the belief."""

    expected: FloatArray  #: (CHANNELS,)
    rows: FloatArray  #: (CHANNELS, SIZE) sensitivity
    curvature: FloatArray  #: (CHANNELS,) variance of what is not linear


@kernel
def _linearise(memory: BeliefMemory, predicted: FloatArray, rims: FloatArray) -> Linearised:
    """Expectation and sensitivity of every channel by central differences over the pairs.

    To second order: a column along which the pair's mean lies c/2 off the middle adds c/2 to the expectation
    and c^2/2 to the variance (M. Athans, R. Wishner & A. Bertolini, IEEE Trans. Automatic Control 13(5),
    1968). Where only the point ahead drives, the difference is one-sided and the column counts as linear.
    """
    L, scales = memory.sigma.factor, memory.sigma.scales
    expected, rows, curvature = np.zeros(CHANNELS), np.zeros((CHANNELS, SIZE)), np.zeros(CHANNELS)
    for j in range(CHANNELS):
        expected[j] = predicted[0, j]
        own = _OWN[j]
        if own >= 0:
            factor = rims[j - _RIMS] if j >= _RIMS else 1.0
            rows[j, own] = factor
            expected[j] += factor * memory.mean[own]
        for i in range(SAMPLED - 1, -1, -1):
            ahead = predicted[1 + i, j]
            opposite = predicted[1 + SAMPLED + i, j] if i < PAIRS else 2.0 * predicted[0, j] - ahead
            bend = (ahead + opposite - 2.0 * predicted[0, j]) / (scales[i] * scales[i])
            expected[j] += 0.5 * bend
            curvature[j] += 0.5 * bend * bend
            # Columns of L to numbers of the belief: h L = b, from the last column on.
            total = (ahead - opposite) / (2.0 * scales[i])
            for k in range(i + 1, SAMPLED):
                total -= rows[j, k] * L[k, i]
            rows[j, i] = total / L[i, i]
    return Linearised(expected, rows, curvature)


@kernel
def _correct(memory: BeliefMemory, row: FloatArray, residual: float, variance: float, most: float) -> float:
    """Scalar Kalman update with a measurement row (SIZE,), in place; returns the normalised square.

    The share of the variance along the row that it removes is at most about ``most``.
    """
    mean, cov, gain = memory.mean, memory.cov, np.zeros(SIZE)
    spread = 0.0
    for i in range(SIZE):
        total = 0.0
        for j in range(SIZE):
            total += cov[i, j] * row[j]
        gain[i] = total
    for i in range(SIZE):
        spread += row[i] * gain[i]
    whole = spread + max(variance, spread * (1.0 - most) / most)
    for i in range(SIZE):
        mean[i] += gain[i] * residual / whole
        for j in range(i + 1):
            cov[i, j] -= gain[i] * gain[j] / whole
            cov[j, i] = cov[i, j]
    return residual * residual / (spread + variance)


@kernel
def _spread_of(cov: FloatArray, row: FloatArray) -> float:
    """Variance of a channel by the belief."""
    total = 0.0
    for i in range(SIZE):
        for j in range(SIZE):
            total += row[i] * cov[i, j] * row[j]
    return total


@kernel
def _note_innovation(
    memory: BeliefMemory, rules: BeliefRules, j: int, innovation: float, spread: float
) -> float:
    """Running means of an innovation; returns the square of the long one over its variance.

    What the short mean has beyond its variance is a discrepancy of the model that lasts: it is learnt, and
    counts as noise of that duration from then on (M. Kennedy & A. O'Hagan, J. R. Stat. Soc. B 63(3), 2001,
    call the discrepancy of a model what remains at its best parameters).
    """
    dt, R = rules.dt, rules.R[j]
    share = min(dt / MEAN_TIME, 1.0)
    memory.mean_innovation[j] += share * (innovation - memory.mean_innovation[j])
    memory.short_innovation[j] += dt / rules.short_time * (innovation - memory.short_innovation[j])
    expected = R * dt / (2.0 * rules.short_time) + spread
    excess = memory.short_innovation[j] ** 2 - expected
    old = memory.discrepancy[j]
    memory.discrepancy[j] = max(old + dt / rules.memory_time * (excess - old), 0.0)
    unexplained = memory.short_innovation[j] ** 2 - rules.sensor[j] * dt / (2.0 * rules.short_time) - spread
    before = memory.misfit[j]
    memory.misfit[j] = max(before + dt / rules.misfit_time * (unexplained - before), 0.0)
    square: float = memory.mean_innovation[j] ** 2 / (R * dt / (2.0 * MEAN_TIME) + spread)
    return square


@kernel
def _test_structure(memory: BeliefMemory, rules: BeliefRules) -> None:
    """Reject the structure while sideways motion errs by more than the belief and the sensors explain.

    Whatever belief there is at the start is wide and errs: the test begins some time later.
    """
    flags, worst = memory.flags, 0.0
    flags[TESTED] += rules.dt
    flags[LEARNED] += rules.dt
    for j in _STRUCTURAL:
        worst = max(worst, memory.misfit[j] / rules.error[j])
    if flags[TESTED] >= rules.test_time and worst > rules.misfit * rules.misfit:
        flags[REJECTED] = rules.rejected_time


@kernel
def _widen(memory: BeliefMemory, rules: BeliefRules) -> None:
    """The model does not explain the innovations: part of the prior comes back, and the flag is down."""
    for i in range(SIZE):
        memory.cov[i, i] = min(memory.cov[i, i] + rules.widening * rules.prior[i], rules.prior[i])
        for j in range(i):
            # Correlations fade with it: the matrix stays positive.
            memory.cov[i, j] *= 1.0 - rules.widening
            memory.cov[j, i] = memory.cov[i, j]
    memory.mean_innovation[:] = 0.0
    memory.flags[UNSETTLED] = rules.unsettled_time
    memory.flags[RESETS] += 1.0
    memory.flags[LEARNED] = 0.0


@kernel
def _compare(
    memory: BeliefMemory,
    rules: BeliefRules,
    mount: ImuMount,
    nav: FloatArray,
    rims: FloatArray,
    predicted: FloatArray,
) -> None:
    """Compare what the copies predicted with the samples that belong to it, and learn."""
    found = _linearise(memory, predicted, rims)
    _add_slope(memory, mount, nav[YAW], found.expected, found.rows)
    z = np.empty(CHANNELS)
    copy_into(z[:_IMU_CHANNELS], memory.last)
    z[2] -= nav[GYRO_BIAS]
    z[_SPEED], z[_RIMS], z[_RIMS + 1] = nav[V], rims[0] - nav[V], rims[1] - nav[V]
    most, before, flags = rules.dt / rules.settle_time, memory.mean.copy(), memory.flags
    surprise, nis, largest = 0.0, 0.0, 0.0
    for j in range(CHANNELS):
        innovation = z[j] - found.expected[j]
        if not math.isfinite(innovation):
            continue
        row, spread = found.rows[j], _spread_of(memory.cov, found.rows[j]) + found.curvature[j]
        surprise += _note_innovation(memory, rules, j, innovation, spread)
        largest = max(largest, memory.discrepancy[j] / rules.error[j])
        variance = rules.R[j] + found.curvature[j]
        # An error that lasts the time T counts as white noise of the variance 2 s^2 T/dt.
        variance += 2.0 * memory.discrepancy[j] * rules.short_time / rules.dt
        residual = innovation
        for i in range(SIZE):
            residual -= row[i] * (memory.mean[i] - before[i])
        nis += _correct(memory, row, residual, variance, most)
    keep_in_range(memory.mean)
    _test_structure(memory, rules)
    flags[NIS], flags[HELD], flags[SURPRISE], flags[DISCREPANCY] = nis, 0.0, surprise, largest
    if surprise > 2.0 * rules.surprise and rules.widening > 0.0:
        _widen(memory, rules)


@kernel
def learn_soil(
    memory: BeliefMemory,
    rules: BeliefRules,
    packed: PackedPlant,
    mount: ImuMount,
    nav: FloatArray,
    imu: FloatArray,
    rims: FloatArray,
    command: tuple[float, float, float],
) -> None:
    """Take in one sample of the sensors; the navigation filter has taken it in already.

    The sample of the inertial unit that belongs to a prediction is the previous one, taken at the state
    before the step; speed and rims belong to the state after it.
    """
    plant, flags = unpack(packed), memory.flags
    flags[UNSETTLED] = max(flags[UNSETTLED] - rules.dt, 0.0)
    flags[REJECTED] = max(flags[REJECTED] - rules.dt, 0.0)
    for i in range(SIZE):
        grown = memory.cov[i, i] + rules.drift * rules.drift * rules.prior[i] * rules.dt
        memory.cov[i, i] = max(min(grown, rules.prior[i]), memory.cov[i, i])
    if not (nav[V] > rules.hold_speed and all_finite(imu)):
        _rest(memory, rules, command)
        return
    if flags[AWAKE] < 0.5:
        _wake(memory, nav, plant)
    predicted = np.empty((COPIES, CHANNELS))
    flags[REPAIRS] += place_sigma_points(memory.mean, memory.cov, memory.sigma)
    if not _step_copies(memory, rules, plant, command, mount, predicted):
        _sleep(memory)
        return
    _lean(memory, rules, nav[YAW])
    if math.isfinite(memory.last[0]):
        _compare(memory, rules, mount, nav, rims, predicted)
    for j in range(_IMU_CHANNELS):
        memory.last[j] = imu[_USED[j]]
    for i in range(COPIES):
        _pull(memory.copies[i], nav, imu, rules)
