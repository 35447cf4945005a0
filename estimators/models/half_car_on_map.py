"""The paper's half-car on a known map, with the sinkage exponent as an eleventh state.

x_k = f(x_{k-1}, u_k) + w_k,   z_k = h(x_k, u_k) + e_k: the ten states of the paper's model, and eta, the
sinkage exponent on an unbounded scale (`estimators.numerics.bounded`), which is constant but for a slow
random walk. What is estimated is state and parameter jointly. The sensors are the inertial unit, the speeds
of the rims and GNSS, any of which may be missing at a sample.

The process noise w_k stands for what the model leaves out: white accelerations of the body, and the
roughness of the road that the map lacks, which shakes heave and pitch. Truth, filters and the Cramer-Rao
bound (`estimators.analysis.cramer_rao`) share its covariance Q, and that of the start. Without it the
problem is so well determined that the quadrature of the wheel forces would be the largest error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.models.imu_prediction import imu_of, plant_with_exponent
from estimators.numerics.bounded import from_range, range_slope, to_range
from estimators.numerics.unscented import SigmaWeights, check_alpha, merwe_weights
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.paper_vehicle import paper_derivative, paper_step
from offroad_env.physics.records import FloatArray
from offroad_env.physics.settle import settle
from offroad_env.simulation.simulator import plant_model

__all__ = [
    "CHANNELS",
    "ETA",
    "IMU_CHANNELS",
    "SIZE",
    "Belief",
    "JointModel",
    "JointSettings",
    "SettledStart",
    "advance_point",
    "check_run",
    "joint_model",
    "only_imu",
    "present_channels",
    "prior",
    "read_point",
    "settled_start",
]

#: The joint state: ten states of the paper's model, then eta.
ETA = 10
SIZE = 11
#: What can be measured: the inertial unit, r omega of both axles, GNSS position, speed and course.
CHANNELS = (
    "a_x", "a_y", "a_z", "pitch_rate", "yaw_rate", "rim_front", "rim_rear", "X", "Y", "speed", "course",
)  # fmt: skip
IMU_CHANNELS = 5
_RIM_FRONT, _RIM_REAR, _X, _Y, _SPEED, _COURSE = range(IMU_CHANNELS, len(CHANNELS))
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
    """Plant, noise and sigma points as the kernels need them."""

    plant: Plant
    dt: float  #: time between samples [s]
    low: float  #: bounds of n [-]
    high: float
    Q: FloatArray  #: (SIZE,) variances of the process noise per step
    R: FloatArray  #: (len(CHANNELS),) variances of the sensor noise
    weights: SigmaWeights  #: of the joint filter's sigma points


class Belief(NamedTuple):
    """Gaussian density of the joint state, with the contact solution at its mean."""

    mean: FloatArray  #: (11,)
    cov: FloatArray  #: (11, 11)
    warm: FloatArray  #: (2, 3) warm start of the contact solve


class SettledStart(NamedTuple):
    """A vehicle that stands settled on a soil, linearised in eta."""

    status: float  #: worst contact status: SUNK or worse where the soil does not carry the vehicle
    mean: FloatArray  #: (11,)
    cov: FloatArray  #: (11, 11), of rank 1
    warm: FloatArray  #: (2, 3) warm start of the contact solve


def joint_model(plant: Plant, dt: float, settings: JointSettings) -> JointModel:
    """The kernels' view of a plant and its noise.

    Parameters
    ----------
    plant : Plant
        The paper's half-car on deformable soil; its soil's n is not used.
    dt : float
        Time between samples [s].
    settings : JointSettings

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
def settled_start(
    model: JointModel, eta: float, variance: float, pose: tuple[float, float, float], v_x: float
) -> SettledStart:
    """State of a vehicle that stands settled on the soil of ``eta``, which has the given variance.

    The settled state is linearised in eta, so a deeper rut goes with a softer soil within the covariance.
    What else is uncertain about the start is to be added.
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
    return SettledStart(max(worst, status), mean, variance * np.outer(slope, slope), warm)


def prior(
    model: JointModel,
    settings: JointSettings,
    n: float,
    sd: float,
    pose: tuple[float, float, float],
    v_x: float,
) -> Belief:
    """Belief of a vehicle that stands settled on a soil of exponent about ``n``.

    Heave and pitch follow eta: the settled start is linearised, so that a deeper rut goes with a softer
    soil within the covariance.

    Parameters
    ----------
    model : JointModel
    settings : JointSettings
    n, sd : float
        Mean and standard deviation of the prior [-]; the mean inside the range.
    pose : (X, Y, yaw)
        [m, m, rad]
    v_x : float
        Speed [m/s].

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
    X, Y, yaw = pose
    start = settled_start(model, eta, variance, (float(X), float(Y), float(yaw)), float(v_x))
    if start.status >= SUNK:
        raise SolverFailure(f"the soil with n = {n:.3f} does not carry the vehicle")
    start.cov[np.arange(ETA), np.arange(ETA)] += np.square(settings.start)
    return Belief(start.mean, start.cov, start.warm)


