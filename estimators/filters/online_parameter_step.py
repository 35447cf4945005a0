"""One sample of the online parameter filter (`estimators.filters.online_parameter_ukf`), as kernels.

The kernels work on records, so that the compiled control period of the environment keeps the memory of a
filter among the records of its episodes.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.filters.innovation_test import mean_innovation_test
from estimators.filters.navigation import GYRO_BIAS, V_SIDE, YAW, V, X, Y
from estimators.filters.online_base import MEAN_TIME, WIDEST, follow_command, report_estimate
from estimators.filters.protocol import Estimate
from estimators.models.imu_prediction import plant_with_exponent, step_full_copies, step_paper_copies
from estimators.numerics.bounded import moments, to_range
from estimators.numerics.unscented import (
    merwe_weights,
    sigma_points,
    unscented_mean_covariance,
    unscented_update,
)
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.imu import A_X, A_Y, PITCH_RATE, YAW_RATE, ImuMount
from offroad_env.physics.numerics import all_finite, copy_into
from offroad_env.physics.packing import PackedPlant, pack, unpack
from offroad_env.physics.records import FloatArray, Ground, Soil, SoilMap, Vehicle
from offroad_env.physics.settle import settle

__all__ = [
    "ASSUMPTIONS",
    "MEMORY",
    "learn_full",
    "learn_paper",
    "summary",
]

#: Readings of the inertial unit that are used. The vertical ones show the road.
_USED = (A_X, A_Y, YAW_RATE)
_CHANNELS = len(_USED)
#: Sigma points of one parameter: one copy of the vehicle each.
_COPIES = 3


def _plant_numbers() -> int:
    """Length of a packed plant, whatever is in it."""
    nothing = np.empty((0, 4))
    vehicle, soil = Vehicle(*(0.0,) * len(Vehicle._fields)), Soil(*(0.0,) * len(Soil._fields))
    ground, soil_map = Ground(0.0, 0.0, 0.0, nothing), SoilMap(0.0, nothing)
    plant = Plant(vehicle, soil, ground, soil_map, 0.0, 0.0, 0.0, 0.0, False)
    return len(pack(plant).numbers)


#: All that the filter remembers from sample to sample: one record, wherever it lies.
MEMORY = np.dtype(
    [
        ("belief", "f8", 2),  # mean and variance of eta
        ("copies", "f8", (_COPIES, at.STATE_SIZE)),
        ("warms", "f8", (_COPIES, 2, at.CONTACT_SIZE)),
        ("last", "f8", _CHANNELS),  # last sample of a_x, a_y, yaw_rate
        ("mean_innovation", "f8", _CHANNELS),
        ("nis", "f8"),
        ("surprise", "f8"),
        ("change", "f8", 2),  # score of eta and its information in a fading window
        ("watched", "f8"),  # how long that window has been open [s]
        ("unsettled", "f8"),  # time for which a change still holds the flag down [s]
        ("changes", "f8"),  # how many were detected
        ("repairs", "f8"),
        ("held", "f8"),
        ("awake", "f8"),
    ]
)

#: What is constant: settings, plant and sensors.
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
        ("alpha", "f8"),  # spread of the sigma points
        ("R", "f8", _CHANNELS),  # variances of the measurement noise
        ("position_gain", "f8"),  # gains [1/s]
        ("speed_gain", "f8"),
        ("side_gain", "f8"),
        ("yaw_rate_gain", "f8"),
        ("pitch_rate_gain", "f8"),
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


@kernel
def _rest(memory: np.record, assumed: np.record, command: tuple[float, float, float]) -> None:
    """Hold, and let the actuators of the resting copies follow the command."""
    copies, lags = memory.copies[:], assumed.lags[:]
    memory.awake, memory.held = 0.0, 1.0
    for i in range(_COPIES):
        follow_command(copies[i], command, (lags[0], lags[1]), assumed.dt)


@kernel
def _wake(memory: np.record, assumed: np.record, nav: FloatArray, plant: Plant) -> None:
    """Settle every copy on its own soil, rolling at the navigation filter's speed."""
    belief, copies, warms = memory.belief[:], memory.copies[:], memory.warms[:]
    weights = merwe_weights(1.0, assumed.alpha, 0.0)
    scale = math.sqrt(weights.scale * belief[1])
    for i in range(_COPIES):
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
def _sleep(memory: np.record) -> None:
    """A copy has no contact: hold, not valid, and start all of them again at the next sample."""
    copies = memory.copies[:]
    copies[:, : at.STEER] = 0.0
    for i in range(_COPIES):
        for j in range(at.STEER, at.STATE_SIZE):
            if not math.isfinite(copies[i, j]):
                copies[i, j] = 0.0
    memory.awake, memory.held, memory.surprise = 0.0, 1.0, math.inf


