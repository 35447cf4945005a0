"""State and soil in one belief, on board: a joint filter, or several of them, on any model of the vehicle.

The filter of `estimators.joint` believes in a map and in the paper's dynamics. On board neither is
given: the ground is what the sensors feel, and the drive is torque at wheels that slip. The belief
here holds what the soil acts on - speeds, heave and pitch, wheel spin - and eta, the sinkage
exponent on an unbounded scale. Place and heading come from the navigation filter; the actuators
follow the known command.

*Roughness is a state.* On ground that is believed to be level, the slopes that are really there
push the vehicle for tenths of a second, forward and to the side. That is no white noise: a filter
that took it for such would be too sure of n after a second. The two pushes are states of their own,
which wander and fade (`push`, `push_time`). They change speeds and accelerometers alike, which is
how they are told from sensor noise, and average out over time, which is how they are told from n.

*What the soil does not feel costs nothing.* In the order [soil, motion, pushes] the last columns of
the Cholesky factor change pushes only: their sigma points share the step of the centre.

*One step a sample.* A sigma point is read where it stands and then carried on, so the covariance of
that reading with the state one period later is at hand: every sample of the inertial unit is used
one period late, without a second evaluation of the wheels. Rim speeds and satellite fixes are
linear in the state and are used at once.

With more than one component the belief is a Gaussian sum over n (see `estimators.bank`): each
component is narrow, weights follow from how well each predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.models import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.navigation import V_SIDE, YAW, NavigationFilter, V, X, Y
from estimators.protocol import Estimate, Pose
from estimators.transforms import belief_of, moments, to_range
from estimators.ukf_compiled import guarded_cholesky
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.physics.settle import settle
from offroad_env.sensors import GnssConfig, ImuConfig, WheelSpeedConfig
from offroad_env.simulator import Plant, plant_model

__all__ = ["OnBoardFilter", "OnBoardSettings"]

#: The belief: eta, then the states that the soil acts on, then the pushes along and across.
_MOTION = {
    "half_car": (at.V_X, at.V_Y, at.YAW_RATE, at.Z, at.PITCH, at.V_Z, at.PITCH_RATE),
    "bicycle": (at.V_X, at.V_Y, at.YAW_RATE),
}
_SPIN = (at.OMEGA_F, at.OMEGA_R)
_PUSHES = 2
#: Channels of the inertial unit that are used; vertical ones only where the vehicle can heave.
_HORIZONTAL, _ALL = np.array([0, 1, 4]), np.array([0, 1, 2, 3, 4])
_LOG_2PI = math.log(2.0 * math.pi)
#: The filter's range is wider than the user's by this share on both sides: a bound is endlessly far
#: away on the scale of eta, so a soil close to one would be approached too slowly.
_MARGIN = 0.15
#: Where a state's noise stands in `OnBoardSettings.walk` and ``start``.
_NOISE_OF = {state: i for i, state in enumerate(_MOTION["half_car"])} | dict.fromkeys(_SPIN, 7)
#: Half the step of the difference that ties the settled start to eta.
_START_STEP = 0.05
#: Time over which innovations are averaged for the validity flag [s].
_MEAN_TIME = 2.0
#: Samples between two looks at which components to drop.
_TIDY = 10
#: Neighbours are merged once their squared distance in eta falls below this share of their variances.
_MEET = 0.5
#: How well the navigation filter knows the heading, for the side speed in a satellite's course [rad].
_HEADING_SD = 0.02


@dataclass(frozen=True, kw_only=True)
class OnBoardSettings:
    """What can be chosen; each value has its reason here."""

    components: int = 1  #: 1 = a joint filter; more = a bank of them over n
    spread: float = 1.7  #: distance of the sigma points in standard deviations; 3 moments right at 1.73
    drift: float = 0.03  #: random walk of eta [1/sqrt(s)]: about 0.007 of n per sqrt(s)
    push: tuple[float, float] = (0.15, 0.3)  #: standard deviation of the pushes along, across [m/s^2]
    push_time: float = 0.3  #: how long a push lasts: a metre or two of ground [s]
    #: Random walks of v_x, v_y [m/s/sqrt(s)], yaw rate [rad/s/sqrt(s)]; z [m/sqrt(s)], pitch
    #: [rad/sqrt(s)], v_z [m/s/sqrt(s)], pitch rate [rad/s/sqrt(s)]; spin of the wheels [rad/s/sqrt(s)].
    #: Heave and pitch are those of a class B road (ISO 8608) at 5 m/s under springs and dampers.
    walk: tuple[float, ...] = (0.02, 0.03, 0.06, 6e-3, 4e-3, 0.08, 0.12, 0.3)
    #: What the damper makes of roughness in a_z [m/s^2] and in the pitch rate [rad/s].
    shake: tuple[float, float] = (1.0, 0.03)
    #: Start: standard deviation of v_x, v_y, yaw rate, z, pitch, v_z, pitch rate, spin, as in `walk`.
    start: tuple[float, ...] = (0.2, 0.1, 0.03, 0.01, 0.01, 0.05, 0.05, 1.0)
    hold_speed: float = 1.0  #: below this the filter rests and the estimate holds [m/s]
    surprise: float = 25.0  #: largest chi-square (3 channels) of the mean innovation for a valid estimate
    drop: float = 1e-4  #: weight below which a component is dropped

    def __post_init__(self) -> None:
        if not 1 <= self.components <= 20:
            raise InvalidParameter(f"components must be in [1, 20], got {self.components}")
        for name in ("spread", "drift", "push_time", "hold_speed", "surprise", "drop"):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")
        for name, count in (("push", 2), ("walk", 8), ("shake", 2), ("start", 8)):
            values = getattr(self, name)
            if len(values) != count or not all(value > 0.0 for value in values):
                raise InvalidParameter(f"{name} must be {count} numbers > 0, got {values}")


class _Rules(NamedTuple):
    """What the kernels need besides the belief."""

    low: float  #: bounds of n [-]
    high: float
    states: np.ndarray  #: (S,) where the motion stands in the vehicle's state
    channels: np.ndarray  #: (m,) of the inertial unit
    Q: np.ndarray  #: (L,) variances of the process noise a step
    R: np.ndarray  #: (m,) variances of the inertial unit and of what shakes it
    fade: float  #: what is left of a push after a step [-]
    spread: float  #: of the sigma points [standard deviations]
    dt: float  #: [s]


class _Component(NamedTuple):
    """One Gaussian of the belief and its sigma points."""

    mean: np.ndarray  #: (L,)
    cov: np.ndarray  #: (L, L)
    points: np.ndarray  #: (2 L + 1, L)
    copies: np.ndarray  #: (C, 15) vehicle states of the points that the soil feels
    warms: np.ndarray  #: (C, 2, 3)
    exponents: np.ndarray  #: (C,)
    predicted: np.ndarray  #: (C, 5) readings


@kernel
def _place_points(component, shared, rules):
    """Draw the sigma points and set the copies; returns the repairs.

    ``shared`` (15,) : place, heading and actuators, which all copies have in common.
    """
    mean, cov, points, copies, _, exponents, _ = component
    L = mean.shape[0]
    felt = 1 + rules.states.shape[0]
    factor = np.empty((L, L))
    repairs = guarded_cholesky(cov, factor)
    points[:] = mean
    for j in range(L):
        for i in range(j, L):
            points[1 + 2 * j, i] += rules.spread * factor[i, j]
            points[2 + 2 * j, i] -= rules.spread * factor[i, j]
    for p in range(1 + 2 * felt):
        copies[p] = shared
        exponents[p] = to_range(points[p, 0], rules.low, rules.high)
        for s in range(rules.states.shape[0]):
            copies[p, rules.states[s]] = points[p, 1 + s]
    return repairs


@kernel
def _collect_points(component, rules, readings):
    """The points after the step, in place, and what each predicted to read (2 L + 1, m)."""
    _, _, points, copies, _, _, predicted = component
    motion = rules.states.shape[0]
    felt, along = 1 + motion, 1 + motion
    for p in range(points.shape[0]):
        own = p if p < 1 + 2 * felt else 0
        for j in range(rules.channels.shape[0]):
            readings[p, j] = predicted[own, rules.channels[j]]
        readings[p, 0] += points[p, along]
        readings[p, 1] += points[p, along + 1]
        for s in range(motion):
            points[p, 1 + s] = copies[own, rules.states[s]]
        # The first two states of the motion are v_x and v_y.
        for axis in range(2):
            points[p, 1 + axis] += points[p, along + axis] * rules.dt
            points[p, along + axis] *= rules.fade


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
def _learn(component, z, rules):
    """Take the points on, then the reading ``z`` (m,) that belongs to where they stood.

    Returns (log likelihood, nis, repairs, innovation (m,), its variances (m,)).
    """
    mean, cov, points, _, _, _, _ = component
    L, m, count = mean.shape[0], z.shape[0], points.shape[0]
    readings, expected = np.empty((count, m)), np.empty(m)
    across, S = np.empty((L, m)), np.empty((m, m))
    _collect_points(component, rules, readings)
    side = 0.5 / (rules.spread * rules.spread)
    _mean_of(points, side, mean)
    _mean_of(readings, side, expected)
    _covariance(points, points, side, cov)
    _covariance(points, readings, side, across)
    _covariance(readings, readings, side, S)
    for i in range(L):
        cov[i, i] += rules.Q[i]
    innovation, variances = z - expected, np.empty(m)
    for j in range(m):
        S[j, j] += rules.R[j]
        variances[j] = S[j, j]
    factor = np.empty((m, m))
    repairs = guarded_cholesky(S, factor)
    A = np.linalg.solve(factor, across.T.copy())
    e = np.linalg.solve(factor, innovation)
    mean += A.T @ e
    cov -= A.T @ A
    nis = e @ e
    log_likelihood = -0.5 * nis - 0.5 * m * _LOG_2PI
    for j in range(m):
        log_likelihood -= math.log(factor[j, j])
    return log_likelihood, nis, repairs, innovation, variances


@kernel
def _correct(mean, cov, row, residual, variance):
    """Scalar Kalman update with measurement row (L,), in place; returns the log likelihood."""
    gain = cov @ row
    total = variance + row @ gain
    mean += gain * (residual / total)
    for i in range(mean.shape[0]):
        for j in range(i + 1):
            cov[i, j] -= gain[i] * gain[j] / total
            cov[j, i] = cov[i, j]
    return -0.5 * (residual * residual / total + math.log(total) + _LOG_2PI)


@kernel
def _fix(component, speeds, rims, noise, radius):
    """Speed along and across by satellite, rim speeds; NaN where nothing was measured.

    ``speeds`` = (along, across) [m/s], ``rims`` (2,) [m/s], ``noise`` = variances (along, across,
    rim). Returns the log likelihood.
    """
    mean, cov = component[0], component[1]
    L = mean.shape[0]
    total = 0.0
    for axis in range(2):
        if math.isfinite(speeds[axis]):
            row = np.zeros(L)
            row[1 + axis] = 1.0
            total += _correct(mean, cov, row, speeds[axis] - mean[1 + axis], noise[axis])
    for axle in range(2):
        if radius > 0.0 and math.isfinite(rims[axle]):
            row = np.zeros(L)
            spin = L - _PUSHES - 2 + axle
            row[spin] = radius
            total += _correct(mean, cov, row, rims[axle] - radius * mean[spin], noise[2])
    return total


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
    sensors : (ImuConfig, WheelSpeedConfig, GnssConfig), optional
        What is known of mounting and noise.
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
        sensors: tuple[ImuConfig, WheelSpeedConfig, GnssConfig] | None = None,
        settings: OnBoardSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        low, high = float(n_range[0]), float(n_range[1])
        if not 0.05 < low < high <= 2.5:
            raise InvalidParameter(f"n_range must be 0.05 < low < high <= 2.5, got {n_range}")
        if plant.soil.rigid > 0.5:
            raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
        if not 0.001 <= dt <= 0.02:
            raise InvalidParameter(f"dt must be in [0.001, 0.02] s, got {dt} - in ms?")
        self.plant, self.n_range, self.dt = plant, (low, high), float(dt)
        self.settings = settings or OnBoardSettings()
        self.navigation = navigation or NavigationFilter(plant.vehicle)
        self._full = plant_model(plant) == "full"
        self._packed = pack(plant)
        margin = _MARGIN * (high - low)
        self._bounds = (max(low - margin, 0.5 * low), high + margin)
        imu, wheel, gnss = sensors or (ImuConfig(), WheelSpeedConfig(), GnssConfig())
        self._mount = imu.mount()
        self._rules, self._start = self._constants(imu)
        self._sensed = (gnss.velocity_sd, wheel.noise, wheel.scale_sd)
        self._shared = np.zeros(at.STATE_SIZE)
        self.reset(0.5 * (low + high), 0.25 * (high - low), Pose(0.0, 0.0, 0.0, 0.0))

    def _constants(self, imu: ImuConfig) -> tuple[_Rules, np.ndarray]:
        s, half_car = self.settings, self.plant.half_car > 0.5
        motion = _MOTION["half_car" if half_car else "bicycle"] + (_SPIN if self._full else ())
        wanted = [_NOISE_OF[state] for state in motion]
        fade = math.exp(-self.dt / s.push_time)
        pushes = np.square(s.push) * (1.0 - fade * fade)
        walk = np.square(np.array(s.walk)[wanted]) * self.dt
        noise = np.square([imu.accel_noise] * 3 + [imu.gyro_noise] * 2)
        noise[2:4] += np.square(s.shake)
        channels = _ALL if half_car else _HORIZONTAL
        rules = _Rules(
            *self._bounds,
            states=np.array(motion),
            channels=channels,
            Q=np.concatenate([[s.drift**2 * self.dt], walk, pushes]),
            R=noise[channels],
            fade=fade,
            spread=float(s.spread),
            dt=self.dt,
        )
        return rules, np.concatenate([np.square(np.array(s.start)[wanted]), np.square(s.push)])

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
        eta, variance = belief_of(n_prior, sd, *self._bounds)
        K = self.settings.components
        # Quantiles of the prior, each component as wide as its share: the sum has the prior's moments.
        places = (2.0 * np.arange(K) + 1.0 - K) / max(K, 1)
        width = 1.0 / K
        scale = math.sqrt(variance / (np.mean(np.square(places)) + width * width))
        self._etas, self._variances = eta + scale * places, np.full(K, (scale * width) ** 2)
        self._log_weights = np.full(K, -math.log(K))
        self._components: list[_Component] = []
        self._held = True
        self._nis, self._repairs, self._surprise = math.nan, 0, 0.0
        self._samples = 0
        self._last, self._mean_innovation = np.full(5, math.nan), np.zeros(3)
        self._shared[:] = 0.0
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
        self.navigation.update(imu, rim_speeds, command[0], gnss, self.dt)
        self._samples += 1
        if not (self.navigation.x[V] > self.settings.hold_speed and np.isfinite(imu).all()):
            self._rest(command)
        elif not self._components:
            self._wake()
        elif not self._step(command):
            self._rest(command)
            self._surprise = math.inf
        else:
            self._fix(rim_speeds, gnss)
            self._weigh()
        self._last[:] = imu
        return self.estimate

    def _rest(self, command: tuple[float, float, float]) -> None:
        """Hold, let the belief drift and the actuators follow the command."""
        if self._components:
            self._etas = np.array([component.mean[0] for component in self._components])
            self._variances = np.array([component.cov[0, 0] for component in self._components])
            self._components = []
        self._held = True
        self._variances = self._variances + self.settings.drift**2 * self.dt
        vehicle = self.plant.vehicle
        lags = (vehicle.steer_lag, vehicle.torque_lag, vehicle.torque_lag)
        for state, lag, value in zip((at.STEER, at.DRIVE, at.BRAKE), lags, command, strict=True):
            if math.isfinite(value):
                self._shared[state] += self.dt / max(lag, self.dt) * (value - self._shared[state])

    def _wake(self) -> None:
        """Settle every component on its own soil, rolling at the navigation filter's speed."""
        nav = self.navigation.x
        pose = (nav[X], nav[Y], nav[YAW])
        components, surprise = [], 0.0
        for eta, variance in zip(self._etas, self._variances, strict=True):
            sides = []
            for step in (0.0, -_START_STEP, _START_STEP):
                n = to_range(eta + step, *self._bounds)
                status, x, warm = settle(plant_with_exponent(self.plant, n), pose, nav[V], self._full)
                x[at.V_Y] = nav[V_SIDE]
                surprise = math.inf if status >= SUNK or not np.isfinite(x).all() else surprise
                sides.append((x, warm))
            components.append(self._component(eta, variance, sides))
        self._surprise = surprise
        if surprise == 0.0:
            self._components = components
            self._mean_innovation[:] = 0.0

    def _component(self, eta: float, variance: float, sides: list) -> _Component:
        """A Gaussian about the settled start, which is linearised in eta: a deeper rut goes with softer soil."""
        states = self._rules.states
        (x, warm), (before, _), (after, _) = sides
        L = 1 + len(states) + _PUSHES
        count = 3 + 2 * len(states)
        slope = np.zeros(L)
        slope[0] = 1.0
        slope[1 : 1 + len(states)] = (after - before)[states] / (2.0 * _START_STEP)
        cov = variance * np.outer(slope, slope)
        cov[np.arange(1, L), np.arange(1, L)] += self._start
        return _Component(
            mean=np.concatenate([[eta], x[states], np.zeros(_PUSHES)]),
            cov=cov,
            points=np.zeros((2 * L + 1, L)),
            copies=np.zeros((count, at.STATE_SIZE)),
            warms=np.tile(warm, (count, 1, 1)),
            exponents=np.zeros(count),
            predicted=np.zeros((count, 5)),
        )

    def _step(self, command: tuple[float, float, float]) -> bool:
        """Carry every component to this sample and use the last one of the inertial unit; false on failure."""
        nav, rules = self.navigation.x, self._rules
        self._shared[:3] = nav[X], nav[Y], nav[YAW]
        step = step_full_copies if self._full else step_paper_copies
        z = self._last[rules.channels]
        innovations = []
        for k, component in enumerate(self._components):
            self._repairs += _place_points(component, self._shared, rules)
            copies, warms, n, predicted = component[3:]
            status = step(copies, warms, self._packed, n, command, self.dt, self._mount, predicted)
            if not (status < SUNK and np.isfinite(copies).all() and np.isfinite(predicted).all()):
                return False
            likelihood, nis, repairs, *innovation = _learn(component, z, rules)
            self._repairs += repairs
            self._log_weights[k] += likelihood
            innovations.append((nis, innovation))
        self._shared[at.STEER :] = self._components[0].copies[0, at.STEER :]
        best = int(np.argmax(self._log_weights))
        self._nis, self._held = float(innovations[best][0]), False
        self._watch(*innovations[best][1])
        return True

    def _watch(self, innovation: np.ndarray, variances: np.ndarray) -> None:
        """Chi-square of the running mean of a_x, a_y and yaw rate: white innovations average out."""
        index = [0, 1, -1]
        share = self.dt / _MEAN_TIME
        relative = innovation[index] / np.sqrt(variances[index])
        self._mean_innovation += share * (relative - self._mean_innovation)
        self._surprise = float(self._mean_innovation @ self._mean_innovation) * 2.0 / share

    def _fix(self, rim_speeds: np.ndarray, gnss: np.ndarray) -> None:
        """Rim speeds and a satellite fix, which are linear in the state."""
        velocity_sd, rim_noise, rim_scale = self._sensed
        speed = float(gnss[2])
        angle = float(gnss[3]) - self.navigation.x[YAW] if speed > self.settings.hold_speed else math.nan
        speeds = (speed * math.cos(angle), speed * math.sin(angle))
        rolling = abs(float(self.navigation.x[V]))
        noise = (
            velocity_sd**2,
            velocity_sd**2 + (_HEADING_SD * rolling) ** 2,
            rim_noise**2 + (rim_scale * rolling) ** 2,
        )
        radius = self.plant.vehicle.r if self._full else 0.0
        for k, component in enumerate(self._components):
            self._log_weights[k] += _fix(component, speeds, rim_speeds, noise, radius)

    def _weigh(self) -> None:
        """Scale the weights to a sum of 1; drop components that carry none, merge such as have met."""
        top = self._log_weights.max()
        self._log_weights -= top + math.log(np.exp(self._log_weights - top).sum())
        if len(self._components) == 1 or self._samples % _TIDY:
            return
        keep = np.flatnonzero(self._log_weights > math.log(self.settings.drop))
        self._components = [self._components[k] for k in keep]
        self._log_weights = self._log_weights[keep]
        order = np.argsort([component.mean[0] for component in self._components])
        for a, b in zip(order[:-1], order[1:], strict=True):
            one, other = self._components[a], self._components[b]
            gap = other.mean[0] - one.mean[0]
            if gap * gap < _MEET * (one.cov[0, 0] + other.cov[0, 0]):
                self._absorb(int(a), int(b))
                return

    def _absorb(self, a: int, b: int) -> None:
        """Merge component ``a`` into ``b`` with mean and covariance of the pair kept."""
        one, other = self._components[a], self._components[b]
        weights = np.exp(self._log_weights[[a, b]])
        share = weights[0] / weights.sum()
        apart = one.mean - other.mean
        other.cov[:] = (
            (1.0 - share) * other.cov + share * one.cov + share * (1.0 - share) * np.outer(apart, apart)
        )
        other.mean[:] += share * apart
        self._log_weights[b] = math.log(weights.sum())
        self._components.pop(a)
        self._log_weights = np.delete(self._log_weights, a)

    @property
    def estimate(self) -> Estimate:
        """The belief as it stands."""
        if self._components:
            beliefs = [(component.mean[0], component.cov[0, 0]) for component in self._components]
        else:
            beliefs = list(zip(self._etas, self._variances, strict=True))
        found = np.array([moments(eta, variance, *self._bounds) for eta, variance in beliefs])
        weights = np.exp(self._log_weights)
        mean = float(weights @ found[:, 0])
        sd = math.sqrt(max(float(weights @ np.square(found).sum(axis=1)) - mean * mean, 0.0))
        return Estimate(
            mean=min(max(mean, self.n_range[0]), self.n_range[1]),
            sd=sd,
            nis=self._nis,
            valid=bool(math.isfinite(sd) and self._surprise < self.settings.surprise),
            repairs=self._repairs,
        )

    @property
    def held(self) -> bool:
        """Whether the last sample taught nothing about n."""
        return self._held

    @property
    def pose(self) -> Pose:
        """Of the navigation filter."""
        return self.navigation.pose
