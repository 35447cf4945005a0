"""State and soil in one belief, on board: a joint filter, or several of them, on any model of the vehicle.

The filter of `estimators.joint` believes in a map and in the paper's dynamics. On board neither is
given: the ground is what the sensors feel, and the drive is torque at wheels that slip. The belief
here holds what the soil acts on - speeds, heave and pitch, wheel spin - and eta, the sinkage
exponent on an unbounded scale. Place and heading come from the navigation filter, the actuators
follow the known command.

*Roughness is a state.* On ground that is believed to be level, the slopes that are really there
push the vehicle for tenths of a second, forward and to the side. That is no white noise: a filter
that took it for such would be too sure of n after a second. The two pushes are states of their own,
which wander and fade. They act on speeds and accelerometers alike, which tells them from sensor
noise, and average out over time, which tells them from n.

*What the soil does not feel costs nothing.* In the order [eta, motion, pushes] the last columns of
the Cholesky factor change pushes only: their sigma points share the step of the centre.

*One step a sample.* A sigma point is read where it stands and then carried on, so the covariance of
that reading with the state one period later is at hand: every sample of the inertial unit is used
one period late, without a second evaluation of the wheels. The velocity of a satellite fix is
linear in the state and is used at once. Rim speeds only serve navigation: with a radius known to
1 % they would tell a slip that is wrong by 0.01, a force that is wrong by 0.13 m/s^2.

With more than one component the belief is a Gaussian sum over n (see `estimators.bank`): each
component is narrow, and the weights follow from how well each predicted.

*How it notices another soil.* Whoever believes that n hardly changes expects to change their mind by
no more than the samples may teach: the updates of eta are white, and their variance is what the
belief loses. Where a second teaches three standard deviations more than that, the soil has changed.
The belief is then widened by the change that explains the window, together with all that was
inferred from the old n, and the flag is down until it has been followed (`_notice`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.embedded import checked_range
from estimators.models import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.navigation import V_SIDE, YAW, NavigationFilter, V, X, Y, navigate
from estimators.protocol import Estimate, Pose
from estimators.transforms import belief_of, moments, to_range
from estimators.ukf_compiled import guarded_cholesky
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.physics.settle import settle
from offroad_env.sensors import GnssConfig, ImuConfig
from offroad_env.simulator import Plant, plant_model

__all__ = ["OnBoardFilter", "OnBoardSettings"]

#: States of the vehicle in the belief, after eta and before the pushes. The bicycle does not heave, the
#: paper's wheels do not spin.
_MOTION = (at.V_X, at.V_Y, at.YAW_RATE)
_HEAVE = (at.Z, at.PITCH, at.V_Z, at.PITCH_RATE)
_SPIN = (at.OMEGA_F, at.OMEGA_R)
_PUSHES = 2
#: Readings of the inertial unit that are used: a_x, a_y, yaw rate. The vertical ones show the road.
_USED = np.array([0, 1, 4])
_LOG_2PI = math.log(2.0 * math.pi)
#: The filter's range is wider than the user's by this share on both sides: a bound is endlessly far
#: away on the scale of eta, so a soil close to one would be approached too slowly.
_MARGIN = 0.15
#: Half the step of the difference that ties the settled start to eta.
_START_STEP = 0.05
#: Time over which innovations are averaged for the validity flag [s].
_MEAN_TIME = 2.0
#: Samples between two looks at which components to drop and to merge.
_TIDY = 10
#: Neighbours are one once their squared distance in eta falls below this share of their variances.
_MEET = 0.5
#: How well the navigation filter knows the heading, for the side speed in a satellite's course [rad].
_HEADING_SD = 0.02
# Scalars in the filter's memory.
(NIS, REPAIRS, HELD, AWAKE, SURPRISE, ALIVE, SAMPLES, UNSETTLED, CHANGES) = range(9)
_MEMORY = 9
#: Settings of the test for a change.
_CHANGE = ("change_time", "change_level", "change_settle")
#: Variance of eta up to which a change widens the belief: a fifth of the range of n, as wide as a prior.
_WIDEST = 1.0


@dataclass(frozen=True, kw_only=True)
class OnBoardSettings:
    """What can be chosen; each value has its reason here."""

    components: int = 1  #: 1 = a joint filter; more = a bank of them over n
    spread: float = 1.7  #: sigma points in standard deviations: sqrt(3) has the fourth moment right
    drift: float = 0.02  #: random walk of eta [1/sqrt(s)]: about 0.005 of n per sqrt(s)
    push: tuple[float, float] = (0.15, 0.3)  #: standard deviation of the pushes along, across [m/s^2]
    push_time: float = 0.3  #: how long a push lasts: a metre or two of ground [s]
    #: Random walks of v_x, v_y, yaw rate; z, pitch, v_z, pitch rate; wheel spin [the unit per sqrt(s)].
    walk: tuple[float, ...] = (0.02, 0.03, 0.12, 6e-4, 4e-4, 0.008, 0.012, 0.3)
    #: Start: standard deviation of the same [m/s, rad/s; m, rad, m/s, rad/s; rad/s].
    start: tuple[float, ...] = (0.2, 0.1, 0.03, 0.005, 0.005, 0.03, 0.03, 1.0)
    hold_speed: float = 1.0  #: below this the filter rests and the estimate holds [m/s]
    surprise: float = 25.0  #: largest chi-square (3 channels) of the mean innovation for a valid estimate
    drop: float = 1e-4  #: weight below which a component is dropped

    change_time: float = 1.0  #: fading window of the test for a change of n [s]
    #: Deviation at which n has changed [standard deviations]; constant soils reach 2.7 in half a minute
    #: on roads of class B, a step of a quarter reaches 4.
    change_level: float = 3.0
    change_settle: float = 1.0  #: how long the flag stays down after a change [s]

    def __post_init__(self) -> None:
        if not 1 <= self.components <= 20:
            raise InvalidParameter(f"components must be in [1, 20], got {self.components}")
        for name in ("spread", "drift", "push_time", "hold_speed", "surprise", "drop", *_CHANGE):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")
        for name, count in (("push", 2), ("walk", 8), ("start", 8)):
            values = getattr(self, name)
            if len(values) != count or not all(value > 0.0 for value in values):
                raise InvalidParameter(f"{name} must be {count} numbers > 0, got {values}")


class _Rules(NamedTuple):
    """What the kernels need besides the belief."""

    low: float  #: bounds of n [-]
    high: float
    states: np.ndarray  #: (S,) where the motion stands in the vehicle's state
    Q: np.ndarray  #: (L,) variances of the process noise a step
    R: np.ndarray  #: (3,) variances of the inertial unit
    fix: float  #: variance of a component of the satellite's velocity [m^2/s^2]
    fade: float  #: what is left of a push after a step [-]
    spread: float  #: of the sigma points [standard deviations]
    hold_speed: float  #: [m/s]
    log_drop: float
    change: tuple[float, float, float]  #: time [s], level [standard deviations], settling [s]
    dt: float  #: [s]


class _State(NamedTuple):
    """The belief and its copies of the vehicle; the components that are alive stand first."""

    means: np.ndarray  #: (K, L)
    covs: np.ndarray  #: (K, L, L)
    log_weights: np.ndarray  #: (K,)
    points: np.ndarray  #: (K, 2 L + 1, L)
    copies: np.ndarray  #: (K C, 15) of the points that the soil feels
    warms: np.ndarray  #: (K C, 2, 3)
    exponents: np.ndarray  #: (K C,)
    predicted: np.ndarray  #: (K C, 5) readings of the copies
    shared: np.ndarray  #: (15,) place, heading and actuators
    last: np.ndarray  #: (3,) readings of the sample before
    mean_innovation: np.ndarray  #: (3,) running mean of the innovations in standard deviations
    moved: np.ndarray  #: (K, 3) a fading window: move of eta, its variance, how long it has been open [s]
    memory: np.ndarray  #: scalars


@kernel
def _place_points(state, k, rules):
    """Draw the sigma points of component ``k`` and set its copies; returns the repairs."""
    points, mean = state.points[k], state.means[k]
    L = mean.shape[0]
    C = 3 + 2 * rules.states.shape[0]
    factor = np.empty((L, L))
    repairs = guarded_cholesky(state.covs[k], factor)
    points[:] = mean
    for j in range(L):
        for i in range(j, L):
            points[1 + 2 * j, i] += rules.spread * factor[i, j]
            points[2 + 2 * j, i] -= rules.spread * factor[i, j]
    for p in range(C):
        x = state.copies[k * C + p]
        x[:] = state.shared
        for s in range(rules.states.shape[0]):
            x[rules.states[s]] = points[p, 1 + s]
        state.exponents[k * C + p] = to_range(points[p, 0], rules.low, rules.high)
    return repairs


@kernel
def _before(state, navigation, sensors, command, vehicle, rules):
    """Navigate and place the sigma points; false while the filter rests.

    ``vehicle`` = (l_f, l_r, steer_lag, torque_lag).
    """
    nav, P, noise = navigation
    shared, memory = state.shared, state.memory
    navigate((nav, P), sensors, command[0], (vehicle[0], vehicle[1]), noise, rules.dt)
    memory[SAMPLES] += 1.0
    slow = not (nav[V] > rules.hold_speed and np.isfinite(sensors[0]).all())
    if slow or memory[AWAKE] < 0.5:
        memory[AWAKE], memory[HELD] = 0.0, 1.0
        for k in range(int(memory[ALIVE])):
            state.covs[k, 0, 0] += rules.Q[0]
        turn, share = rules.dt / max(vehicle[2], rules.dt), rules.dt / max(vehicle[3], rules.dt)
        shared[at.STEER] += turn * (command[0] - shared[at.STEER])
        shared[at.DRIVE] += share * (command[1] - shared[at.DRIVE])
        if math.isfinite(command[2]):  # the paper's model has no brake
            shared[at.BRAKE] += share * (command[2] - shared[at.BRAKE])
        return False
    shared[at.X], shared[at.Y], shared[at.YAW] = nav[X], nav[Y], nav[YAW]
    for k in range(int(memory[ALIVE])):
        memory[REPAIRS] += _place_points(state, k, rules)
    return True


@kernel
def _collect_points(state, k, rules, readings):
    """Points of component ``k`` after the step, in place, and what each had read before it (2 L + 1, 3)."""
    points = state.points[k]
    motion = rules.states.shape[0]
    C, push = 3 + 2 * motion, 1 + motion
    for p in range(points.shape[0]):
        own = k * C + (p if p < C else 0)
        for j in range(3):
            readings[p, j] = state.predicted[own, _USED[j]]
        for s in range(motion):
            points[p, 1 + s] = state.copies[own, rules.states[s]]
        # A push acts on the accelerometer and the speed of its axis, and fades.
        for axis in range(_PUSHES):
            readings[p, axis] += points[p, push + axis]
            points[p, 1 + axis] += points[p, push + axis] * rules.dt
            points[p, push + axis] *= rules.fade


@kernel
def _mean_of(values, side, mean):
    """Mean of sigma points (2 L + 1, k) into ``mean`` (k,); ``side`` is the weight of all but the centre."""
    for j in range(mean.shape[0]):
        total = 0.0
        for p in range(1, values.shape[0]):
            total += values[p, j] - values[0, j]
        mean[j] = values[0, j] + side * total


@kernel
def _covariance(a, b, side, out):
    """Covariance of points ``a`` with ``b`` into ``out``, about the centre's image.

    Never less than about the mean, and positive whatever the weight of the centre.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            total = 0.0
            for p in range(1, a.shape[0]):
                total += (a[p, i] - a[0, i]) * (b[p, j] - b[0, j])
            out[i, j] = side * total