@kernel
def _pull(x: FloatArray, nav: FloatArray, imu: FloatArray, assumed: np.record) -> None:
    """Draw a copy towards what is measured: constant gains, wheels and heave left free."""
    dt, position, speed = assumed.dt, assumed.position_gain, assumed.speed_gain
    x[at.X] += position * dt * (nav[X] - x[at.X])
    x[at.Y] += position * dt * (nav[Y] - x[at.Y])
    x[at.YAW] += position * dt * (nav[YAW] - x[at.YAW])
    x[at.V_X] += speed * dt * (nav[V] - x[at.V_X])
    x[at.V_Y] += assumed.side_gain * dt * (nav[V_SIDE] - x[at.V_Y])
    x[at.YAW_RATE] += assumed.yaw_rate_gain * dt * (imu[YAW_RATE] - nav[GYRO_BIAS] - x[at.YAW_RATE])
    x[at.PITCH_RATE] += assumed.pitch_rate_gain * dt * (imu[PITCH_RATE] - x[at.PITCH_RATE])


@kernel
def _innovation_test(
    memory: np.record, assumed: np.record, innovation: FloatArray, spread: FloatArray
) -> None:
    """Chi-square of the mean innovation (3,), of variance R dt/(2 time) and the belief's ``spread``."""
    dt, R, variance = assumed.dt, assumed.R[:], np.empty(_CHANNELS)
    for j in range(_CHANNELS):
        variance[j] = R[j] * dt / (2.0 * MEAN_TIME) + spread[j, j]
    memory.surprise = mean_innovation_test(memory.mean_innovation[:], innovation, variance, dt / MEAN_TIME)


@kernel
def _change_test(
    memory: np.record,
    assumed: np.record,
    eta: FloatArray,
    predicted: FloatArray,
    innovation: FloatArray,
    R: FloatArray,
) -> None:
    """Test whether n has changed, and if so widen the belief by as much, in place.

    With the innovation e and the sensitivity h of a channel to eta, S = sum h e/R is the score of a
    fading window and I = sum h^2/R its information. S/I is the change that explains the window best,
    S^2/(I (1 + P I)) its square in standard deviations. Called after the update of the belief.
    """
    change, belief = memory.change[:], memory.belief[:]
    kept = 1.0 - assumed.dt / assumed.change_time
    score, information = kept * change[0], kept * change[1]
    span = eta[1, 0] - eta[2, 0]
    for j in range(innovation.shape[0]):
        slope = (predicted[1, j] - predicted[2, j]) / span
        score += slope * innovation[j] / R[j]
        information += slope * slope / R[j]
    score -= information * (belief[0] - eta[0, 0])  # the window's innovations against the new mean
    memory.watched += assumed.dt
    memory.unsettled = max(memory.unsettled - assumed.dt, 0.0)
    limit = assumed.change_level * assumed.change_level * information * (1.0 + belief[1] * information)
    # Copies that have just been settled on a wide belief are no evidence of a change yet.
    if memory.watched > assumed.change_time and information > 0.0 and score * score > limit:
        # A new belief has a new window: what is left of the change shows there.
        wider = belief[1] + (score / information) ** 2
        belief[1] = max(belief[1], min(wider, WIDEST))
        memory.unsettled = assumed.change_settle
        memory.changes += 1.0
        score = information = 0.0
    change[0], change[1] = score, information


