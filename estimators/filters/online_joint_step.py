"""One sample of the online joint filter, as kernels; the filter is `estimators.filters.online_joint_ukf`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.change_test import MOVE, MOVE_VARIANCE, add_update, has_changed
from estimators.filters.gaussian_sum import TIDY, merge_components, mixture_moments, normalise
from estimators.filters.innovation_test import mean_innovation_test
from estimators.filters.navigation import YAW, V, X, Y
from estimators.filters.online_base import MEAN_TIME, WIDEST, follow_command, report_estimate
from estimators.numerics.bounded import to_range
from estimators.numerics.unscented import (
    SigmaWeights,
    UnscentedUpdate,
    sigma_points,
    unscented_mean_covariance,
    unscented_update,
)
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.imu import A_X, A_Y, YAW_RATE
from offroad_env.physics.records import FloatArray

__all__ = [
    "ALIVE",
    "AWAKE",
    "CHANGES",
    "CHANNELS",
    "HELD",
    "MEMORY",
    "NIS",
    "PUSHES",
    "SURPRISE",
    "USED",
    "ChangeTest",
    "JointRules",
    "JointState",
    "copies_of",
    "note_estimate",
    "place_all_points",
    "update_all",
]

PUSHES = 2
#: Readings of the inertial unit that are used. The vertical ones show the road.
USED = np.array([A_X, A_Y, YAW_RATE])
CHANNELS = 3
_LOG_2PI = math.log(2.0 * math.pi)
#: Neighbours are one once their squared distance in eta falls below this share of their variances.
_MEET = 0.5
#: How well the navigation filter knows the heading, for the side speed in a satellite's course [rad].
_HEADING_SD = 0.02
# A fix of GNSS.
_SPEED, _COURSE = 2, 3
# Scalars in the filter's memory.
(NIS, REPAIRS, HELD, AWAKE, SURPRISE, ALIVE, SAMPLES, UNSETTLED, CHANGES) = range(9)
MEMORY = 9


class ChangeTest(NamedTuple):
    """Settings of the test for a change of the soil."""

    time: float  #: fading window [s]
    level: float  #: [standard deviations]
    settle: float  #: how long the flag stays down after a change [s]


class JointRules(NamedTuple):
    """Settings, ranges and noise as the kernels need them."""

    n_range: tuple[float, float]  #: of the reported mean [-]
    low: float  #: bounds of n inside the filter [-]
    high: float
    states: FloatArray  #: (S,) indices of the motion in the vehicle's state
    Q: FloatArray  #: (L,) variances of the process noise a step
    R: FloatArray  #: (3,) variances of the inertial unit
    fix: float  #: variance of a component of the satellite's velocity [m^2/s^2]
    fade: float  #: what is left of a push after a step [-]
    weights: SigmaWeights
    lags: tuple[float, float]  #: of steering and torque [s]
    hold_speed: float  #: [m/s]
    log_drop: float
    surprise: float  #: largest chi-square of the mean innovation for a valid estimate
    change: ChangeTest
    dt: float  #: [s]


class JointState(NamedTuple):
    """The belief and its copies of the vehicle; the components that are alive stand first."""

    means: FloatArray  #: (K, L) [eta, motion, pushes]
    covs: FloatArray  #: (K, L, L)
    log_weights: FloatArray  #: (K,)
    points: FloatArray  #: (K, 2 L + 1, L)
    copies: FloatArray  #: (K C, 15) of the points that differ in more than pushes
    warms: FloatArray  #: (K C, 2, 3)
    exponents: FloatArray  #: (K C,)
    predicted: FloatArray  #: (K C, 5) readings of the copies
    shared: FloatArray  #: (15,) place, heading and actuators
    last: FloatArray  #: (3,) readings of the sample before
    mean_innovation: FloatArray  #: (3,) running mean of the innovations in standard deviations
    windows: FloatArray  #: (K, 3) of `estimators.filters.change_test`
    memory: FloatArray  #: scalars
    report: FloatArray  #: (5,) the estimate, fields of `estimators.filters.protocol.Estimate`


@kernel
def copies_of(rules: JointRules) -> int:
    """How many sigma points of a component differ in more than pushes."""
    return 3 + 2 * len(rules.states)


@kernel
def _copy_of(point: int, L: int, rules: JointRules) -> int:
    """Copy of the vehicle that a sigma point shares: 0, the centre's, for those along pushes."""
    moving = 1 + rules.states.shape[0]
    if point <= moving:
        return point
    return point - L + moving if L < point <= L + moving else 0


