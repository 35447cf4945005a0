"""The paper's half-car with everything about it that nobody knows exactly.

`estimators.models.half_car_on_map` takes mass, soil moduli, map, steering and sensors as exact, so n is what
remains. Here the state holds the ten states, eta and fifteen nuisances, each with a stated prior
(`ModelUncertainty`):

=====================  =========================================================================
stiffness, mass        logarithms of a factor of (k_c, k_phi) and of the vehicle's mass [-]
lag                    of the steering [s]: the wheels stand where the command stood before
bump_f, bump_r         height of the ground under an axle above the map [m], and their rates
bias (5)               of the inertial unit [m/s^2, rad/s]
roll, pitch            misalignment of the inertial unit [rad]; the accelerometers measure gravity too
rim                    logarithm of what the rims read over what they should: radius and slip [-]
=====================  =========================================================================

A map that is shifted is a vehicle that stands elsewhere: that is a wide prior of X and Y.

Slip sinkage is M. Lyasko's (J. Terramechanics 47, 2010): a wheel at slip s sinks
K = (1 + |s|)/(1 - |s|/2) times as deep as Bekker's law gives. The pressure at the depth h is then
Bekker's at h/K, that is k (h/K)^n: moduli K^-n times as large, the exponent being the same. At
constant slip the stiffness represents it: anything between none of it and all.

A bump is coloured noise of the second order, e'' + (a + b) v e' + a b v^2 e = white, a and b being
the wavenumbers between which its spectrum falls with the square of the frequency, as that of
rough ground does (ISO 8608); above b it falls with the fourth power, so its rate does not jump.

The moduli and n are confounded: the pressure k h^n at the depth where the wheels run is well known, its
slope hardly. The state holds that pressure in place of the moduli (`tie`).

`linearise` gives slopes of motion and reading from one set of trial evaluations of the forces; the
filter (`estimators.filters.augmented_ekf_bank`) and the Cramer-Rao bound
(`estimators.analysis.uncertain_bound`) share it. A bump moves the axle against the ground as heave and pitch
do, so its slopes are combinations of theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.models.half_car_on_map import ETA, JointSettings, SettledStart, joint_model
from estimators.models.imu_prediction import plant_with
from estimators.numerics.bounded import to_range
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant, with_pressure
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.paper_vehicle import paper_derivative
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray, Vehicle
from offroad_env.physics.settle import settle
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor

__all__ = [
    "BIAS",
    "BUMP",
    "CHANNELS",
    "LAG",
    "LENGTH",
    "MASS",
    "PITCH_ERROR",
    "RIM",
    "ROLL_ERROR",
    "STIFFNESS",
    "BodyInput",
    "ModelUncertainty",
    "UncertainModel",
    "advance",
    "body_input",
    "linearise",
    "process_noise",
    "settled_belief",
    "tie",
    "uncertain_model",
    "with_mass",
]

#: Where each nuisance sits behind the ten states and eta.
STIFFNESS, MASS, LAG = 11, 12, 13
BUMP = 14  #: height front, its rate, height rear, its rate
BIAS = 18  #: a_x, a_y, a_z, pitch_rate, yaw_rate
ROLL_ERROR, PITCH_ERROR, RIM = 23, 24, 25
LENGTH = 26
#: Channels: the inertial unit and the rims, the first seven of `estimators.models.half_car_on_map.CHANNELS`.
CHANNELS = 7
_A_X, _A_Y, _A_Z, _PITCH_RATE, _YAW_RATE, _RIM_FRONT, _RIM_REAR = range(CHANNELS)
#: Those of the inertial unit.
_IMU = 5
#: Depth whose pressure stands for the moduli [m]; where the logarithm of its factor is that of theirs [-].
_DEPTH, _MIDDLE = 0.04, 0.75
_LOG_DEPTH = math.log(_DEPTH)
#: Slowest speed at which bumps pass [m/s].
_SLOWEST = 0.5
#: Steps of the one-sided differences for the ten states, eta, stiffness, mass, lag: second-order terms
#: stay below 1e-4 of the slope, the contact solve (1e-11) below 1e-5.
_STEPS = np.array([1e-5, 1e-5, 1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
#: Columns that are differenced; the others follow from them.
_TRIED = 14
_ACC = (at.A_X, at.A_Y, at.A_Z, at.PITCH_ACC, at.YAW_ACC)


@dataclass(frozen=True, kw_only=True)
class ModelUncertainty:
    """Standard deviations of what is uncertain: what a careful engineer would state beforehand."""

    stiffness: float = 0.2  #: log of the factor of the moduli [-]: a catalogue is right to ±20 %
    slip_sinkage: tuple[float, float] = (0.5, 0.29)  #: mean and sd of the share of it that acts [-]
    mass: float = 0.07  #: log of the mass's factor [-]
    lag: float = 0.05  #: of the steering [s]
    bump_lengths: tuple[float, float] = (20.0, 2.0)  #: longest and shortest waves that the map lacks [m]
    place: float = 0.4  #: of the vehicle on the map, along each axis [m]
    acceleration_bias: float = 0.1  #: [m/s^2]
    rate_bias: float = 0.005  #: [rad/s]
    misalignment: float = 0.035  #: roll and pitch of the inertial unit [rad]
    rim: float = 0.02  #: log of the rims' factor: a tyre's radius, a slip that differs [-]
    #: What the model leaves out, per channel of the inertial unit [m/s^2, rad/s] and of the rims [m/s],
    #: and how long such an error lasts [s]. A filter for white noise must count it as a
    #: variance of 2 error^2 time/dt per sample. Half as much along, across and at the rims covers each
    #: mismatch alone, but not all at once. Vertically it is large: how the front's bumps reach the rear,
    #: and what inertia of the wheels they stir, is not in the belief. With a third of it, and a map that
    #: is wrong by a centimetre, the vertical motion on clay leads to twice the true n.
    error: tuple[float, float, float, float, float, float, float] = (
        0.06, 0.06, 0.3, 0.03, 0.004, 0.04, 0.04,
    )  # fmt: skip
    error_time: float = 0.2
    #: Process noise beyond that of `JointSettings`: v_x, v_y, v_z [m/s/sqrt(s)], pitch_rate,
    #: yaw_rate [rad/s/sqrt(s)].
    process: tuple[float, float, float, float, float] = (0.01, 0.002, 0.03, 0.03, 1e-4)

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            values = getattr(self, name)
            if not all(value > 0.0 for value in (values if isinstance(values, tuple) else (values,))):
                raise InvalidParameter(f"{name} must be > 0, got {values}")
        for name, count in (("process", 5), ("error", CHANNELS), ("bump_lengths", 2), ("slip_sinkage", 2)):
            if len(getattr(self, name)) != count:
                raise InvalidParameter(f"{name} must have {count} numbers, got {getattr(self, name)}")


class UncertainModel(NamedTuple):
    """Plant, noise and prior variances as the kernels need them."""

    plant: Plant
    dt: float  #: time between samples [s]
    low: float  #: bounds of n [-]
    high: float
    Q: FloatArray  #: (LENGTH,) variances of the process noise per step, but for the bumps
    R: FloatArray  #: (CHANNELS,) variances of the sensor noise
    P: FloatArray  #: (LENGTH,) variances of the start, but for eta, the bumps and slip sinkage
    sinks: tuple[float, float]  #: mean and sd of the logarithm of the sinkage's factor [-]
    bump_poles: tuple[float, float]  #: wavenumbers between which the bumps' spectrum falls [rad/m]


class BodyInput(NamedTuple):
    """Inputs of one moment."""

    steer: float  #: commanded steering [rad]
    force: float  #: body force F_u [N]
    steer_rate: float  #: rate of the command [rad/s]


def uncertain_model(
    plant: Plant, dt: float, settings: JointSettings, uncertainty: ModelUncertainty
) -> UncertainModel:
    """The kernels' view of a plant, its noise and what is uncertain about it.

    Parameters
    ----------
    plant, dt, settings
        As for `estimators.models.half_car_on_map.joint_model`.
    uncertainty : ModelUncertainty

    Raises
    ------
    InvalidParameter
        As `estimators.models.half_car_on_map.joint_model`.
    """
    model = joint_model(plant, dt, settings)
    Q, P = np.zeros(LENGTH), np.empty(LENGTH)
    Q[: ETA + 1] = model.Q
    Q[at.V_X : at.YAW_RATE + 1] += np.square(uncertainty.process) * dt
    P[:ETA], P[ETA] = np.square(settings.start), 0.0
    P[[at.X, at.Y]] += uncertainty.place**2
    P[[STIFFNESS, MASS, LAG]] = uncertainty.stiffness**2, uncertainty.mass**2, uncertainty.lag**2
    P[BUMP : BUMP + 4] = 0.0
    P[BIAS : BIAS + 5] = np.repeat([uncertainty.acceleration_bias**2, uncertainty.rate_bias**2], (3, 2))
    P[[ROLL_ERROR, PITCH_ERROR]], P[RIM] = uncertainty.misalignment**2, uncertainty.rim**2
    (mean, sd), (longest, shortest) = uncertainty.slip_sinkage, uncertainty.bump_lengths
    deeper = math.log(lyasko_sinkage_factor(plant.slip))
    R = model.R[:CHANNELS].copy()
    R += np.square(uncertainty.error) * 2.0 * uncertainty.error_time / dt
    return UncertainModel(
        plant=plant,
        dt=float(dt),
        low=model.low,
        high=model.high,
        Q=Q,
        R=R,
        P=P,
        sinks=(mean * deeper, sd * deeper),
        bump_poles=(2.0 * math.pi / longest, 2.0 * math.pi / shortest),
    )


@kernel
def body_input(inputs: FloatArray, dt: float) -> BodyInput:
    """Inputs at the end of a step, from (steer, F_u, NaN) (3, 3) at its start, middle and end."""
    return BodyInput(inputs[2, 0], inputs[2, 1], (inputs[2, 0] - inputs[0, 0]) / dt)


@kernel
def with_mass(v: Vehicle, factor: float) -> Vehicle:
    """The same vehicle with another mass; its moments of inertia stay."""
    return replace(v, m=v.m * factor)


@kernel
def tie(n: float) -> float:
    """Logarithm of the pressure at `_DEPTH` less that of the moduli's factor, but for a constant."""
    return (n - _MIDDLE) * _LOG_DEPTH