@kernel
def _learn(state, k, rules, innovation):
    """Take component ``k`` on with the last sample of the inertial unit.

    Returns (log likelihood, nis, repairs); ``innovation`` (3,) is filled, in standard deviations.
    """
    mean, cov, points = state.means[k], state.covs[k], state.points[k]
    L, side = mean.shape[0], 0.5 / (rules.spread * rules.spread)
    readings, expected = np.empty((points.shape[0], 3)), np.empty(3)
    across, S, factor = np.empty((L, 3)), np.empty((3, 3)), np.empty((3, 3))
    _collect_points(state, k, rules, readings)
    _mean_of(points, side, mean)
    _mean_of(readings, side, expected)
    _covariance(points, points, side, cov)
    _covariance(points, readings, side, across)
    _covariance(readings, readings, side, S)
    for i in range(L):
        cov[i, i] += rules.Q[i]
    e = state.last - expected
    for j in range(3):
        S[j, j] += rules.R[j]
        innovation[j] = e[j] / math.sqrt(S[j, j])
    repairs = guarded_cholesky(S, factor)
    A = np.linalg.solve(factor, across.T.copy())
    e = np.linalg.solve(factor, e)
    shift = A.T @ e
    mean += shift
    cov -= A.T @ A
    _remember(state.moved[k], shift[0], A[:, 0] @ A[:, 0], rules)
    nis = e @ e
    log_density = -1.5 * _LOG_2PI - 0.5 * nis
    for j in range(3):
        log_density -= math.log(factor[j, j])
    return log_density, nis, repairs


