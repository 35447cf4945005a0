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

*How it notices another soil.* A belief of a minute would follow a step of n in ten seconds and stay
narrow meanwhile. But a step shows in all innovations of half a second at once, along their
sensitivity to n; noise does not. When that score leaves its band, the belief is widened by the
change that explains it and the flag is down until the copies have followed (`_notice`).

*Where the soil is known to change.* Then all this is too slow, and a belief that drifts faster learns from
the inertial unit alone no sooner: when only the front wheels stand on softer soil, the vehicle hardly
decelerates. But they slip, at once and by far more than a rim's speed may be wrong. `CHANGING_SOIL` lets
the belief drift with the soil and compares the rims' speeds too; on soil that rests its band is four times
as wide, so it is not the default.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.models import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.navigation import GYRO_BIAS, V_SIDE, YAW, NavigationFilter, V, X, Y
from estimators.protocol import Estimate, Pose
from estimators.transforms import belief_of, moments, to_range
from estimators.ukf_compiled import check_alpha, merwe_weights, sigma_points, unscented_update
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.numerics import all_finite, copy_into
from offroad_env.physics.packing import PackedPlant, pack, unpack
from offroad_env.physics.records import Ground, Soil, SoilMap, Vehicle
from offroad_env.physics.sensor_kernels import ImuMount
from offroad_env.physics.settle import settle
from offroad_env.sensors import ImuConfig, WheelSpeedConfig
from offroad_env.simulator import Plant, plant_model

__all__ = [
    "ASSUMPTIONS",
    "CHANGING_SOIL",
    "MEMORY",
    "EmbeddedParameterUKF",
    "EmbeddedSettings",
    "checked_range",
    "learn_full",
    "learn_paper",
    "summary",
]


def _plant_numbers() -> int:
    """Length of a packed plant, whatever is in it."""
    nothing = np.empty((0, 4))
    parts = (record(*(0.0,) * len(record._fields)) for record in (Vehicle, Soil))
    plant = Plant(*parts, Ground(0.0, 0.0, 0.0, nothing), SoilMap(0.0, nothing), 0.0, 0.0, 0.0, 0.0, False)
    return len(pack(plant).numbers)


#: All that the filter remembers from sample to sample: one record, wherever it lies.
MEMORY = np.dtype(
    [
        ("belief", "f8", 2),  # mean and variance of eta
        ("copies", "f8", (3, at.STATE_SIZE)),
        ("warms", "f8", (3, 2, at.CONTACT_SIZE)),
        ("last", "f8", 3),  # last sample of a_x, a_y, yaw_rate
        ("mean_innovation", "f8", 3),
        ("nis", "f8"),
        ("surprise", "f8"),
        ("change", "f8", 2),  # score of eta and its information in a fading window
        ("watched", "f8"),  # how long that window has been open [s]
        ("unsettled", "f8"),  # time for which a change still holds the flag down [s]
        ("changes", "f8"),  # how many were noticed
        ("repairs", "f8"),
        ("held", "f8"),
        ("awake", "f8"),
    ]
)

#: What it takes for given, from `EmbeddedSettings`, the plant and the sensors.
ASSUMPTIONS = np.dtype(
    [
        ("plant", "f8", _plant_numbers()),
        ("lags", "f8", 2),  # steering, torque [s]
        ("lever", "f8", 3),  # of the `ImuMount`
        ("rotation", "f8", (3, 3)),
        ("mount", "f8", 2),
        ("low", "f8"),  # range of n that is reported
        ("high", "f8"),
        ("bounds", "f8", 2),  # range of the filter
        ("weights", "f8", 4),
        ("R", "f8", (3, 3)),
        ("gains", "f8", 5),
        ("hold_speed", "f8"),
        ("least_information", "f8"),
        ("settle_time", "f8"),
        ("drift", "f8"),
        ("surprise", "f8"),
        ("change_time", "f8"),
        ("change_level", "f8"),
        ("change_settle", "f8"),
        ("radius", "f8"),  # of the wheels [m]
        ("rim_variance", "f8"),
        ("dt", "f8"),
    ]
)