@kernel
def _believed(point: FloatArray, model: UncertainModel) -> Plant:
    """The plant that a point (26,) of the state stands for."""
    plant, n = model.plant, to_range(point[ETA], model.low, model.high)
    return plant_with(
        plant,
        with_mass(plant.vehicle, math.exp(point[MASS])),
        with_pressure(plant.soil, n, math.exp(point[STIFFNESS] - tie(n))),
    )


@kernel
def _forces(
    point: FloatArray,
    u: BodyInput,
    model: UncertainModel,
    warm: FloatArray,
    x: FloatArray,
    readings: FloatArray,
) -> None:
    """Forces and accelerations of the vehicle of ``point`` (26,), into ``readings``.

    ``x`` (10,) is scratch: the state relative to the ground with its bumps.
    """
    v = model.plant.vehicle
    base = v.l_f + v.l_r
    for i in range(ETA):
        x[i] = point[i]
    x[at.Z] -= (v.l_r * point[BUMP] + v.l_f * point[BUMP + 2]) / base
    x[at.V_Z] -= (v.l_r * point[BUMP + 1] + v.l_f * point[BUMP + 3]) / base
    x[at.PITCH] -= (point[BUMP] - point[BUMP + 2]) / base
    x[at.PITCH_RATE] -= (point[BUMP + 1] - point[BUMP + 3]) / base
    rates = np.empty(ETA)
    inputs = (u.steer - point[LAG] * u.steer_rate, u.force, math.nan)
    paper_derivative(x, inputs, _believed(point, model), warm, rates, readings)