@kernel
def _learn(
    memory: np.record,
    assumed: np.record,
    eta: FloatArray,
    predicted: FloatArray,
    z: FloatArray,
    R: FloatArray,
) -> None:
    """Unscented update of the belief, in place.

    The share of the variance that it removes is bounded above (`settle_time`); below a smallest share
    (`least_information`) there is no update.
    """
    least, most = assumed.least_information * assumed.dt, assumed.dt / assumed.settle_time
    belief: FloatArray = memory.belief[:]
    weights = merwe_weights(1.0, assumed.alpha, 0.0)
    mean, cov, innovation = np.empty(1), np.empty((1, 1)), np.empty(z.shape[0])
    mean[0], cov[0, 0] = belief[0], belief[1]
    update = unscented_update(mean, cov, eta, predicted, z, R, weights, innovation)
    nis, repairs = update.nis, update.repairs
    removed = 1.0 - cov[0, 0] / belief[1]
    if removed > most:
        # With R times this factor the share removed is close to `most`.
        softer = R * (removed / (1.0 - removed) * (1.0 - most) / most)
        mean[0], cov[0, 0] = belief[0], belief[1]
        update = unscented_update(mean, cov, eta, predicted, z, softer, weights, innovation)
        repairs += update.repairs
    memory.repairs += repairs
    if removed > least and math.isfinite(mean[0]) and cov[0, 0] > 0.0:
        belief[0], belief[1] = mean[0], cov[0, 0]
        memory.nis, memory.held = nis, 0.0
    else:
        memory.held = 1.0


@kernel
def _place(
    memory: np.record,
    assumed: np.record,
    nav: FloatArray,
    imu: FloatArray,
    command: tuple[float, float, float],
    eta: FloatArray,
    n: FloatArray,
) -> bool:
    """Let the belief drift, place the sigma points ``eta`` (3, 1), ``n`` (3,); false while at rest."""
    belief = memory.belief[:]
    belief[1] += assumed.drift * assumed.drift * assumed.dt
    if not (nav[V] > assumed.hold_speed and all_finite(imu)) or memory.awake < 0.5:
        _rest(memory, assumed, command)
        return False
    weights = merwe_weights(1.0, assumed.alpha, 0.0)
    cov, factor = belief[1:].reshape(1, 1), np.empty((1, 1))
    memory.repairs += sigma_points(belief[:1], cov, weights.scale, factor, eta)
    for i in range(_COPIES):
        n[i] = to_range(eta[i, 0], assumed.bounds[0], assumed.bounds[1])
    return True


@kernel
def _compare(
    memory: np.record,
    assumed: np.record,
    nav: FloatArray,
    imu: FloatArray,
    rims: FloatArray,
    eta: FloatArray,
    predicted: FloatArray,
) -> None:
    """Compare what the copies (3, 5) predicted with the sample that belongs to it, learn, pull.

    That sample is the previous one, taken at the state before the step: so a step yields its
    prediction without another force evaluation, and every sample is used one period late. Rims turn
    with the state itself: theirs is compared at once.
    """
    copies, last, variances = memory.copies[:], memory.last[:], assumed.R[:]
    used = _CHANNELS
    if assumed.rim_variance < math.inf and all_finite(rims):
        used += rims.shape[0]
    channels, z, R = np.empty((_COPIES, used)), np.empty(used), np.empty(used)
    copy_into(z[:_CHANNELS], last)
    copy_into(R[:_CHANNELS], variances)
    for j in range(_CHANNELS, used):
        # Beyond its own speed, which a copy is drawn to and the navigation filter may have wrong.
        z[j], R[j] = rims[j - _CHANNELS] - nav[V], assumed.rim_variance
    for i in range(_COPIES):
        for j in range(_CHANNELS):
            channels[i, j] = predicted[i, _USED[j]]
        for j in range(_CHANNELS, used):
            channels[i, j] = assumed.radius * copies[i, at.OMEGA_F + j - _CHANNELS] - copies[i, at.V_X]
        _pull(copies[i], nav, imu, assumed)
    if math.isfinite(last[0]):
        expected, spread = np.empty(used), np.empty((used, used))
        unscented_mean_covariance(channels, merwe_weights(1.0, assumed.alpha, 0.0), expected, spread)
        innovation = z - expected
        _innovation_test(memory, assumed, innovation, spread)
        _learn(memory, assumed, eta, channels, z, R)
        _change_test(memory, assumed, eta, channels, innovation, R)
    for j in range(_CHANNELS):
        last[j] = imu[_USED[j]]