#: Time over which innovations are averaged for the validity flag [s].
_MEAN_TIME = 2.0
#: The filter's range is wider than the user's by this share on both sides: a bound is endlessly far
#: away on the scale of eta, so a soil close to one would be approached too slowly.
_MARGIN = 0.15
#: Samples of the rim speeds a second [Hz].
_RIM_RATE = WheelSpeedConfig().rate
#: Settings of the test for a change.
_CHANGE = ("change_time", "change_level", "change_settle")
#: Variance of eta up to which a change widens the belief: a fifth of the range of n, as wide as a prior.
_WIDEST = 1.0


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
    #: The same of a rim's speed beyond the vehicle's own [m/s]; infinite: rims are not compared. The paper's
    #: wheels do not spin, so with its model they never are.
    rim_error: float = math.inf

    change_time: float = 0.5  #: fading window of the test for a change of n [s]
    #: Deviation at which n has changed [standard deviations]. They are those of errors that last, far
    #: wider than what a window shows on a constant soil: of 0.7 to 2 the least with no alarm there.
    change_level: float = 1.25
    change_settle: float = 1.0  #: how long the flag stays down after a change: two `settle_time` [s]

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        for name in ("drift", "error_time", "settle_time", "hold_speed", "surprise", "rim_error", *_CHANGE):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")


#: Where the soil is known to change every few tens of metres: eta may move by a standard deviation of the
#: prior in a second, and slip follows n within 0.1 s. A radius known to 1 % and the speed of the navigation
#: filter leave some 0.1 m/s of a rim's speed unknown; twice that, and the level of the test, were chosen on
#: recorded drives over patches: for delay, and for few alarms on soil that rests below another mass.
CHANGING_SOIL = EmbeddedSettings(
    drift=1.0, settle_time=0.1, rim_error=0.25, change_level=2.5, change_settle=0.2
)


@kernel
def _rest(memory, assumed, command):
    """Hold, and let the actuators of the sleeping copies follow the command."""
    dt, copies = assumed.dt, memory.copies[:]
    memory.awake, memory.held = 0.0, 1.0
    turn, share = dt / max(assumed.lags[0], dt), dt / max(assumed.lags[1], dt)
    for i in range(3):
        copies[i, at.STEER] += turn * (command[0] - copies[i, at.STEER])
        copies[i, at.DRIVE] += share * (command[1] - copies[i, at.DRIVE])
        copies[i, at.BRAKE] += share * (command[2] - copies[i, at.BRAKE])


@kernel
def _wake(memory, assumed, nav, plant):
    """Settle every copy on its own soil, rolling at the navigation filter's speed."""
    belief, copies, warms = memory.belief[:], memory.copies[:], memory.warms[:]
    scale = math.sqrt(assumed.weights[3] * belief[1])
    for i in range(3):
        eta = belief[0] + scale * (0.0 if i == 0 else 3.0 - 2.0 * i)
        own = plant_with_exponent(plant, to_range(eta, assumed.bounds[0], assumed.bounds[1]))
        status, x, warm = settle(own, (nav[X], nav[Y], nav[YAW]), nav[V])
        copy_into(warms[i].reshape(-1), warm.reshape(-1))
        if status >= SUNK or not all_finite(x):
            memory.surprise = math.inf
            return
        x[at.V_Y] = nav[V_SIDE]
        copy_into(x[at.STEER :], copies[i, at.STEER :])
        copy_into(copies[i], x)
    memory.last[:] = math.nan
    memory.change[:] = 0.0
    memory.watched = 0.0
    memory.awake = 1.0