@kernel
def _bump_rates(v_x: float, model: UncertainModel) -> tuple[float, float]:
    """((a + b) v [1/s], a b v^2 [1/s^2]) of the bumps' motion."""
    v, poles = max(v_x, _SLOWEST), model.bump_poles
    return (poles[0] + poles[1]) * v, poles[0] * poles[1] * v * v


@kernel
def _motion(point: FloatArray, readings: FloatArray, model: UncertainModel, d: FloatArray) -> None:
    """Time derivative of ``point`` (BT bicycle 1-3 and half-car 1-2, and the bumps) into ``d`` (26,)."""
    cos_yaw, sin_yaw = math.cos(point[at.YAW]), math.sin(point[at.YAW])
    cos, sin = math.cos(point[at.PITCH]), math.sin(point[at.PITCH])
    v_x, v_y, v_z, yaw_rate = point[at.V_X], point[at.V_Y], point[at.V_Z], point[at.YAW_RATE]
    d[:] = 0.0
    d[at.X], d[at.Y] = v_x * cos_yaw - v_y * sin_yaw, v_x * sin_yaw + v_y * cos_yaw
    d[at.YAW], d[at.Z], d[at.PITCH] = yaw_rate, v_z, point[at.PITCH_RATE]
    d[at.V_X] = readings[at.A_X] + v_y * yaw_rate * cos + v_z * point[at.PITCH_RATE]
    d[at.V_Y] = readings[at.A_Y] + v_z * yaw_rate * sin - v_x * yaw_rate * cos
    d[at.V_Z], d[at.PITCH_RATE], d[at.YAW_RATE] = (
        readings[at.A_Z],
        readings[at.PITCH_ACC],
        readings[at.YAW_ACC],
    )
    fast, square = _bump_rates(v_x, model)
    for i in (BUMP, BUMP + 2):
        d[i] = point[i + 1]
        d[i + 1] = -fast * point[i + 1] - square * point[i]


