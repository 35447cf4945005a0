"""State and sinkage exponent in one belief: a compiled unscented filter on the paper's model.

The belief holds the ten states of the paper's model and eta, the sinkage exponent on an unbounded
scale (`estimators.transforms`). Nothing hands it the state: it needs the inertial unit alone, and
takes rim speeds and GNSS where they are measured.

The model is x_k = f(x_{k-1}, n, u) + w_k, z_k = h(x_k, n, u_k) + e_k. w_k stands for what the
model leaves out: white accelerations of the body, and the roughness of the road that the map
lacks, which shakes heave and pitch. Truth, filter and bound (`estimators.bounds`) share its
covariance and that of the start; without it the problem is so well determined that the quadrature
of the wheel forces would be the largest error.

Sigma points after van der Merwe (2004), redrawn once the process noise is in the covariance, so
that it reaches the gain (on a linear problem the filter is then the Kalman filter; tested). Every
sigma point has its own warm start of the contact solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.models import imu_of, plant_with_exponent
from estimators.transforms import from_range, interval, moments, range_slope, to_range
from estimators.ukf_compiled import check_alpha, guarded_cholesky, merwe_weights, sigma_points
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.paper_model import paper_derivative, paper_step
from offroad_env.physics.settle import settle
from offroad_env.physics.vehicle_model import Plant
from offroad_env.simulator import plant_model

__all__ = [
    "CHANNELS",
    "ETA",
    "IMU_CHANNELS",
    "SIZE",
    "JointModel",
    "JointRun",
    "JointSettings",
    "advance_point",
    "check_run",
    "hypothesis",
    "joint_model",
    "joint_step",
    "measured",
    "only_imu",
    "prior",
    "read_point",
    "run_joint_filter",
    "summed_up",
    "transform_moments",
    "update",
]

#: The belief: ten states of the paper's model, then eta.
ETA = 10
SIZE = 11
#: What can be measured: the inertial unit, r omega of both axles, GNSS position, speed and course.
CHANNELS = (
    "a_x", "a_y", "a_z", "pitch_rate", "yaw_rate", "rim_front", "rim_rear", "X", "Y", "speed", "course",
)  # fmt: skip
IMU_CHANNELS = 5
_COURSE = 10
_LOG_2PI = math.log(2.0 * math.pi)
#: Half the step of the difference that ties the settled start to eta.
_START_STEP = 0.01


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Noise, start and spread of a joint filter: one setting for all soils, roads and manoeuvres."""

    n_range: tuple[float, float] = (0.2, 1.4)  #: bounds of n [-]
    alpha: float = 1.0  #: spread of the sigma points: sqrt(11) standard deviations
    #: Process noise of v_x, v_y, v_z [m/s/sqrt(s)], pitch_rate, yaw_rate [rad/s/sqrt(s)]. The body's
    #: accelerations are modelled to 0.01 m/s^2 over a second; the road adds to heave and pitch. Sideways
    #: and in yaw there is little: over a kilometre without GNSS a heading that drifts by 1e-3 rad leaves
    #: the crests of the map.
    process: tuple[float, float, float, float, float] = (0.01, 0.002, 0.03, 0.03, 1e-4)
    drift: float = 0.0  #: random walk of eta [1/sqrt(s)]; 0: the soil does not change
    #: Start: standard deviation of X, Y [m], yaw [rad], z [m], pitch [rad], v_x, v_y, v_z [m/s],
    #: pitch_rate, yaw_rate [rad/s] about the vehicle settled on the soil of the hypothesis.
    start: tuple[float, ...] = (0.02, 0.02, 1e-4, 1e-3, 1e-3, 0.05, 2e-3, 0.01, 5e-3, 5e-4)
    #: Sensor noise per sample: accelerations [m/s^2], rates [rad/s], rims [m/s], X, Y [m], speed [m/s],
    #: course [rad]. The first five are the paper's.
    noise: tuple[float, ...] = (0.2, 0.2, 0.2, 0.0175, 0.0175, 0.05, 0.05, 0.5, 0.5, 0.1, 0.02)

    def __post_init__(self) -> None:
        check_alpha(self.alpha)
        low, high = self.n_range
        if not 0.05 < low < high <= 2.5:
            raise InvalidParameter(f"n_range must be 0.05 < low < high <= 2.5, got {self.n_range}")
        for name, count in (("process", 5), ("start", 10), ("noise", len(CHANNELS))):
            values = getattr(self, name)
            if len(values) != count or not all(value > 0.0 for value in values):
                raise InvalidParameter(
                    f"{name} must be {count} standard deviations > 0, got {values} - "
                    "a state that is certain leaves the covariance without a Cholesky factor"
                )
        if not self.drift >= 0.0:
            raise InvalidParameter(f"drift must be >= 0, got {self.drift}")