@kernel
def _sleep(memory):
    """Some copy found no contact: hold, not valid, and start all of them again at the next sample."""
    copies = memory.copies[:]
    copies[:, : at.STEER] = 0.0
    for i in range(3):
        for j in range(at.STEER, at.STATE_SIZE):
            if not math.isfinite(copies[i, j]):
                copies[i, j] = 0.0
    memory.awake, memory.held, memory.surprise = 0.0, 1.0, math.inf


@kernel
def _pull(x, nav, imu, gains, dt):
    """Draw a copy towards what is measured: constant gains, wheels and heave left free."""
    position, speed, side, yaw_rate, pitch_rate = gains[0], gains[1], gains[2], gains[3], gains[4]
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
    for j in range(mean_innovation.shape[0]):
        expected = a_0_m * predicted[0, j] + a_i * (predicted[1, j] + predicted[2, j])
        spread = a_0_c * (predicted[0, j] - expected) ** 2
        spread += a_i * ((predicted[1, j] - expected) ** 2 + (predicted[2, j] - expected) ** 2)
        mean_innovation[j] += dt / _MEAN_TIME * (z[j] - expected - mean_innovation[j])
        total += mean_innovation[j] ** 2 / (R[j, j] * dt / (2.0 * _MEAN_TIME) + spread)
    return total


@kernel
def _notice(memory, assumed, points, predicted, z):
    """Test whether n has changed, and if so widen the belief by as much.

    With the innovation e and the sensitivity h of a channel to eta, S = sum h e/R is the score of a
    fading window and I = sum h^2/R its information. S/I is the change that explains the window best,
    S^2/(I (1 + P I)) its square in standard deviations. Called after the update of the belief.
    """
    change, belief, R, w = memory.change[:], memory.belief[:], assumed.R[:], assumed.weights
    kept = 1.0 - assumed.dt / assumed.change_time
    score, information = kept * change[0], kept * change[1]
    span = points[1, 0] - points[2, 0]
    for j in range(z.shape[0]):
        expected = w[0] * predicted[0, j] + w[2] * (predicted[1, j] + predicted[2, j])
        slope = (predicted[1, j] - predicted[2, j]) / span
        score += slope * (z[j] - expected) / R[j, j]
        information += slope * slope / R[j, j]
    score -= information * (belief[0] - points[0, 0])  # the window's innovations against the new mean
    memory.watched += assumed.dt
    memory.unsettled = max(memory.unsettled - assumed.dt, 0.0)
    limit = assumed.change_level * assumed.change_level * information * (1.0 + belief[1] * information)
    # Copies that have just been settled on a wide belief say nothing about a change yet.
    if memory.watched > assumed.change_time and information > 0.0 and score * score > limit:
        # A new belief has a new window: what is left of the change shows itself there.
        wider = belief[1] + (score / information) ** 2
        belief[1] = max(belief[1], min(wider, _WIDEST))
        memory.unsettled = assumed.change_settle
        memory.changes += 1.0
        score = information = 0.0
    change[0], change[1] = score, information


@kernel
def _learn(memory, points, predicted, z, R, weights, shares):
    """Unscented update that removes a share of the variance between ``shares``, or none."""
    least, most = shares
    belief = memory.belief[:]
    mean, cov = np.empty(1), np.empty((1, 1))
    mean[0], cov[0, 0] = belief[0], belief[1]
    nis, repairs = unscented_update(mean, cov, points, predicted, z, R, weights)
    memory.repairs += repairs
    removed = 1.0 - cov[0, 0] / belief[1]
    if removed > most:
        # With R times this factor the share removed is close to `most`.
        softer, factor = np.empty(R.shape), removed / (1.0 - removed) * (1.0 - most) / most
        for j in range(R.shape[0]):
            for k in range(R.shape[0]):
                softer[j, k] = R[j, k] * factor
        mean[0], cov[0, 0] = belief[0], belief[1]
        _, repairs = unscented_update(mean, cov, points, predicted, z, softer, weights)
        memory.repairs += repairs
    if removed > least and math.isfinite(mean[0]) and cov[0, 0] > 0.0:
        belief[0], belief[1] = mean[0], cov[0, 0]
        memory.nis, memory.held = nis, 0.0
    else:
        memory.held = 1.0