@kernel
def _place_points(state: JointState, k: int, rules: JointRules) -> int:
    """Draw the sigma points of component ``k`` and set its copies; returns the repairs."""
    points = state.points[k]
    L, C = points.shape[1], copies_of(rules)
    repairs = sigma_points(state.means[k], state.covs[k], rules.weights.scale, np.empty((L, L)), points)
    for p in range(points.shape[0]):
        own = _copy_of(p, L, rules)
        if own > 0 or p == 0:
            x = state.copies[k * C + own]
            x[:] = state.shared
            for s in range(rules.states.shape[0]):
                x[rules.states[s]] = points[p, 1 + s]
            state.exponents[k * C + own] = to_range(points[p, 0], rules.low, rules.high)
    return repairs


@kernel
def note_estimate(state: JointState, rules: JointRules) -> None:
    """Note the estimate of the sum, in place."""
    memory, alive = state.memory, int(state.memory[ALIVE])
    etas, variances = state.means[:alive, 0], state.covs[:alive, 0, 0]
    moments = mixture_moments(state.log_weights[:alive], etas, variances, rules.low, rules.high)
    calm = memory[UNSETTLED] <= 0.0 and memory[SURPRISE] < rules.surprise
    estimate = report_estimate(moments, rules.n_range, memory[NIS], memory[REPAIRS], calm)
    state.report[0], state.report[1], state.report[2] = estimate.mean, estimate.sd, estimate.nis
    state.report[3] = 1.0 if estimate.valid else 0.0
    state.report[4] = estimate.repairs


@kernel
def place_all_points(
    state: JointState,
    nav: FloatArray,
    imu: FloatArray,
    command: tuple[float, float, float],
    rules: JointRules,
) -> bool:
    """Place the sigma points at the pose of the navigation filter; false while the filter rests."""
    shared, memory = state.shared, state.memory
    memory[SAMPLES] += 1.0
    slow = not (nav[V] > rules.hold_speed and np.isfinite(imu).all())
    if slow or memory[AWAKE] < 0.5:
        memory[AWAKE], memory[HELD] = 0.0, 1.0
        for k in range(int(memory[ALIVE])):
            state.covs[k, 0, 0] += rules.Q[0]
        follow_command(shared, command, rules.lags, rules.dt)
        note_estimate(state, rules)
        return False
    shared[at.X], shared[at.Y], shared[at.YAW] = nav[X], nav[Y], nav[YAW]
    for k in range(int(memory[ALIVE])):
        memory[REPAIRS] += _place_points(state, k, rules)
    return True


@kernel
def _collect_points(state: JointState, k: int, rules: JointRules, readings: FloatArray) -> None:
    """Points of component ``k`` after the step, in place, and their readings before it (2 L + 1, 3)."""
    points = state.points[k]
    motion, C = rules.states.shape[0], copies_of(rules)
    push = 1 + motion
    for p in range(points.shape[0]):
        own = k * C + _copy_of(p, points.shape[1], rules)
        for j in range(CHANNELS):
            readings[p, j] = state.predicted[own, USED[j]]
        for s in range(motion):
            points[p, 1 + s] = state.copies[own, rules.states[s]]
        # A push acts on the accelerometer and the speed of its axis, and fades.
        for axis in range(PUSHES):
            readings[p, axis] += points[p, push + axis]
            points[p, 1 + axis] += points[p, push + axis] * rules.dt
            points[p, push + axis] *= rules.fade


@kernel
def _component_step(state: JointState, k: int, rules: JointRules, innovation: FloatArray) -> UnscentedUpdate:
    """Predict component ``k`` and update it with the last sample of the inertial unit, in place.

    ``innovation`` (3,) is filled, in standard deviations.
    """
    mean, cov, points = state.means[k], state.covs[k], state.points[k]
    readings = np.empty((points.shape[0], CHANNELS))
    _collect_points(state, k, rules, readings)
    unscented_mean_covariance(points, rules.weights, mean, cov)
    for i in range(mean.shape[0]):
        cov[i, i] += rules.Q[i]
    eta, variance = mean[0], cov[0, 0]
    update = unscented_update(mean, cov, points, readings, state.last, rules.R, rules.weights, innovation)
    add_update(state.windows[k], mean[0] - eta, variance - cov[0, 0], rules.change.time, rules.dt)
    return update


