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

from estimators.models import plant_with_exponent
from estimators.navigation import GYRO_BIAS, V, V_SIDE, YAW, NavigationFilter, X, Y, navigate
from estimators.protocol import Estimate, Pose
from estimators.transforms import from_range, moments, range_slope, to_range
from estimators.ukf_compiled import check_alpha, merwe_weights, sigma_points, unscented_update
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.advance import pack, unpack
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import full_step
from offroad_env.physics.sensor_kernels import imu_reading
from offroad_env.physics.paper_model import paper_step
from offroad_env.physics.settle import settle
from offroad_env.sensors import ImuConfig
from offroad_env.simulator import Plant

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
def _wake(state, plant, spread, bounds, nav):
    """Settle every copy on its own soil, rolling at the navigation filter's speed; worst status."""
    belief, copies, warms, last, memory, _ = state
    worst = 0.0
    for i in range(3):
        eta = belief[0] + (0.0 if i == 0 else (spread if i == 1 else -spread))
        own = plant_with_exponent(plant, to_range(eta, bounds[0], bounds[1]))
        status, x, warms[i] = settle(own, (nav[X], nav[Y], nav[YAW]), nav[V], plant.resultant > 0.5)
        worst = max(worst, status)
        x[at.V_Y] = nav[V_SIDE]
        x[at.STEER :] = copies[i, at.STEER :]
        copies[i] = x
    last[:] = np.nan
    memory[AWAKE] = 1.0
    return worst


@kernel
def _rest(state, vehicle, command, dt):
    """Too slow to tell: hold, and let the actuators of the sleeping copies follow the command."""
    _, copies, _, _, memory, _ = state
    memory[AWAKE], memory[HELD] = 0.0, 1.0
    torque_share = dt / max(vehicle.torque_lag, dt)
    for i in range(3):
        copies[i, at.STEER] += dt / max(vehicle.steer_lag, dt) * (command[0] - copies[i, at.STEER])
        copies[i, at.DRIVE] += torque_share * (command[1] - copies[i, at.DRIVE])
        copies[i, at.BRAKE] += torque_share * (command[2] - copies[i, at.BRAKE])


@kernel
def _step_copy(x, warm, plant, command, dt, mount, predicted):
    """Predict the reading (a_x, a_y, yaw_rate) of the state as it is, then carry it over ``dt``; status."""
    work, readings = np.empty((4, at.READINGS_SIZE)), np.empty(at.READINGS_SIZE)
    pitch, pitch_rate, yaw_rate = x[at.PITCH], x[at.PITCH_RATE], x[at.YAW_RATE]
    if plant.resultant > 0.5:
        status = full_step(x, warm, command, plant, dt, work, readings)
    else:
        held = np.empty((3, 3))
        held[:, 0], held[:, 1], held[:, 2] = command[0], command[1], math.nan
        status = paper_step(x, warm, held, plant, dt, work, readings)
    acceleration = (readings[at.A_X], readings[at.A_Y], readings[at.A_Z])
    yaw_acc, pitch_acc = readings[at.YAW_ACC], readings[at.PITCH_ACC]
    imu = imu_reading(acceleration, yaw_rate, pitch_rate, yaw_acc, pitch_acc, pitch, mount)
    predicted[0], predicted[1], predicted[2] = imu[0], imu[1], imu[4]
    return status


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
def _update(state, navigation, packed, command, sensors, mount, setting):
    """One sample of all sensors, in place.

    The reading that belongs to a state before its step is the previous sample, so every sample is
    used one period late, and the step yields the prediction without another force evaluation.
    """
    belief, copies, warms, last, memory, mean_innovation = state
    nav, P, noise = navigation
    plant = unpack(packed)
    imu = sensors[0]
    bounds, weights, R, gains, gates, dt = setting
    hold_speed, least, settle_time, drift = gates
    navigate((nav, P), sensors, command[0], (plant.vehicle.l_f, plant.vehicle.l_r), noise, dt)
    belief[1] += drift * drift * dt
    if not (nav[V] > hold_speed and np.isfinite(imu).all()):
        _rest(state, plant.vehicle, command, dt)
        return
    points, factor, predicted = np.empty((3, 1)), np.empty((1, 1)), np.empty((3, 3))
    memory[REPAIRS] += sigma_points(belief[:1], belief[1:].reshape(1, 1), weights[3], factor, points)
    worst = 0.0
    if memory[AWAKE] < 0.5:
        worst = _wake(state, plant, points[1, 0] - points[0, 0], bounds, nav)
    for i in range(3):
        own = plant_with_exponent(plant, to_range(points[i, 0], bounds[0], bounds[1]))
        status = _step_copy(copies[i], warms[i], own, command, dt, mount, predicted[i])
        worst = max(worst, status)
        _pull(copies[i], nav, imu, gains, dt)
    if worst >= SUNK or not (np.isfinite(predicted).all() and np.isfinite(copies).all()):
        copies[:] = 0.0
        _rest(state, plant.vehicle, command, dt)
        return
    if math.isfinite(last[0]):
        memory[SURPRISE] = _watch(predicted, last, R, weights, mean_innovation, dt)
        _learn(belief, memory, points, predicted, last, R, weights, (least * dt, dt / settle_time))
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
        if not sd > 0.0:
            raise InvalidParameter(f"sd must be > 0, got {sd} - a filter that is certain learns nothing")
        belief, copies, warms, last, memory, mean_innovation = self._state
        eta = from_range(float(n_prior), *self._bounds)
        belief[:] = eta, (sd / range_slope(eta, *self._bounds)) ** 2
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
        navigation = self.navigation
        state = (navigation.x, navigation.P, navigation.constants)
        sensors = (imu, rim_speeds, gnss)
        _update(self._state, state, self._packed, command, sensors, self._mount, self._setting)
        return self.estimate

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