@kernel
def _place(memory, assumed, nav, imu, command, points):
    """Let the belief drift and place the sigma points; false while the copies rest.

    ``points`` = (eta (3, 1), n (3,)), filled.
    """
    belief = memory.belief[:]
    belief[1] += assumed.drift * assumed.drift * assumed.dt
    if not (nav[V] > assumed.hold_speed and all_finite(imu)) or memory.awake < 0.5:
        _rest(memory, assumed, command)
        return False
    factor = np.empty((1, 1))
    memory.repairs += sigma_points(
        belief[:1], belief[1:].reshape(1, 1), assumed.weights[3], factor, points[0]
    )
    for i in range(3):
        points[1][i] = to_range(points[0][i, 0], assumed.bounds[0], assumed.bounds[1])
    return True


@kernel
def _compare(memory, assumed, nav, measured, points, predicted):
    """Compare what the copies (3, 5) predicted with the sample that belongs to it, learn, pull.

    That sample is the previous one, taken at the state before the step: so a step yields its
    prediction without another force evaluation, and every sample is used one period late. Rims turn
    with the state itself: theirs is compared at once.
    """
    imu, rims = measured
    copies, last, dt, w = memory.copies[:], memory.last[:], assumed.dt, assumed.weights
    weights, used = (w[0], w[1], w[2], w[3]), last.shape[0]
    if assumed.rim_variance < math.inf and all_finite(rims):
        used += rims.shape[0]
    channels, z, R = np.empty((3, used)), np.empty(used), np.zeros((used, used))
    copy_into(z[:3], last)
    R[:3, :3] = assumed.R[:]
    for j in range(3, used):
        # Beyond its own speed, which a copy is drawn to and the navigation filter may have wrong.
        z[j], R[j, j] = rims[j - 3] - nav[V], assumed.rim_variance
    for i in range(3):
        channels[i, 0], channels[i, 1], channels[i, 2] = predicted[i, 0], predicted[i, 1], predicted[i, 4]
        for j in range(3, used):
            channels[i, j] = assumed.radius * copies[i, at.OMEGA_F + j - 3] - copies[i, at.V_X]
        _pull(copies[i], nav, imu, assumed.gains[:], dt)
    if math.isfinite(last[0]):
        shares = (assumed.least_information * dt, dt / assumed.settle_time)
        memory.surprise = _watch(channels, z, R, weights, memory.mean_innovation[:], dt)
        _learn(memory, points, channels, z, R, weights, shares)
        _notice(memory, assumed, points, channels, z)
    last[0], last[1], last[2] = imu[0], imu[1], imu[4]


@inline_kernel
def _conclude(memory, assumed, nav, measured, points, predicted, status):
    """After the copies' step: compare and learn, or put copies without contact to sleep."""
    if status < SUNK and all_finite(predicted.reshape(-1)) and all_finite(memory.copies[:].reshape(-1)):
        _compare(memory, assumed, nav, measured, points, predicted)
    else:
        _sleep(memory)


@inline_kernel
def _believed(assumed, map_):
    """(packed plant, mount of the inertial unit), ``map_`` = (waves, patches)."""
    mount = ImuMount(assumed.lever[:], assumed.rotation[:], assumed.mount[0], assumed.mount[1])
    return PackedPlant(assumed.plant[:], map_[0], map_[1], None), mount