@kernel
def _reading(point: FloatArray, readings: FloatArray, out: FloatArray) -> None:
    """Readings of unit and rims (7,) without noise: small angles of misalignment, gravity included."""
    a_x, a_y, a_z = readings[at.A_X], readings[at.A_Y], readings[at.A_Z]
    roll, pitch = point[ROLL_ERROR], point[PITCH_ERROR]
    out[_A_X] = a_x + pitch * (a_z + GRAVITY)
    out[_A_Y] = a_y + roll * (a_z + GRAVITY)
    out[_A_Z] = a_z - pitch * a_x - roll * a_y
    out[_PITCH_RATE] = point[at.PITCH_RATE] - roll * point[at.YAW_RATE]
    out[_YAW_RATE] = point[at.YAW_RATE] + roll * point[at.PITCH_RATE]
    for j in range(_IMU):
        out[j] += point[BIAS + j]
    factor = math.exp(point[RIM])
    out[_RIM_FRONT] = factor * readings[at.R_OMEGA]
    out[_RIM_REAR] = factor * readings[at.AXLE + at.R_OMEGA]


@kernel
def process_noise(v_x: float, bump: float, model: UncertainModel, Q: FloatArray) -> None:
    """Variances of the process noise of one step (26,) into ``Q``; ``v_x`` [m/s], bumps of ``bump`` [m]."""
    fast, square = _bump_rates(v_x, model)
    Q[:] = model.Q
    Q[BUMP + 1] = Q[BUMP + 3] = 2.0 * fast * square * bump**2 * model.dt