class JointModel(NamedTuple):
    """What the kernels need besides the belief."""

    plant: Plant
    dt: float  #: time between samples [s]
    low: float  #: bounds of n [-]
    high: float
    Q: np.ndarray  #: (SIZE,) variances of the process noise per step
    R: np.ndarray  #: (len(CHANNELS),) variances of the sensor noise
    weights: tuple[float, float, float, float]  #: of `ukf_compiled.merwe_weights`


def joint_model(plant: Plant, dt: float, settings: JointSettings) -> JointModel:
    """The kernels' view of a plant and its noise.

    Raises
    ------
    InvalidParameter
        For a plant that is not the paper's half-car on deformable soil, or a step outside
        [0.001, 0.02] s.
    """
    if plant_model(plant) != "paper" or plant.half_car < 0.5:
        raise InvalidParameter("the joint filter runs the paper's half-car: make_plant(..., model='paper')")
    if plant.soil.rigid > 0.5:
        raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
    if not 0.001 <= dt <= 0.02:
        raise InvalidParameter(f"dt must be in [0.001, 0.02] s, got {dt} - in ms?")
    Q = np.zeros(SIZE)
    Q[at.V_X : at.YAW_RATE + 1] = np.square(settings.process) * dt
    Q[ETA] = settings.drift**2 * dt
    return JointModel(
        plant=plant,
        dt=float(dt),
        low=float(settings.n_range[0]),
        high=float(settings.n_range[1]),
        Q=Q,
        R=np.square(np.array(settings.noise, dtype=np.float64)),
        weights=merwe_weights(float(SIZE), float(settings.alpha), 0.0),
    )


@kernel
def hypothesis(model, eta, variance, pose, v_x):
    """(status, mean (11,), covariance (11, 11), warm (2, 3)) of a vehicle settled on the soil of ``eta``.

    The settled start is linearised in eta, so a deeper rut goes with a softer soil within the
    covariance, whose rank is 1: what else is uncertain about the start is to be added.
    """
    mean, slope = np.empty(SIZE), np.empty(SIZE)
    worst = 0.0
    for sign in (-1.0, 1.0):
        plant = plant_with_exponent(model.plant, to_range(eta + sign * _START_STEP, model.low, model.high))
        status, state, _ = settle(plant, pose, v_x)
        worst = max(worst, status)
        for i in range(ETA):
            slope[i] = state[i] if sign < 0.0 else (state[i] - slope[i]) / (2.0 * _START_STEP)
    plant = plant_with_exponent(model.plant, to_range(eta, model.low, model.high))
    status, state, warm = settle(plant, pose, v_x)
    mean[:ETA], mean[ETA], slope[ETA] = state[:ETA], eta, 1.0
    return max(worst, status), mean, variance * np.outer(slope, slope), warm