@kernel
def _remember(moved, shift, variance, rules):
    """Take an update of eta and the variance that it was expected to have into the fading window."""
    kept = 1.0 - rules.dt / rules.change[0]
    moved[0] = kept * moved[0] + shift
    moved[1] = kept * kept * moved[1] + variance
    moved[2] += rules.dt


@kernel
def _notice(state, rules):
    """Where eta moves more than the samples may teach n has changed: widen the belief by as much.

    The updates of a filter that is right are white, and each has the variance that the belief loses
    by it. With P the variance of eta, m the window's move and V its variance, P m / V is the change
    that explains the window best.
    """
    memory = state.memory
    memory[UNSETTLED] = max(memory[UNSETTLED] - rules.dt, 0.0)
    time, level, settle_time = rules.change
    for k in range(int(memory[ALIVE])):
        moved, variance = state.moved[k], state.covs[k, 0, 0]
        if moved[2] > time and moved[0] * moved[0] > level * level * moved[1]:
            wider = variance + (variance * moved[0] / moved[1]) ** 2
            added = max(min(wider, _WIDEST) - variance, 0.0)
            # What was inferred from the old n is wrong by as much as hangs on it.
            along = state.covs[k, 0] / variance
            state.covs[k] += added * np.outer(along, along)
            moved[:] = 0.0
            memory[UNSETTLED] = settle_time
            memory[CHANGES] += 1.0