@kernel
def advance(point: FloatArray, warm: FloatArray, inputs: FloatArray, model: UncertainModel) -> float:
    """Carry a point (26,) over a sample, in place, by Runge-Kutta's rule; returns the contact status.

    ``inputs`` (3, 3) : (steer, F_u, NaN) at the start, middle and end of the step.
    """
    k, total, stage = np.empty(LENGTH), np.zeros(LENGTH), point.copy()
    x, readings = np.empty(ETA), np.empty(at.READINGS_SIZE)
    dt, rate, worst = model.dt, (inputs[2, 0] - inputs[0, 0]) / model.dt, 0.0
    for i in range(4):
        row = (i + 1) // 2
        _forces(stage, BodyInput(inputs[row, 0], inputs[row, 1], rate), model, warm, x, readings)
        worst = max(worst, readings[at.STATUS])
        _motion(stage, readings, model, k)
        share = 1.0 if i == 0 or i == 3 else 2.0
        ahead = dt if i == 2 else 0.5 * dt
        for j in range(LENGTH):
            total[j] += share * k[j]
            stage[j] = point[j] + ahead * k[j]
    for j in range(LENGTH):
        point[j] += dt / 6.0 * total[j]
    return worst


@kernel
def _bump_slopes(model: UncertainModel, slopes: FloatArray, other: FloatArray) -> None:
    """Slopes with the bumps from those with heave, pitch and their rates: ``other`` += ..."""
    v = model.plant.vehicle
    base = v.l_f + v.l_r
    for i in range(slopes.shape[0]):
        for rate in range(2):
            z = slopes[i, at.Z] if rate == 0 else slopes[i, at.V_Z]
            tilt = slopes[i, at.PITCH] if rate == 0 else slopes[i, at.PITCH_RATE]
            other[i, BUMP + rate] -= (v.l_r * z + tilt) / base
            other[i, BUMP + 2 + rate] -= (v.l_f * z - tilt) / base


@kernel
def linearise(
    point: FloatArray,
    warm: FloatArray,
    inputs: BodyInput,
    model: UncertainModel,
    A: FloatArray,
    H: FloatArray,
    out: FloatArray,
) -> float:
    """Slopes of motion A (26, 26) and reading H (7, 26) at ``point``, and the reading; contact status."""
    x, readings = np.empty(ETA), np.empty(at.READINGS_SIZE)
    base, trial_warm = np.empty(at.READINGS_SIZE), np.empty((warm.shape[0], warm.shape[1]))
    d_0, d, z = np.empty(LENGTH), np.empty(LENGTH), np.empty(CHANNELS)
    _forces(point, inputs, model, warm, x, base)
    _motion(point, base, model, d_0)
    _reading(point, base, out)
    worst: float = base[at.STATUS]
    A[:], H[:] = 0.0, 0.0
    pushed, sensed = np.empty((len(_ACC), _TRIED)), np.empty((CHANNELS, _TRIED))
    trial = point.copy()
    for j in range(_TRIED):
        trial[j] += _STEPS[j]
        trial_warm[:] = warm
        _forces(trial, inputs, model, trial_warm, x, readings)
        worst = max(worst, readings[at.STATUS])
        _motion(trial, readings, model, d)
        _reading(trial, readings, z)
        A[:, j], H[:, j] = (d - d_0) / _STEPS[j], (z - out) / _STEPS[j]
        # What the forces alone change, the motion kept: the slopes that a bump shares.
        _reading(point, readings, z)
        for i in range(len(_ACC)):
            pushed[i, j] = (readings[_ACC[i]] - base[_ACC[i]]) / _STEPS[j]
        sensed[:, j] = (z - out) / _STEPS[j]
        trial[j] = point[j]
    _bump_slopes(model, pushed, A[at.V_X : at.YAW_RATE + 1])
    _bump_slopes(model, sensed, H)
    fast, square = _bump_rates(point[at.V_X], model)
    for i in (BUMP, BUMP + 2):
        A[i, i + 1], A[i + 1, i], A[i + 1, i + 1] = 1.0, -square, -fast
    for i in range(_IMU):
        H[i, BIAS + i] = 1.0
    a_z = base[at.A_Z] + GRAVITY
    H[_A_X, PITCH_ERROR], H[_A_Z, PITCH_ERROR] = a_z, -base[at.A_X]
    H[_A_Y, ROLL_ERROR], H[_A_Z, ROLL_ERROR] = a_z, -base[at.A_Y]
    H[_PITCH_RATE, ROLL_ERROR], H[_YAW_RATE, ROLL_ERROR] = -point[at.YAW_RATE], point[at.PITCH_RATE]
    H[_RIM_FRONT, RIM], H[_RIM_REAR, RIM] = out[_RIM_FRONT], out[_RIM_REAR]
    return worst