@kernel
def _widen_after_change(state: JointState, rules: JointRules) -> None:
    """Where n has changed, widen the belief by the change, in place, and lower the flag.

    With P the variance of eta, m the window's sum of updates and V its variance, P m / V is the change that
    explains the window best.
    """
    memory, change = state.memory, rules.change
    memory[UNSETTLED] = max(memory[UNSETTLED] - rules.dt, 0.0)
    for k in range(int(memory[ALIVE])):
        window, variance = state.windows[k], state.covs[k, 0, 0]
        if has_changed(window, change.time, change.level):
            wider = variance + (variance * window[MOVE] / window[MOVE_VARIANCE]) ** 2
            added = max(min(wider, WIDEST) - variance, 0.0)
            # What was inferred from the old n is wrong in proportion to its covariance with eta.
            along = state.covs[k, 0] / variance
            state.covs[k] += added * np.outer(along, along)
            window[:] = 0.0
            memory[UNSETTLED] = change.settle
            memory[CHANGES] += 1.0


@kernel
def _update_speed(mean: FloatArray, cov: FloatArray, axis: int, speed: float, variance: float) -> float:
    """Measured speed along (0) or across (1), in place; returns the log likelihood."""
    gain = cov[1 + axis].copy()
    total, residual = variance + gain[1 + axis], speed - mean[1 + axis]
    for i in range(mean.shape[0]):
        mean[i] += gain[i] * residual / total
        for j in range(mean.shape[0]):
            cov[i, j] -= gain[i] * gain[j] / total
    log_likelihood: float = -0.5 * (residual * residual / total + math.log(total) + _LOG_2PI)
    return log_likelihood


@kernel
def _update_fix(mean: FloatArray, cov: FloatArray, gnss: FloatArray, yaw: float, rules: JointRules) -> float:
    """Measured velocity of a satellite fix, in place; returns the log likelihood."""
    angle, v = gnss[_COURSE] - yaw, gnss[_SPEED]
    along = _update_speed(mean, cov, 0, v * math.cos(angle), rules.fix)
    heading = (_HEADING_SD * v) ** 2
    return along + _update_speed(mean, cov, 1, v * math.sin(angle), rules.fix + heading)


@kernel
def update_all(state: JointState, nav: FloatArray, gnss: FloatArray, rules: JointRules) -> None:
    """Update with the last inertial sample and a fix; weigh the components and test the innovations."""
    memory, log_weights = state.memory, state.log_weights
    alive = int(memory[ALIVE])
    state.shared[at.STEER :] = state.copies[0, at.STEER :]
    innovations = np.empty((alive, CHANNELS))
    fixed = np.isfinite(gnss).all() and gnss[_SPEED] > rules.hold_speed
    best = 0
    for k in range(alive):
        update = _component_step(state, k, rules, innovations[k])
        memory[REPAIRS] += update.repairs
        log_weights[k] += update.log_likelihood
        if fixed:
            log_weights[k] += _update_fix(state.means[k], state.covs[k], gnss, nav[YAW], rules)
        if k == 0 or log_weights[k] > log_weights[best]:
            best, memory[NIS] = k, update.nis
    normalise(log_weights[:alive])
    share = rules.dt / MEAN_TIME
    variance = np.full(CHANNELS, 0.5 * share)
    memory[SURPRISE] = mean_innovation_test(state.mean_innovation, innovations[best], variance, share)
    memory[HELD] = 0.0
    if alive > 1 and int(memory[SAMPLES]) % TIDY == 0:
        _prune_and_merge(state, rules)
    if int(memory[ALIVE]) == 1:
        _widen_after_change(state, rules)
    note_estimate(state, rules)


@kernel
def _prune_and_merge(state: JointState, rules: JointRules) -> None:
    """Drop components without weight, merge neighbours that have met, in place."""
    C = copies_of(rules)
    k = 0
    while k < int(state.memory[ALIVE]):
        if state.log_weights[k] < rules.log_drop:
            _remove(state, k, C)
        else:
            k += 1
    a = 0
    while a < int(state.memory[ALIVE]):
        b = a + 1
        while b < int(state.memory[ALIVE]):
            gap = state.means[b, 0] - state.means[a, 0]
            if gap * gap < _MEET * (state.covs[a, 0, 0] + state.covs[b, 0, 0]):
                merge_components(state.log_weights, state.means, state.covs, a, b)
                state.windows[a] = 0.0
                _remove(state, b, C)
            else:
                b += 1
        a += 1


@kernel
def _remove(state: JointState, k: int, C: int) -> None:
    """Take component ``k`` out; the last one moves into its place."""
    last = int(state.memory[ALIVE]) - 1
    state.means[k], state.covs[k] = state.means[last], state.covs[last]
    state.windows[k] = state.windows[last]
    state.log_weights[k] = state.log_weights[last]
    state.copies[k * C : (k + 1) * C] = state.copies[last * C : (last + 1) * C]
    state.warms[k * C : (k + 1) * C] = state.warms[last * C : (last + 1) * C]
    state.memory[ALIVE] = last