@kernel
def _fix(mean, cov, axis, speed, variance):
    """Measured speed along (0) or across (1), in place; returns the log likelihood."""
    gain = cov[1 + axis].copy()
    total, residual = variance + gain[1 + axis], speed - mean[1 + axis]
    for i in range(mean.shape[0]):
        mean[i] += gain[i] * residual / total
        for j in range(mean.shape[0]):
            cov[i, j] -= gain[i] * gain[j] / total
    return -0.5 * (residual * residual / total + math.log(total) + _LOG_2PI)


@kernel
def _after(state, nav, gnss, rules):
    """Learn from the last sample of the inertial unit and from a fix; weigh the components, watch."""
    memory, log_weights = state.memory, state.log_weights
    alive = int(memory[ALIVE])
    C = 3 + 2 * rules.states.shape[0]
    state.shared[at.STEER :] = state.copies[0, at.STEER :]
    innovations = np.empty((alive, 3))
    best = 0
    for k in range(alive):
        density, nis, repairs = _learn(state, k, rules, innovations[k])
        memory[REPAIRS] += repairs
        if np.isfinite(gnss).all() and gnss[2] > rules.hold_speed:
            angle, v = gnss[3] - nav[YAW], gnss[2]
            density += _fix(state.means[k], state.covs[k], 0, v * math.cos(angle), rules.fix)
            heading = (_HEADING_SD * v) ** 2
            density += _fix(state.means[k], state.covs[k], 1, v * math.sin(angle), rules.fix + heading)
        log_weights[k] += density
        if k == 0 or log_weights[k] > log_weights[best]:
            best, memory[NIS] = k, nis
    top = log_weights[best]
    log_weights[:alive] -= top + math.log(np.exp(log_weights[:alive] - top).sum())
    share, total = rules.dt / _MEAN_TIME, 0.0
    for j in range(3):
        state.mean_innovation[j] += share * (innovations[best, j] - state.mean_innovation[j])
        total += state.mean_innovation[j] ** 2
    # A mean of white noise that forgets exponentially has share / 2 of the variance of a sample.
    memory[SURPRISE], memory[HELD] = total * 2.0 / share, 0.0
    if alive > 1 and int(memory[SAMPLES]) % _TIDY == 0:
        _tidy(state, C, rules)
    if int(memory[ALIVE]) == 1:
        _notice(state, rules)