@kernel
def advance_point(
    point: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    model: JointModel,
    work: FloatArray,
    readings: FloatArray,
) -> float:
    """Carry one point (11,) over a sample with its own exponent, in place; returns the contact status."""
    n = to_range(point[ETA], model.low, model.high)
    plant = plant_with_exponent(model.plant, n)
    status: float = paper_step(point[:ETA], warm, inputs, plant, model.dt, work, readings)
    return status


@kernel
def read_point(
    point: FloatArray,
    warm: FloatArray,
    inputs: FloatArray,
    model: JointModel,
    work: FloatArray,
    readings: FloatArray,
    out: FloatArray,
) -> float:
    """What all sensors would read, without noise, into ``out`` (11,); returns the contact status.

    ``inputs`` (3,) are those of the moment.
    """
    plant = plant_with_exponent(model.plant, to_range(point[ETA], model.low, model.high))
    x = point[:ETA]
    paper_derivative(x, (inputs[0], inputs[1], inputs[2]), plant, warm, work[0], readings)
    imu_of(x, readings, out)
    out[_RIM_FRONT], out[_RIM_REAR] = readings[at.R_OMEGA], readings[at.AXLE + at.R_OMEGA]
    out[_X], out[_Y] = x[at.X], x[at.Y]
    out[_SPEED] = math.hypot(x[at.V_X], x[at.V_Y])
    out[_COURSE] = x[at.YAW] + math.atan2(x[at.V_Y], x[at.V_X])
    status: float = readings[at.STATUS]
    return status


@kernel
def present_channels(predicted: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray, np.ndarray]:
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


def only_imu(imu: FloatArray) -> FloatArray:
    """Readings (T, 11) with nothing but the inertial unit (T, 5): the other channels are NaN."""
    z = np.full((len(imu), len(CHANNELS)), math.nan)
    z[:, :IMU_CHANNELS] = imu
    return z


def check_run(inputs: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both as contiguous float arrays.

    Parameters
    ----------
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    z : array (T, 11)
        Readings in the order of `CHANNELS`.

    Raises
    ------
    InvalidParameter
        When they do not belong together.
    """
    inputs, z = np.ascontiguousarray(inputs, dtype=np.float64), np.ascontiguousarray(z, dtype=np.float64)
    if z.ndim != 2 or z.shape[1] != len(CHANNELS):
        raise InvalidParameter(f"z must be (T, {len(CHANNELS)}), got {z.shape} - see `only_imu`")
    if inputs.shape != (2 * len(z) - 1, 3):
        raise InvalidParameter(
            f"z has {len(z)} rows, so inputs must be ({2 * len(z) - 1}, 3) (half steps), got {inputs.shape}"
        )
    return inputs, z
