"""The estimator on board: the sinkage exponent from commands and sensors, nothing else.

Three copies of the vehicle's model run beside the vehicle, one for each sigma point of the belief
about n, all under the command that was given. What they predict for the inertial unit is compared
with what it says.

*What tells n.* The drive torque is known, the acceleration is measured, and in between stands the
resistance of the ground that is pressed down: T/r - F_x, some 0.1 to 0.3 of the weight, grows with
n. Cornering adds the dependence of the side forces. Each copy finds the slip that its own soil
needs for the torque, as the vehicle does; nothing may move its wheels to a measured speed, since a
slip that is wrong by 0.01 is a force that is wrong by 0.13 m/s^2.

*Why each sigma point has its own state.* Heave, slip and side slip follow n within tenths of a
second. Copies that start every step from one common state feel n only through the forces of that
instant, at a sinkage which belongs to another n: the sensitivity has the wrong size and at times
the wrong sign, and the filter confirms itself.

*Why the noise is larger than the sensors'.* Roughness that the belief does not know, the pull of
the navigation filter and the model's lag give errors that last tenths of a second. An error of
standard deviation s that lasts tau counts, for a filter that believes in white noise, as a
variance 2 s^2 tau/dt per sample. `EmbeddedSettings.error` holds s per channel.

*Why it learns no faster than it can follow.* A first second of hard braking would narrow the belief
tenfold while the copies still settle, at readings that belong to no soil. The share of the variance
that an update may remove is therefore bounded (`settle_time`), and below a smallest share nothing is
learnt at all (`least_information`): the estimate holds and its standard deviation grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.models import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.navigation import GYRO_BIAS, V_SIDE, YAW, NavigationFilter, V, X, Y, navigate
from estimators.protocol import Estimate, Pose
from estimators.transforms import belief_of, moments, to_range
from estimators.ukf_compiled import check_alpha, merwe_weights, sigma_points, unscented_update
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.packing import pack
from offroad_env.physics.settle import settle
from offroad_env.sensors import ImuConfig
from offroad_env.simulator import Plant, plant_model

__all__ = ["EmbeddedParameterUKF", "EmbeddedSettings"]

# Scalars in the filter's memory.
(NIS, REPAIRS, HELD, AWAKE, SURPRISE) = range(5)
_MEMORY = 5
#: Time over which innovations are averaged for the validity flag [s].
_MEAN_TIME = 2.0
#: The filter's range is wider than the user's by this share on both sides: a bound is endlessly far
#: away on the scale of eta, so a soil close to one would be approached too slowly.
_MARGIN = 0.15


@dataclass(frozen=True, kw_only=True)
class EmbeddedSettings:
    """What can be chosen; each value has its reason here."""

    alpha: float = 1.0  #: sigma points one standard deviation out: they must span the belief
    drift: float = 0.03  #: random walk of eta [1/sqrt(s)]: about 0.007 of n per sqrt(s)
    #: What the model leaves out, per channel (a_x, a_y, yaw_rate) [m/s^2, m/s^2, rad/s].
    error: tuple[float, float, float] = (0.15, 0.3, 0.03)
    error_time: float = 0.3  #: how long such an error lasts [s]
    settle_time: float = 0.5  #: time in which the copies follow their sigma points [s]
    position_gain: float = 5.0  #: pull of position and heading [1/s]: the ground is read in the right place
    speed_gain: float = 4.0  #: pull of forward speed [1/s]: follows in 0.25 s, smooths the fixes
    side_gain: float = 1.0  #: pull of side speed [1/s]: weak, since side slip tells about the soil
    yaw_rate_gain: float = 2.0  #: pull of yaw rate by the gyro [1/s]: weak, as above; stops a copy that spins
    pitch_rate_gain: float = 5.0  #: pull of pitch rate by the gyro [1/s]: roughness that the belief lacks
    hold_speed: float = 1.0  #: below this the copies rest and the estimate holds [m/s]
    least_information: float = 0.02  #: smallest share of the variance that a second must remove [1/s]
    surprise: float = 25.0  #: largest chi-square (3 channels) of the mean innovation for a valid estimate

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        for name in ("drift", "error_time", "settle_time", "hold_speed", "surprise"):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")


@kernel
def _rest(state, lags, command, dt):
    """Hold, and let the actuators of the sleeping copies follow the command.

    ``lags`` = (steer, torque) [s].
    """
    _, copies, _, _, memory, _ = state
    memory[AWAKE], memory[HELD] = 0.0, 1.0
    turn, share = dt / max(lags[0], dt), dt / max(lags[1], dt)
    for i in range(3):
        copies[i, at.STEER] += turn * (command[0] - copies[i, at.STEER])
        copies[i, at.DRIVE] += share * (command[1] - copies[i, at.DRIVE])
        copies[i, at.BRAKE] += share * (command[2] - copies[i, at.BRAKE])


@kernel
def _pull(x, nav, imu, gains, dt):
    """Draw a copy towards what is measured: constant gains, wheels and heave left free."""
    position, speed, side, yaw_rate, pitch_rate = gains
    x[at.X] += position * dt * (nav[X] - x[at.X])
    x[at.Y] += position * dt * (nav[Y] - x[at.Y])
    x[at.YAW] += position * dt * (nav[YAW] - x[at.YAW])
    x[at.V_X] += speed * dt * (nav[V] - x[at.V_X])
    x[at.V_Y] += side * dt * (nav[V_SIDE] - x[at.V_Y])
    x[at.YAW_RATE] += yaw_rate * dt * (imu[4] - nav[GYRO_BIAS] - x[at.YAW_RATE])
    x[at.PITCH_RATE] += pitch_rate * dt * (imu[3] - x[at.PITCH_RATE])


@kernel
def _watch(predicted, z, R, weights, mean_innovation, dt):
    """Chi-square of the innovations' running mean, whose variance is R dt/(2 time) and the belief's."""
    a_0_m, a_0_c, a_i, _ = weights
    total = 0.0
    for j in range(z.shape[0]):
        expected = a_0_m * predicted[0, j] + a_i * (predicted[1, j] + predicted[2, j])
        spread = a_0_c * (predicted[0, j] - expected) ** 2
        spread += a_i * ((predicted[1, j] - expected) ** 2 + (predicted[2, j] - expected) ** 2)
        mean_innovation[j] += dt / _MEAN_TIME * (z[j] - expected - mean_innovation[j])
        total += mean_innovation[j] ** 2 / (R[j, j] * dt / (2.0 * _MEAN_TIME) + spread)
    return total


@kernel
def _learn(belief, memory, points, predicted, z, R, weights, shares):
    """Unscented update that removes a share of the variance between ``shares``, or none."""
    least, most = shares
    mean, cov = belief[:1].copy(), belief[1:].copy().reshape(1, 1)
    nis, repairs = unscented_update(mean, cov, points, predicted, z, R, weights)
    memory[REPAIRS] += repairs
    removed = 1.0 - cov[0, 0] / belief[1]
    if removed > most:
        # With R times this factor the share removed is close to `most`.
        softer = R * (removed / (1.0 - removed) * (1.0 - most) / most)
        mean[0], cov[0, 0] = belief[0], belief[1]
        _, repairs = unscented_update(mean, cov, points, predicted, z, softer, weights)
        memory[REPAIRS] += repairs
    if removed > least and math.isfinite(mean[0]) and cov[0, 0] > 0.0:
        belief[0], belief[1] = mean[0], cov[0, 0]
        memory[NIS], memory[HELD] = nis, 0.0
    else:
        memory[HELD] = 1.0


@kernel
def _before(state, navigation, sensors, command, vehicle, setting, points):
    """Navigate, let the belief drift and place the sigma points; false while the copies rest.

    ``vehicle`` = (l_f, l_r, steer_lag, torque_lag); ``points`` = (eta (3, 1), n (3,)), filled.
    """
    belief, _, _, _, memory, _ = state
    nav, P, noise = navigation
    bounds, weights, _, _, gates, dt = setting
    navigate((nav, P), sensors, command[0], (vehicle[0], vehicle[1]), noise, dt)
    belief[1] += gates[3] * gates[3] * dt
    slow = not (nav[V] > gates[0] and np.isfinite(sensors[0]).all())
    if slow or memory[AWAKE] < 0.5:
        _rest(state, vehicle[2:], command, dt)
        return False
    factor = np.empty((1, 1))
    memory[REPAIRS] += sigma_points(belief[:1], belief[1:].reshape(1, 1), weights[3], factor, points[0])
    for i in range(3):
        points[1][i] = to_range(points[0][i, 0], bounds[0], bounds[1])
    return True


@kernel
def _after(state, nav, imu, points, predicted, setting):
    """Compare what the copies (3, 5) predicted with the sample that belongs to it, learn, pull.

    That sample is the previous one, taken at the state before the step: so a step yields its
    prediction without another force evaluation, and every sample is used one period late.
    """
    belief, copies, _, last, memory, mean_innovation = state
    _, weights, R, gains, gates, dt = setting
    channels = np.empty((3, 3))
    channels[:, 0], channels[:, 1], channels[:, 2] = predicted[:, 0], predicted[:, 1], predicted[:, 4]
    for i in range(3):
        _pull(copies[i], nav, imu, gains, dt)
    if math.isfinite(last[0]):
        shares = (gates[1] * dt, dt / gates[2])
        memory[SURPRISE] = _watch(channels, last, R, weights, mean_innovation, dt)
        _learn(belief, memory, points, channels, last, R, weights, shares)
    last[0], last[1], last[2] = imu[0], imu[1], imu[4]


class EmbeddedParameterUKF:
    """Estimate of the sinkage exponent from commands and sensors (an `estimators.protocol.Estimator`).

    Parameters
    ----------
    plant : Plant
        What the vehicle believes about itself and the ground: full or paper model, half-car or
        bicycle. Its soil's n is not used. A ground that is not known is `flat()`.
    n_range : (float, float)
        Bounds of n [-]; the reported mean stays inside.
    dt : float
        Time between samples [s].
    imu : ImuConfig, optional
        How the inertial unit is mounted, what it measures and how noisy it is, as far as known.
    settings : EmbeddedSettings, optional
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
        settings: EmbeddedSettings | None = None,
        navigation: NavigationFilter | None = None,
    ) -> None:
        low, high = float(n_range[0]), float(n_range[1])
        if not 0.05 < low < high <= 2.5:
            raise InvalidParameter(f"n_range must be 0.05 < low < high <= 2.5, got {n_range}")
        if plant.soil.rigid > 0.5:
            raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
        if not 0.001 <= dt <= 0.02:
            raise InvalidParameter(f"dt must be in [0.001, 0.02] s, got {dt} - in ms?")
        self.plant = plant
        self._packed = pack(plant)
        self._full = plant_model(plant) == "full"
        vehicle = plant.vehicle
        self._vehicle = (vehicle.l_f, vehicle.l_r, vehicle.steer_lag, vehicle.torque_lag)
        self.n_range = (low, high)
        self.dt = float(dt)
        self.settings = settings or EmbeddedSettings()
        self.navigation = navigation or NavigationFilter(plant.vehicle)
        margin = _MARGIN * (high - low)
        self._bounds = (max(low - margin, 0.5 * low), high + margin)
        imu = imu or ImuConfig()
        self._mount = imu.mount()
        self._setting = self._constants(imu)
        belief, copies, warms = np.zeros(2), np.zeros((3, at.STATE_SIZE)), np.zeros((3, 2, 3))
        self._state = (belief, copies, warms, np.full(3, math.nan), np.zeros(_MEMORY), np.zeros(3))
        self.reset(0.5 * (low + high), 0.25 * (high - low), Pose(0.0, 0.0, 0.0, 0.0))

    def _constants(self, imu: ImuConfig) -> tuple:
        s = self.settings
        sensor = np.array([imu.accel_noise, imu.accel_noise, imu.gyro_noise])
        R = np.diag(sensor**2 + np.square(s.error) * 2.0 * s.error_time / self.dt)
        gains = (s.position_gain, s.speed_gain, s.side_gain, s.yaw_rate_gain, s.pitch_rate_gain)
        gates = (s.hold_speed, s.least_information, s.settle_time, s.drift)
        return (
            self._bounds,
            merwe_weights(1.0, float(s.alpha), 0.0),
            R,
            tuple(float(value) for value in gains),
            tuple(float(value) for value in gates),
            self.dt,
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
        belief, copies, warms, last, memory, mean_innovation = self._state
        belief[:] = belief_of(n_prior, sd, *self._bounds)
        copies[:], warms[:], memory[:], mean_innovation[:] = 0.0, 0.0, 0.0, 0.0
        last[:] = memory[NIS] = math.nan
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
        navigation, state, setting = self.navigation, self._state, self._setting
        _, copies, warms, _, memory, _ = state
        if memory[AWAKE] < 0.5 and navigation.x[V] > self.settings.hold_speed:
            self._wake()
        place = (navigation.x, navigation.P, navigation.constants)
        points, predicted = (np.empty((3, 1)), np.empty(3)), np.empty((3, 5))
        if _before(state, place, (imu, rim_speeds, gnss), command, self._vehicle, setting, points):
            step = step_full_copies if self._full else step_paper_copies
            status = step(copies, warms, self._packed, points[1], command, self.dt, self._mount, predicted)
            if status < SUNK and np.isfinite(predicted).all() and np.isfinite(copies).all():
                _after(state, navigation.x, imu, points[0], predicted, setting)
            else:
                self._sleep()
        return self.estimate

    def _wake(self) -> None:
        """Settle every copy on its own soil, rolling at the navigation filter's speed."""
        belief, copies, warms, last, memory, _ = self._state
        nav, scale = self.navigation.x, math.sqrt(self._setting[1][3] * belief[1])
        pose = (nav[X], nav[Y], nav[YAW])
        for i, sign in enumerate((0.0, 1.0, -1.0)):
            n = to_range(belief[0] + sign * scale, *self._bounds)
            own = plant_with_exponent(self.plant, n)
            status, x, warms[i] = settle(own, pose, nav[V], self._full)
            if status >= SUNK or not np.isfinite(x).all():
                memory[SURPRISE] = math.inf
                return
            x[at.V_Y], x[at.STEER :] = nav[V_SIDE], copies[i, at.STEER :]
            copies[i] = x
        last[:] = math.nan
        memory[AWAKE] = 1.0

    def _sleep(self) -> None:
        """Some copy found no contact: hold, not valid, and start all of them again at the next sample."""
        _, copies, _, _, memory, _ = self._state
        copies[:, : at.STEER] = 0.0
        copies[~np.isfinite(copies)] = 0.0
        memory[AWAKE], memory[HELD], memory[SURPRISE] = 0.0, 1.0, math.inf

    @property
    def estimate(self) -> Estimate:
        """The belief as it stands."""
        belief, memory = self._state[0], self._state[4]
        mean, sd = moments(belief[0], belief[1], *self._bounds)
        return Estimate(
            mean=min(max(mean, self.n_range[0]), self.n_range[1]),
            sd=sd,
            nis=float(memory[NIS]),
            valid=bool(math.isfinite(sd) and memory[SURPRISE] < self.settings.surprise),
            repairs=int(memory[REPAIRS]),
        )

    @property
    def held(self) -> bool:
        """Whether the last sample taught nothing about n."""
        return bool(self._state[4][HELD] > 0.5)

    @property
    def pose(self) -> Pose:
        """Of the navigation filter."""
        return self.navigation.pose