@inline_kernel
def _conclude(
    memory: np.record,
    assumed: np.record,
    nav: FloatArray,
    measured: tuple[FloatArray, FloatArray],
    eta: FloatArray,
    predicted: FloatArray,
    status: float,
) -> None:
    """After the copies' step: compare and learn, or put copies without contact to rest."""
    if status < SUNK and all_finite(predicted.reshape(-1)) and all_finite(memory.copies[:].reshape(-1)):
        _compare(memory, assumed, nav, measured[0], measured[1], eta, predicted)
    else:
        _sleep(memory)


@inline_kernel
def _model(assumed: np.record, map_: tuple[FloatArray, FloatArray]) -> tuple[PackedPlant, ImuMount]:
    """Packed plant and mount of the inertial unit."""
    waves, patches = map_
    mount = ImuMount(assumed.lever[:], assumed.rotation[:], assumed.mount[0], assumed.mount[1])
    return PackedPlant(assumed.plant[:], waves, patches, None, None, None, None), mount


@kernel
def learn_full(
    memory: np.record,
    assumed: np.record,
    map_: tuple[FloatArray, FloatArray],
    nav: FloatArray,
    measured: tuple[FloatArray, FloatArray],
    command: tuple[float, float, float],
) -> None:
    """Take in one sample of the sensors, full model; the navigation filter has taken it in already.

    Parameters
    ----------
    memory, assumed : records of the types `MEMORY` and `ASSUMPTIONS`; the memory is updated in place
    map_ : (waves, patches) of the ground and soil of the filter's model
    nav : state (9,) of the navigation filter
    measured : (imu (5,), rim speeds (2,)); NaN where a rim was not measured
    command : (steering [rad], drive and brake torque [N m])
    """
    packed, mount = _model(assumed, map_)
    if memory.awake < 0.5 and nav[V] > assumed.hold_speed:
        _wake(memory, assumed, nav, unpack(packed))
    eta, n, predicted = np.empty((_COPIES, 1)), np.empty(_COPIES), np.empty((_COPIES, 5))
    if _place(memory, assumed, nav, measured[0], command, eta, n):
        copies, warms = memory.copies[:], memory.warms[:]
        status = step_full_copies(copies, warms, packed, n, command, assumed.dt, mount, predicted)
        _conclude(memory, assumed, nav, measured, eta, predicted, status)


@kernel
def learn_paper(
    memory: np.record,
    assumed: np.record,
    map_: tuple[FloatArray, FloatArray],
    nav: FloatArray,
    measured: tuple[FloatArray, FloatArray],
    command: tuple[float, float, float],
) -> None:
    """`learn_full` for the paper's model, where ``command`` is (steering [rad], F_u [N], NaN)."""
    packed, mount = _model(assumed, map_)
    if memory.awake < 0.5 and nav[V] > assumed.hold_speed:
        _wake(memory, assumed, nav, unpack(packed))
    eta, n, predicted = np.empty((_COPIES, 1)), np.empty(_COPIES), np.empty((_COPIES, 5))
    if _place(memory, assumed, nav, measured[0], command, eta, n):
        copies, warms = memory.copies[:], memory.warms[:]
        status = step_paper_copies(copies, warms, packed, n, command, assumed.dt, mount, predicted)
        _conclude(memory, assumed, nav, measured, eta, predicted, status)


@kernel
def summary(memory: np.record, assumed: np.record) -> Estimate:
    """The estimate."""
    belief, bounds = memory.belief[:], assumed.bounds[:]
    calm = memory.unsettled <= 0.0 and memory.surprise < assumed.surprise
    n_range = (assumed.low, assumed.high)
    return report_estimate(
        moments(belief[0], belief[1], bounds[0], bounds[1]), n_range, memory.nis, memory.repairs, calm
    )