@kernel
def _expected_stiffness(n: float, model: UncertainModel) -> float:
    """Mean of the stiffness at the start on a soil: the catalogue's moduli, less by slip sinkage."""
    return tie(n) - n * model.sinks[0]


@kernel
def settled_belief(
    model: UncertainModel,
    eta: float,
    variance: float,
    bump: float,
    pose: tuple[float, float, float],
    v_x: float,
) -> SettledStart:
    """Mean (26,) and covariance of a vehicle settled on the soil of ``eta``, which has the given variance.

    The settled start is linearised in eta, stiffness, mass and place: heave and pitch follow them
    and the bumps, of size ``bump`` [m], within the covariance.
    """
    mean, slope = np.zeros(LENGTH), np.zeros((LENGTH, LENGTH))
    trial, worst = np.zeros(LENGTH), 0.0
    X, Y, yaw = pose
    for j in (ETA, STIFFNESS, MASS, at.X, at.Y):
        trial[:] = 0.0
        trial[ETA], trial[at.X], trial[at.Y] = eta, X, Y
        step = 0.01
        for sign in (-1.0, 1.0):
            trial[STIFFNESS] = 0.0
            trial[j] += sign * step
            trial[STIFFNESS] += _expected_stiffness(to_range(trial[ETA], model.low, model.high), model)
            status, x, _ = settle(_believed(trial, model), (trial[at.X], trial[at.Y], yaw), v_x)
            worst = max(worst, status)
            slope[:ETA, j] += sign * x[:ETA] / (2.0 * step)
            slope[STIFFNESS, j] += sign * trial[STIFFNESS] / (2.0 * step)
            if j != STIFFNESS:
                trial[j] -= sign * step
        slope[j, j] = 1.0
    v = model.plant.vehicle
    base = v.l_f + v.l_r
    for j in range(LENGTH):
        if j < ETA or j > MASS:
            slope[j, j] = 1.0
    for rate in range(2):
        front, rear = BUMP + rate, BUMP + 2 + rate
        z, tilt = (at.Z, at.PITCH) if rate == 0 else (at.V_Z, at.PITCH_RATE)
        slope[z, front], slope[z, rear] = v.l_r / base, v.l_f / base
        slope[tilt, front], slope[tilt, rear] = 1.0 / base, -1.0 / base
    mean[ETA] = eta
    mean[STIFFNESS] = _expected_stiffness(to_range(eta, model.low, model.high), model)
    status, x, warm = settle(_believed(mean, model), pose, v_x)
    mean[:ETA] = x[:ETA]
    variances = model.P.copy()
    variances[ETA] = variance
    variances[STIFFNESS] += (to_range(eta, model.low, model.high) * model.sinks[1]) ** 2
    for i in (BUMP, BUMP + 2):
        variances[i], variances[i + 1] = bump**2, bump**2 * _bump_rates(v_x, model)[1]
    return SettledStart(max(worst, status), mean, (slope * variances) @ slope.T, warm)