@kernel
def learn_full(memory, assumed, map_, nav, measured, command):
    """Take in one sample of the sensors, full model; the navigation filter has taken it in already.

    Parameters
    ----------
    memory, assumed : records of the types `MEMORY` and `ASSUMPTIONS`; the memory is updated in place
    map_ : (waves, patches) of the ground and soil that the filter believes in
    nav : state (8,) of the navigation filter
    measured : (imu (5,), rim speeds (2,)); NaN where a rim was not measured
    command : (steering [rad], drive and brake torque [N m])
    """
    packed, mount = _believed(assumed, map_)
    if memory.awake < 0.5 and nav[V] > assumed.hold_speed:
        _wake(memory, assumed, nav, unpack(packed))
    eta, n, predicted = np.empty((3, 1)), np.empty(3), np.empty((3, 5))
    if _place(memory, assumed, nav, measured[0], command, (eta, n)):
        copies, warms = memory.copies[:], memory.warms[:]
        status = step_full_copies(copies, warms, packed, n, command, assumed.dt, mount, predicted)
        _conclude(memory, assumed, nav, measured, eta, predicted, status)


@kernel
def learn_paper(memory, assumed, map_, nav, measured, command):
    """`learn_full` for the paper's model, where ``command`` is (steering [rad], F_u [N], NaN)."""
    packed, mount = _believed(assumed, map_)
    if memory.awake < 0.5 and nav[V] > assumed.hold_speed:
        _wake(memory, assumed, nav, unpack(packed))
    eta, n, predicted = np.empty((3, 1)), np.empty(3), np.empty((3, 5))
    if _place(memory, assumed, nav, measured[0], command, (eta, n)):
        copies, warms = memory.copies[:], memory.warms[:]
        status = step_paper_copies(copies, warms, packed, n, command, assumed.dt, mount, predicted)
        _conclude(memory, assumed, nav, measured, eta, predicted, status)


@kernel
def summary(memory, assumed):
    """(mean, sd, nis, valid 0/1, repairs): the `Estimate` as numbers."""
    mean, sd = moments(memory.belief[0], memory.belief[1], assumed.bounds[0], assumed.bounds[1])
    settled = math.isfinite(sd) and memory.unsettled <= 0.0
    valid = 1.0 if settled and memory.surprise < assumed.surprise else 0.0
    return min(max(mean, assumed.low), assumed.high), sd, memory.nis, valid, memory.repairs


@kernel
def _summary(memories, assumptions):
    return summary(memories[0], assumptions[0])


@kernel
def _learn_full(memories, assumptions, waves, patches, nav, imu, rims, command):
    learn_full(memories[0], assumptions[0], (waves, patches), nav, (imu, rims), command)


@kernel
def _learn_paper(memories, assumptions, waves, patches, nav, imu, rims, command):
    learn_paper(memories[0], assumptions[0], (waves, patches), nav, (imu, rims), command)