@kernel
def _tidy(state, C, rules):
    """Drop components without weight, merge neighbours that have met."""
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
                _absorb(state, a, b)
                _remove(state, b, C)
            else:
                b += 1
        a += 1


@kernel
def _absorb(state, a, b):
    """Give component ``a`` mean, covariance and weight of the pair."""
    w_a, w_b = math.exp(state.log_weights[a]), math.exp(state.log_weights[b])
    share = w_b / (w_a + w_b)
    apart = state.means[b] - state.means[a]
    state.means[a] += share * apart
    state.covs[a] += share * (state.covs[b] - state.covs[a]) + share * (1.0 - share) * np.outer(apart, apart)
    state.log_weights[a] = math.log(w_a + w_b)
    state.moved[a] = 0.0


@kernel
def _remove(state, k, C):
    """Take component ``k`` out; the last one moves into its place."""
    last = int(state.memory[ALIVE]) - 1
    state.means[k], state.covs[k] = state.means[last], state.covs[last]
    state.moved[k] = state.moved[last]
    state.log_weights[k] = state.log_weights[last]
    state.copies[k * C : (k + 1) * C] = state.copies[last * C : (last + 1) * C]
    state.warms[k * C : (k + 1) * C] = state.warms[last * C : (last + 1) * C]
    state.memory[ALIVE] = last


@kernel
def _report(state, low, high):
    """(mean, sd) of n under the sum."""
    mean = square = total = 0.0
    for k in range(int(state.memory[ALIVE])):
        w = math.exp(state.log_weights[k])
        m, s = moments(state.means[k, 0], state.covs[k, 0, 0], low, high)
        total += w
        mean += w * m
        square += w * (s * s + m * m)
    mean, square = mean / total, square / total
    return mean, math.sqrt(max(square - mean * mean, 0.0))