def prior(
    model: JointModel,
    settings: JointSettings,
    n: float,
    sd: float,
    pose: tuple[float, float, float],
    v_x: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Belief of a vehicle that stands settled on a soil of exponent about ``n``.

    Heave and pitch follow the hypothesis: the settled start is linearised in eta, so that a deeper
    rut goes with a softer soil within the belief.

    Parameters
    ----------
    n, sd : float
        Mean and standard deviation of the prior [-]; the mean inside the range.
    pose : (X, Y, yaw)
        [m, m, rad]
    v_x : float
        Speed [m/s].

    Returns
    -------
    mean (11,), covariance (11, 11), warm start (2, 3).

    Raises
    ------
    InvalidParameter, SolverFailure
        For a prior outside the range, or a soil that does not carry the vehicle.
    """
    if not (model.low < n < model.high and sd > 0.0):
        raise InvalidParameter(
            f"the prior must have {model.low} < n < {model.high} and sd > 0, got {n}, {sd}"
        )
    eta = from_range(float(n), model.low, model.high)
    variance = (sd / range_slope(eta, model.low, model.high)) ** 2
    place = tuple(float(p) for p in pose)
    status, mean, cov, warm = hypothesis(model, eta, variance, place, float(v_x))
    if status >= SUNK:
        raise SolverFailure(f"the soil with n = {n:.3f} does not carry the vehicle")
    cov[np.arange(ETA), np.arange(ETA)] += np.square(settings.start)
    return mean, cov, warm


@kernel
def advance_point(point, warm, inputs, model, work, readings):
    """Carry one point (11,) over a sample with its own exponent, in place; returns the contact status."""
    n = to_range(point[ETA], model.low, model.high)
    plant = plant_with_exponent(model.plant, n)
    return paper_step(point[:ETA], warm, inputs, plant, model.dt, work, readings)


@kernel
def read_point(point, warm, inputs, model, work, readings, out):
    """What all sensors would read, without noise, into ``out`` (11,); returns the contact status.

    ``inputs`` (3,) are those of the moment.
    """
    plant = plant_with_exponent(model.plant, to_range(point[ETA], model.low, model.high))
    x = point[:ETA]
    paper_derivative(x, (inputs[0], inputs[1], inputs[2]), plant, warm, work[0], readings)
    imu_of(x, readings, out)
    out[5], out[6] = readings[at.R_OMEGA], readings[at.AXLE + at.R_OMEGA]
    out[7], out[8] = x[at.X], x[at.Y]
    out[9] = math.hypot(x[at.V_X], x[at.V_Y])
    out[_COURSE] = x[at.YAW] + math.atan2(x[at.V_Y], x[at.V_X])
    return readings[at.STATUS]


@kernel
def transform_moments(points, weights, mean, cov):
    """Weighted mean and covariance of the sigma points (2L + 1, L), into ``mean`` and ``cov``."""
    a_0_m, a_0_c, a_i, _ = weights
    count, L = points.shape
    for j in range(L):
        total = a_0_m * points[0, j]
        for i in range(1, count):
            total += a_i * points[i, j]
        mean[j] = total
    apart = points - mean
    for j in range(L):
        for k in range(j + 1):
            total = a_0_c * apart[0, j] * apart[0, k]
            for i in range(1, count):
                total += a_i * apart[i, j] * apart[i, k]
            cov[j, k] = cov[k, j] = total


@kernel
def update(mean, cov, points, predicted, z, R, weights):
    """Measurement update in place; returns ``(log likelihood, nis, repairs)``.

    As `ukf_compiled.unscented_update` (bound to it by a test), with independent sensor noise
    ``R`` (m,) and the log density of the measurement, which weighs one hypothesis against another.
    """
    _, a_0_c, a_i, _ = weights
    L, m, count = mean.shape[0], z.shape[0], points.shape[0]
    expected, S_zz, S = np.empty(m), np.empty((m, m)), np.empty((m, m))
    transform_moments(predicted, weights, expected, S_zz)
    for j in range(m):
        S_zz[j, j] += R[j]
    repairs = guarded_cholesky(S_zz, S)
    A, innovation = np.empty((L + 1, m)), z - expected
    for p in range(L):
        for j in range(m):
            total = a_0_c * (points[0, p] - mean[p]) * (predicted[0, j] - expected[j])
            for i in range(1, count):
                total += a_i * (points[i, p] - mean[p]) * (predicted[i, j] - expected[j])
            A[p, j] = total
    A[L] = innovation
    log_density = -0.5 * m * _LOG_2PI
    for j in range(m):  # forward substitution of all rows at once: A becomes A S^-T
        for p in range(L + 1):
            for k in range(j):
                A[p, j] -= S[j, k] * A[p, k]
            A[p, j] /= S[j, j]
        log_density -= math.log(S[j, j])
    nis = 0.0
    for j in range(m):
        nis += A[L, j] * A[L, j]
    for p in range(L):
        for q in range(p + 1):
            total = cov[p, q]
            for j in range(m):
                total -= A[p, j] * A[q, j]
            cov[p, q] = cov[q, p] = total
        for j in range(m):
            mean[p] += A[p, j] * A[L, j]
    return log_density - 0.5 * nis, nis, repairs


@kernel
def measured(predicted, z):
    """What was measured (not NaN): columns of ``predicted``, entries of ``z``, and their indices."""
    index = np.flatnonzero(np.isfinite(z))
    present = np.empty(index.shape[0])
    columns = np.empty((predicted.shape[0], index.shape[0]))
    for j in range(index.shape[0]):
        present[j] = z[index[j]]
        columns[:, j] = predicted[:, index[j]]
        if index[j] == _COURSE:  # the branch of the angle that the belief is on
            turns = np.round((predicted[0, _COURSE] - present[j]) / (2.0 * math.pi))
            present[j] += 2.0 * math.pi * turns
    return columns, present, index


@kernel
def joint_step(mean, cov, warms, inputs, z, model):
    """One sample: predict over ``dt``, then update, in place.

    Parameters
    ----------
    mean (11,), cov (11, 11), warms (23, 2, 3) : belief and the warm start of every sigma point
    inputs (3, 3) : (steer [rad], F_u [N], NaN) at the start, middle and end of the step
    z (11,) : readings at its end, NaN where nothing was measured

    Returns
    -------
    (log likelihood, nis, repairs, status). With a status of SUNK or worse some sigma point had no
    contact solution: the belief is as before and the likelihood is -inf.
    """
    count = 2 * SIZE + 1
    points, factor = np.empty((count, SIZE)), np.empty((SIZE, SIZE))
    work, readings = np.empty((3, ETA)), np.empty(at.READINGS_SIZE)
    predicted = np.empty((count, z.shape[0]))
    new_mean, new_cov = np.empty(SIZE), np.empty((SIZE, SIZE))
    repairs = sigma_points(mean, cov, model.weights[3], factor, points)
    worst = 0.0
    for i in range(count):
        worst = max(worst, advance_point(points[i], warms[i], inputs, model, work, readings))
    if worst < SUNK and np.isfinite(points).all():
        transform_moments(points, model.weights, new_mean, new_cov)
        for j in range(SIZE):
            new_cov[j, j] += model.Q[j]
        repairs += sigma_points(new_mean, new_cov, model.weights[3], factor, points)
        for i in range(count):
            status = read_point(points[i], warms[i], inputs[2], model, work, readings, predicted[i])
            worst = max(worst, status)
    if not (worst < SUNK and np.isfinite(predicted).all()):
        warms[:, :, 0] = 0.0  # a failed solve is no start for the next one
        return -math.inf, math.nan, repairs, SUNK
    log_likelihood, nis = 0.0, math.nan
    columns, present, index = measured(predicted, z)
    if present.shape[0] > 0:
        log_likelihood, nis, repaired = update(
            new_mean, new_cov, points, columns, present, model.R[index], model.weights
        )
        repairs += repaired
    mean[:], cov[:] = new_mean, new_cov
    return log_likelihood, nis, repairs, worst


@kernel
def _run(belief, warm, inputs, z, model, result):
    """The loop behind `run_joint_filter`; returns (repairs, skipped)."""
    mean, cov = belief
    means, covs, nis = result
    warms = np.empty((2 * SIZE + 1, 2, 3))
    warms[:] = warm
    means[0], covs[0] = mean, cov
    repairs = skipped = 0
    for k in range(1, z.shape[0]):
        step = inputs[2 * k - 2 : 2 * k + 1]
        _, nis[k], repaired, status = joint_step(mean, cov, warms, step, z[k], model)
        repairs += repaired
        skipped += 1 if status >= SUNK else 0
        means[k], covs[k] = mean, cov
    return repairs, skipped


@dataclass(frozen=True, kw_only=True)
class JointRun:
    """What a joint filter believed. Row k belongs to the k-th sample; row 0 is the prior."""

    means: np.ndarray  #: (T, 11) ten states and eta
    covariances: np.ndarray  #: (T, 11, 11)
    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) standard deviation of n [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval of n [-]
    high: np.ndarray  #: (T,) its upper end [-]
    nis: np.ndarray  #: (T,) normalised innovation squared; NaN without a measurement
    repairs: int  #: repaired factorisations
    skipped: int  #: samples left out because some sigma point had no contact solution


def only_imu(imu: np.ndarray) -> np.ndarray:
    """Readings (T, 11) with nothing but the inertial unit (T, 5): the other channels are NaN."""
    z = np.full((len(imu), len(CHANNELS)), math.nan)
    z[:, :IMU_CHANNELS] = imu
    return z


def check_run(inputs: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as contiguous float arrays, or InvalidParameter when they do not belong together."""
    inputs, z = np.ascontiguousarray(inputs, dtype=np.float64), np.ascontiguousarray(z, dtype=np.float64)
    if z.ndim != 2 or z.shape[1] != len(CHANNELS):
        raise InvalidParameter(f"z must be (T, {len(CHANNELS)}), got {z.shape} - see `only_imu`")
    if inputs.shape != (2 * len(z) - 1, 3):
        raise InvalidParameter(
            f"z has {len(z)} rows, so inputs must be ({2 * len(z) - 1}, 3) (half steps), got {inputs.shape}"
        )
    return inputs, z


def summed_up(
    model: JointModel, beliefs: tuple[np.ndarray, np.ndarray, np.ndarray], repairs: int, skipped: int
) -> JointRun:
    """A run from its means (T, 11), covariances (T, 11, 11) and NIS (T,)."""
    means, covs, nis = beliefs
    eta, variance = means[:, ETA], covs[:, ETA, ETA]
    n = np.array([moments(e, v, model.low, model.high) for e, v in zip(eta, variance, strict=True)])
    band = np.array([interval(e, v, model.low, model.high) for e, v in zip(eta, variance, strict=True)])
    return JointRun(
        means=means,
        covariances=covs,
        n=n[:, 0],
        sd=n[:, 1],
        low=band[:, 0],
        high=band[:, 1],
        nis=nis,
        repairs=repairs,
        skipped=skipped,
    )


def run_joint_filter(
    model: JointModel,
    start: tuple[np.ndarray, np.ndarray, np.ndarray],
    inputs: np.ndarray,
    z: np.ndarray,
) -> JointRun:
    """Filter a whole run.

    Parameters
    ----------
    model : JointModel
        Of `joint_model`.
    start : (mean (11,), covariance (11, 11), warm (2, 3))
        Of `prior`; not changed.
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    z : array (T, 11)
        Readings in the order of `CHANNELS`, NaN where not measured; row 0 is not used.
    """
    inputs, z = check_run(inputs, z)
    T = len(z)
    means, covs, nis = np.empty((T, SIZE)), np.empty((T, SIZE, SIZE)), np.full(T, math.nan)
    mean, cov, warm = start
    belief = (mean.copy(), cov.copy())
    repairs, skipped = _run(belief, warm, inputs, z, model, (means, covs, nis))
    return summed_up(model, (means, covs, nis), int(repairs), int(skipped))