def checked_range(plant: Plant, n_range: tuple[float, float], dt: float) -> tuple[float, float]:
    """Bounds of n for a filter on board; refuses what such a filter cannot work with."""
    low, high = float(n_range[0]), float(n_range[1])
    if not 0.05 < low < high <= 2.5:
        raise InvalidParameter(f"n_range must be 0.05 < low < high <= 2.5, got {n_range}")
    if plant.soil.rigid > 0.5:
        raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
    if not 0.001 <= dt <= 0.02:
        raise InvalidParameter(f"dt must be in [0.001, 0.02] s, got {dt} - in ms?")
    return low, high


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
        Somebody else's, who keeps it up to date: then it is only read here. Default: one of its own.

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
        low, high = checked_range(plant, n_range, dt)
        self.plant = plant
        self.n_range = (low, high)
        self.dt = float(dt)
        self.settings = settings or EmbeddedSettings()
        self._own = navigation is None
        self.navigation = navigation or NavigationFilter(plant.vehicle)
        packed = pack(plant)
        self._map = (packed.waves, packed.patches)
        self._kernel = _learn_full if plant_model(plant) == "full" else _learn_paper
        self.assumptions = np.zeros(1, ASSUMPTIONS)
        self._assume(packed.numbers, imu or ImuConfig())
        self.memory = np.zeros(1, MEMORY)
        self._restart(0.5 * (low + high), 0.25 * (high - low))
        if self._own:
            self.navigation.reset(0.0, 0.0, 0.0, 0.0)

    def _assume(self, numbers: np.ndarray, imu: ImuConfig) -> None:
        s, assumed, (low, high) = self.settings, self.assumptions[0], self.n_range
        margin = _MARGIN * (high - low)
        sensor = np.array([imu.accel_noise, imu.accel_noise, imu.gyro_noise])
        mount, vehicle = imu.mount(), self.plant.vehicle
        assumed["plant"], assumed["lags"] = numbers, (vehicle.steer_lag, vehicle.torque_lag)
        assumed["lever"], assumed["rotation"] = mount.lever, mount.rotation
        assumed["mount"] = mount.body_axes, mount.gravity
        assumed["low"], assumed["high"] = low, high
        assumed["bounds"] = max(low - margin, 0.5 * low), high + margin
        assumed["weights"] = merwe_weights(1.0, float(s.alpha), 0.0)
        assumed["R"] = np.diag(sensor**2 + np.square(s.error) * 2.0 * s.error_time / self.dt)
        assumed["gains"] = s.position_gain, s.speed_gain, s.side_gain, s.yaw_rate_gain, s.pitch_rate_gain
        for name in ("hold_speed", "least_information", "settle_time", "drift", "surprise", *_CHANGE):
            assumed[name] = getattr(s, name)
        assumed["radius"] = vehicle.r
        rim_error = s.rim_error if plant_model(self.plant) == "full" else math.inf
        assumed["rim_variance"] = rim_error**2 * 2.0 * s.error_time * _RIM_RATE
        assumed["dt"] = self.dt

    def lodge(self, memory: np.ndarray) -> None:
        """From now on keep the memory in the first record of ``memory`` (1,), of the type `MEMORY`."""
        memory[0] = self.memory[0]
        self.memory = memory

    def reset(self, n_prior: float, sd: float, pose: Pose) -> Estimate:
        """Start at a known pose.

        Parameters
        ----------
        n_prior, sd : float
            Mean and standard deviation of the prior for n [-]; the mean lies inside ``n_range``.
        pose : Pose
            Position, heading and speed; not used where the navigation filter is somebody else's.

        Returns
        -------
        Estimate
            The prior.
        """
        low, high = self.n_range
        if not low <= n_prior <= high:
            raise InvalidParameter(f"n_prior must be in n_range = [{low}, {high}], got {n_prior}")
        self._restart(n_prior, sd)
        if self._own:
            self.navigation.reset(*pose)
        return self.estimate

    def _restart(self, n_prior: float, sd: float) -> None:
        self.memory[0] = np.zeros((), MEMORY)
        self.memory["belief"][0] = belief_of(n_prior, sd, *self.assumptions["bounds"][0].tolist())
        self.memory["last"][0] = self.memory["nis"][0] = math.nan

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
        if self._own:
            self.navigation.update(imu, rim_speeds, command[0], gnss, self.dt)
        nav = self.navigation.x
        self._kernel(self.memory, self.assumptions, *self._map, nav, imu, rim_speeds, command)
        return self.estimate

    @property
    def estimate(self) -> Estimate:
        """The belief as it stands."""
        mean, sd, nis, valid, repairs = _summary(self.memory, self.assumptions)
        return Estimate(mean, sd, nis, valid > 0.5, int(repairs))

    @property
    def held(self) -> bool:
        """Whether the last sample taught nothing about n."""
        return bool(self.memory["held"][0] > 0.5)

    @property
    def changes(self) -> int:
        """How many changes of n it has noticed since the reset."""
        return int(self.memory["changes"][0])

    @property
    def pose(self) -> Pose:
        """Of the navigation filter."""
        return self.navigation.pose