class OnBoardFilter:
    """Estimate of the sinkage exponent with the vehicle's motion (an `estimators.protocol.Estimator`).

    Parameters
    ----------
    plant : Plant
        What the vehicle believes about itself and the ground: full or paper model, half-car or
        bicycle. Its soil's n is not used. A ground that is not known is `flat()`.
    n_range : (float, float)
        Bounds of n [-]; the reported mean stays inside.
    dt : float
        Time between samples [s].
    imu, gnss : ImuConfig, GnssConfig, optional
        Mounting and noise, as far as known.
    settings : OnBoardSettings, optional
    navigation : NavigationFilter, optional
        To be used and updated here, and by nobody else; default: one of its own.

    Raises
    ------
    InvalidParameter
        For a range, step or plant that the filter cannot work with.
    """

    def __init__(
        self,
        plant: Plant,
        n_range: tuple[float, float],
        *,
        dt: float = 0.01,
        imu: ImuConfig | None = None,
        gnss: GnssConfig | None = None,
        settings: OnBoardSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        low, high = checked_range(plant, n_range, dt)
        self.plant, self.n_range, self.dt = plant, (low, high), float(dt)
        self.settings = settings or OnBoardSettings()
        self.navigation = navigation or NavigationFilter(plant.vehicle)
        self._full = plant_model(plant) == "full"
        self._packed = pack(plant)
        vehicle = plant.vehicle
        self._vehicle = (vehicle.l_f, vehicle.l_r, vehicle.steer_lag, vehicle.torque_lag)
        imu, gnss = imu or ImuConfig(), gnss or GnssConfig()
        self._mount = imu.mount()
        self._rules, self._start = self._constants(imu, gnss)
        self._state = self._memory()
        self.reset(0.5 * (low + high), 0.25 * (high - low), Pose(0.0, 0.0, 0.0, 0.0))

    def _constants(self, imu: ImuConfig, gnss: GnssConfig) -> tuple[_Rules, np.ndarray]:
        """The kernels' view of the settings, and the variances (L - 1,) of the start."""
        s, (low, high) = self.settings, self.n_range
        heave, spin = self.plant.half_car > 0.5, self._full
        states = _MOTION + (_HEAVE if heave else ()) + (_SPIN if spin else ())
        noise_of = [0, 1, 2] + [3, 4, 5, 6] * heave + [7, 7] * spin
        margin, fade = _MARGIN * (high - low), math.exp(-self.dt / s.push_time)
        walk, push = np.square(np.array(s.walk)[noise_of]) * self.dt, np.square(s.push)
        rules = _Rules(
            low=max(low - margin, 0.5 * low),
            high=high + margin,
            states=np.array(states),
            Q=np.concatenate([[s.drift**2 * self.dt], walk, push * (1.0 - fade * fade)]),
            R=np.square([imu.accel_noise, imu.accel_noise, imu.gyro_noise]),
            fix=gnss.velocity_sd**2,
            fade=fade,
            spread=float(s.spread),
            hold_speed=float(s.hold_speed),
            log_drop=math.log(s.drop),
            change=(float(s.change_time), float(s.change_level), float(s.change_settle)),
            dt=self.dt,
        )
        return rules, np.concatenate([np.square(np.array(s.start)[noise_of]), push])

    def _memory(self) -> _State:
        K, S = self.settings.components, len(self._rules.states)
        L, C = 1 + S + _PUSHES, 3 + 2 * S
        return _State(
            means=np.zeros((K, L)),
            covs=np.zeros((K, L, L)),
            log_weights=np.zeros(K),
            points=np.zeros((K, 2 * L + 1, L)),
            copies=np.zeros((K * C, at.STATE_SIZE)),
            warms=np.zeros((K * C, 2, at.CONTACT_SIZE)),
            exponents=np.zeros(K * C),
            predicted=np.zeros((K * C, 5)),
            shared=np.zeros(at.STATE_SIZE),
            last=np.zeros(3),
            mean_innovation=np.zeros(3),
            moved=np.zeros((K, 3)),
            memory=np.zeros(_MEMORY),
        )

    def reset(self, n_prior: float, sd: float, pose: Pose) -> Estimate:
        """Start at a known pose.

        Parameters
        ----------
        n_prior, sd : float
            Mean and standard deviation of the prior for n [-]; the mean lies inside ``n_range``.
        pose : Pose
            Position, heading and speed.

        Returns
        -------
        Estimate
            The prior.
        """
        low, high = self.n_range
        if not low <= n_prior <= high:
            raise InvalidParameter(f"n_prior must be in n_range = [{low}, {high}], got {n_prior}")
        state, K = self._state, self.settings.components
        for array in state:
            array[:] = 0.0
        eta, variance = belief_of(n_prior, sd, self._rules.low, self._rules.high)
        # Side by side, each as wide as its share of the way: the sum has the prior's mean and variance.
        places, width = (2.0 * np.arange(K) + 1.0 - K) / K, 1.0 / K
        scale = math.sqrt(variance / (np.mean(np.square(places)) + width * width))
        state.means[:, 0], state.covs[:, 0, 0] = eta + scale * places, (scale * width) ** 2
        state.log_weights[:] = -math.log(K)
        state.memory[ALIVE], state.memory[NIS], state.memory[HELD] = K, math.nan, 1.0
        self.navigation.reset(*pose)
        return self.estimate

    def update(
        self,
        command: tuple[float, float, float],
        imu: np.ndarray,
        rim_speeds: np.ndarray,
        gnss: np.ndarray,
    ) -> Estimate:
        """Take in one sample of every sensor; call once per ``dt``.

        Parameters
        ----------
        command : (float, float, float)
            What was commanded since the last sample: steering [rad], drive and brake torque [N m];
            with the paper's model steering and body force [N] (the third number is not used).
        imu : array (5,)
            a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s].
        rim_speeds : array (2,)
            r omega front, rear [m/s]; NaN when not measured.
        gnss : array (4,)
            X, Y [m], speed [m/s], course [rad]; NaN when not measured.

        Returns
        -------
        Estimate
        """
        navigation, state, rules = self.navigation, self._state, self._rules
        place = (navigation.x, navigation.P, navigation.constants)
        if _before(state, place, (imu, rim_speeds, gnss), command, self._vehicle, rules):
            stepped = int(state.memory[ALIVE]) * (3 + 2 * len(rules.states))
            copies, warms, predicted = (
                array[:stepped] for array in (state.copies, state.warms, state.predicted)
            )
            step = step_full_copies if self._full else step_paper_copies
            n = state.exponents[:stepped]
            status = step(copies, warms, self._packed, n, command, self.dt, self._mount, predicted)
            if status < SUNK and np.isfinite(predicted).all() and np.isfinite(copies).all():
                _after(state, navigation.x, gnss, rules)
            else:
                self._sleep()
        elif navigation.x[V] > rules.hold_speed and np.isfinite(imu).all():
            self._wake()
        state.last[:] = imu[_USED]
        return self.estimate

    def _wake(self) -> None:
        """Settle every component on its own soil, rolling at the navigation filter's speed."""
        state, rules, nav = self._state, self._rules, self.navigation.x
        pose, states = (nav[X], nav[Y], nav[YAW]), self._rules.states
        C, motion = 3 + 2 * len(states), slice(1, 1 + len(states))
        for k in range(int(state.memory[ALIVE])):
            eta, variance = state.means[k, 0], state.covs[k, 0, 0]
            beside, sides = rules.spread * math.sqrt(variance), np.empty((3, at.STATE_SIZE))
            for i, step in enumerate((0.0, beside, -beside)):
                own = plant_with_exponent(self.plant, to_range(eta + step, rules.low, rules.high))
                status, sides[i], warm = settle(own, pose, nav[V])
                if status >= SUNK or not np.isfinite(sides[i]).all():
                    state.memory[SURPRISE] = math.inf
                    return
                state.warms[k * C + i] = warm
            state.warms[k * C + 3 : (k + 1) * C] = state.warms[k * C]
            # The settled start is linearised in eta: a vehicle on softer soil stands deeper.
            slope = np.zeros(len(state.means[k]))
            slope[0], slope[motion] = 1.0, (sides[1] - sides[2])[states] / (2.0 * beside)
            state.means[k, 1:], state.means[k, motion] = 0.0, sides[0, states]
            state.means[k, 2] = nav[V_SIDE]
            state.covs[k] = variance * np.outer(slope, slope)
            state.covs[k][np.arange(1, len(slope)), np.arange(1, len(slope))] += self._start
        state.memory[AWAKE], state.memory[SURPRISE] = 1.0, 0.0
        state.mean_innovation[:] = 0.0
        state.moved[:] = 0.0

    def _sleep(self) -> None:
        """Some copy found no contact: hold, not valid, and start all of them again at the next sample."""
        memory = self._state.memory
        memory[AWAKE], memory[HELD], memory[SURPRISE] = 0.0, 1.0, math.inf

    @property
    def estimate(self) -> Estimate:
        """The belief as it stands."""
        memory, (low, high) = self._state.memory, self.n_range
        mean, sd = _report(self._state, self._rules.low, self._rules.high)
        settled = math.isfinite(sd) and memory[UNSETTLED] <= 0.0
        return Estimate(
            mean=min(max(mean, low), high),
            sd=sd,
            nis=float(memory[NIS]),
            valid=bool(settled and memory[SURPRISE] < self.settings.surprise),
            repairs=int(memory[REPAIRS]),
        )

    @property
    def held(self) -> bool:
        """Whether the last sample taught nothing about n."""
        return bool(self._state.memory[HELD] > 0.5)

    @property
    def changes(self) -> int:
        """How many changes of n it has noticed since the reset."""
        return int(self._state.memory[CHANGES])

    @property
    def pose(self) -> Pose:
        """Of the navigation filter."""
        return self.navigation.pose
