"""Evidence for each soil once the filter's model may be wrong, and what it does to an estimate of n.

A filter that takes its model for exact - mass, moduli, sensors, steering - attributes every error of that
model to the soil. Its innovations stay consistent, because on straight clay a wrong mass has the effect of
another n; its standard deviation and its flag hold *given the model*. This module computes which other soils
explain the same drive once the model may be wrong by as much as a careful engineer would state beforehand.

*Evidence.* Every soil of a grid over n gets a small model of the horizontal motion: side speed, yaw rate
and, where torque drives the wheels, their spin, under the vehicle's own force laws. The axles are loaded by
the measured vertical acceleration and settled on that soil; the speed is the filter's. The predictions of
a_x, a_y and yaw rate are compared with the measurements. Seven nuisance parameters are integrated out: mass,
moduli (with slip sinkage), steering lag, speed, and a bias of each channel (misalignment, which couples in
gravity, included). They act linearly, through the motion as well, with the stated priors, so the integral is
exact (D. V. Lindley & A. F. M. Smith, J. R. Stat. Soc. B 34, 1972). What remains is the evidence for each
soil; soils that the data do not distinguish share it. A consider covariance (S. F. Schmidt, NASA TN D-3300,
1966) holds to first order about the filter's own estimate; the evidence covers every root of the force, and
nuisance values that the innovations rule out no longer count.

*Robust estimate.* The robust standard deviation is the root mean square distance of the possible soils from
the filter's mean, combined with the filter's own. Another root far away, evidence for another soil, and lack
of information all widen it. The robust flag is up while the filter's own flag is up and this standard
deviation is below 15 % of n, as in `estimators.filters.augmented_ekf_bank`.

The ground is not known. In the paper's model slopes do nothing; in the full one an accelerometer on the
vehicle measures the forces of the wheels and no slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.models.imu_prediction import plant_with
from estimators.models.uncertain_half_car import ModelUncertainty, with_mass
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant, with_pressure
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import full_derivative
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.paper_vehicle import paper_derivative
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor
from offroad_env.simulation.simulator import plant_model
from offroad_env.world.terrain import flat

__all__ = [
    "NUISANCES",
    "EvidenceModel",
    "EvidenceSettings",
    "RobustPosterior",
    "evidence_model",
    "log_evidence",
    "model_evidence",
]

#: Nuisance parameters: logarithms of the factors of mass, moduli and speed, the lag of the steering [s], and
#: the biases of a_x, a_y [m/s^2] and yaw rate [rad/s].
MASS, STIFFNESS, LAG, SPEED, BIAS = range(5)
NUISANCES = 7
#: Channels that are compared: a_x, a_y, yaw rate, among those of the inertial unit.
_USED = (0, 1, 4)
_A_Z = 2
#: Nuisances that act on the motion; the biases act on the readings.
_ACTING = 4
#: What a small model predicts at an instant. All but the first are rates of its motion: side speed, yaw
#: rate, spins of the axles (which the paper's model lacks).
A_X, A_Y, YAW_ACC, SPIN_F, SPIN_R = range(5)
_PREDICTED = 5
#: First spin in the motion: side speed, yaw rate, spins.
_SPIN = 2
#: Share of a step that is implicit: the midpoint rule for the paper's motion, Euler's for stiff wheels.
_IMPLICIT = {"paper": 0.5, "full": 1.0}
#: Slip at which the uncertainty of slip sinkage is stated for wheels that have none of their own [-].
_SLIP = 0.15
_STEP = 1e-5  # of the one-sided differences
#: Slowest speed at which the motion is followed [m/s].
_SLOWEST = 0.5
#: Least load of the axles over the static one: wheels in the air give no information about the soil.
_LIGHTEST = 0.1
#: Distance in its logarithm at which a soil without a contact solution counts as impossible.
_IMPOSSIBLE = 1e6


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """Which soils, how uncertain the model is, and what the small model leaves out."""

    uncertainty: ModelUncertainty = field(
        default_factory=ModelUncertainty
    )  #: priors of the nuisance parameters
    soils: tuple[float, float] = (0.3, 1.3)  #: range of the grid [-], each soil as probable as the next
    count: int = 41  #: 0.025 apart
    samples: int = 5  #: of the inertial unit to a step: the motion turns within half a second
    memory: float = 20.0  #: in which evidence fades [s]: a new soil is trusted again after some 13 s
    speed: float = 0.05  #: uncertainty of the logarithm of the speed's factor [-]
    #: What the small model leaves out, per channel [m/s^2, m/s^2, rad/s], and how long it lasts [s]: load
    #: that rocks between the axles turns a vehicle in deep bends by 0.1 rad/s for half a second. With half
    #: of it the truth of such a drive lies outside of the 95 % interval for 3 % of the time instead of 0.2 %.
    error: tuple[float, float, float] = (0.1, 0.15, 0.03)
    error_time: float = 0.3
    noise: tuple[float, float, float] = (0.2, 0.2, 0.0175)  #: of the sensors a sample, the paper's
    widest: float = 0.15  #: largest robust standard deviation of a trusted estimate, as a share of n

    def __post_init__(self) -> None:
        if not 0.05 < self.soils[0] < self.soils[1] <= 2.5:
            raise InvalidParameter(f"soils must be 0.05 < low < high <= 2.5, got {self.soils}")
        if not (3 <= self.count <= 200 and 1 <= self.samples <= 100):
            raise InvalidParameter(
                f"count must be in [3, 200] and samples in [1, 100], got {self.count} and {self.samples}"
            )
        for name in ("memory", "speed", "error", "error_time", "widest"):
            values = getattr(self, name)
            if not all(value > 0.0 for value in (values if isinstance(values, tuple) else (values,))):
                raise InvalidParameter(f"{name} must be > 0, got {values}")
        if not min(self.noise) >= 0.0:
            raise InvalidParameter(f"noise must be >= 0, got {self.noise}")


class EvidenceModel(NamedTuple):
    """What the kernels need besides the drive."""

    plant: Plant
    full: bool  #: of the full model, with wheels that turn by torque
    implicit: float  #: share of a step
    dt: float  #: of a step [s]
    n: np.ndarray  #: (G,) the soils [-]
    stiffness: np.ndarray  #: (G,) expected logarithm of the moduli's factor: half of slip sinkage [-]
    P: np.ndarray  #: (G, NUISANCES) prior variances of the nuisances
    R: np.ndarray  #: (3,) variances of a step's mean reading
    kept: float  #: share of the evidence that a step keeps [-]


def evidence_model(plant: Plant, dt: float, settings: EvidenceSettings) -> EvidenceModel:
    """The kernels' view of a plant and of its uncertainty; ``dt`` [s] between samples.

    Raises
    ------
    InvalidParameter
        For a plant on hard ground.
    """
    if plant.soil.rigid > 0.5:
        raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
    kind, priors, n = plant_model(plant), settings.uncertainty, np.linspace(*settings.soils, settings.count)
    sinks = math.log(lyasko_sinkage_factor(plant.slip if kind == "paper" else _SLIP))
    step = dt * settings.samples
    P = np.empty((settings.count, NUISANCES))
    P[:, MASS], P[:, LAG], P[:, SPEED] = priors.mass**2, priors.lag**2, settings.speed**2
    P[:, STIFFNESS] = priors.stiffness**2 + (n * priors.slip_sinkage[1] * sinks) ** 2
    P[:, BIAS : BIAS + 2] = priors.acceleration_bias**2 + (priors.misalignment * GRAVITY) ** 2
    P[:, BIAS + 2] = priors.rate_bias**2
    R = np.square(settings.noise) / settings.samples
    R += np.square(settings.error) * 2.0 * settings.error_time / step
    return EvidenceModel(
        # The measured acceleration stands for the ground; without springs each axle carries its load.
        plant=plant._replace(ground=flat(), half_car=0.0),
        full=kind == "full",
        implicit=_IMPLICIT[kind],
        dt=float(step),
        n=n,
        stiffness=-n * priors.slip_sinkage[0] * sinks,
        P=P,
        R=R,
        kept=math.exp(-step / settings.memory),
    )


class _Hypothesis(NamedTuple):
    """One soil, and one value of the nuisances that change the forces."""

    n: float  #: [-]
    mass: float  #: logarithm of the mass's factor [-]
    stiffness: float  #: logarithm of the moduli's factor [-]


class _Motion(NamedTuple):
    """Horizontal motion of the small model."""

    v_x: float  #: forward speed [m/s]
    q: np.ndarray  #: side speed [m/s], yaw rate, spins of the axles [rad/s]


class _Controls(NamedTuple):
    """What acts on the vehicle during a step."""

    steer: float  #: [rad]
    force: float  #: body force [N], in the full model drive torque [N m]
    brake: float  #: brake torque [N m]
    load: float  #: of the axles over the static one [-]


@kernel
def _predict(
    model: EvidenceModel,
    soil: _Hypothesis,
    motion: _Motion,
    controls: _Controls,
    warm: np.ndarray,
    predicted: np.ndarray,
) -> float:
    """What a soil's small model predicts at an instant into ``predicted`` (5,); the contact status."""
    load, plant, q = controls.load, model.plant, motion.q
    own = plant_with(
        plant,
        with_mass(plant.vehicle, math.exp(soil.mass) * load),
        with_pressure(plant.soil, soil.n, math.exp(soil.stiffness)),
    )
    x, rates, readings = np.zeros(at.STATE_SIZE), np.zeros(at.STATE_SIZE), np.empty(at.READINGS_SIZE)
    x[at.V_X], x[at.V_Y], x[at.YAW_RATE] = motion.v_x, q[0], q[1]
    predicted[SPIN_F] = predicted[SPIN_R] = 0.0
    if model.full:
        x[at.OMEGA_F], x[at.OMEGA_R] = q[_SPIN], q[_SPIN + 1]
        x[at.STEER], x[at.DRIVE], x[at.BRAKE] = controls.steer, controls.force, controls.brake
        full_derivative(x, (controls.steer, controls.force, controls.brake), own, warm, rates, readings)
        predicted[SPIN_F], predicted[SPIN_R] = rates[at.OMEGA_F], rates[at.OMEGA_R]
    else:
        paper_derivative(x, (controls.steer, controls.force, math.nan), own, warm, rates, readings)
    # A vehicle of the load's weight has the axles' forces; the mass that they move is not heavier.
    predicted[A_X], predicted[A_Y] = readings[at.A_X] * load, readings[at.A_Y] * load
    predicted[YAW_ACC] = readings[at.YAW_ACC]
    return float(readings[at.STATUS])


@kernel
def _slopes(
    model: EvidenceModel,
    g: int,
    motion: _Motion,
    controls: _Controls,
    rate: float,
    warm: np.ndarray,
    predicted: np.ndarray,
    J: np.ndarray,
) -> float:
    """Prediction of soil ``g`` (5,), its slopes ``J`` (5, M + 4) with motion and nuisances; contact status.

    ``rate`` [rad/s] is the steering's.
    """
    M, stiffness = motion.q.shape[0], model.stiffness[g]
    worst = _predict(model, _Hypothesis(model.n[g], 0.0, stiffness), motion, controls, warm, predicted)
    trial, other = np.empty((warm.shape[0], warm.shape[1])), np.empty(_PREDICTED)
    for j in range(M + _ACTING):
        step, moved = np.zeros(_ACTING), motion.q.copy()
        if j < M:
            moved[j] += _STEP
        else:
            step[j - M] = _STEP
        trial[:] = warm
        status = _predict(
            model,
            _Hypothesis(model.n[g], step[MASS], stiffness + step[STIFFNESS]),
            _Motion(motion.v_x * (1.0 + step[SPEED]), moved),
            _Controls(controls.steer - step[LAG] * rate, controls.force, controls.brake, controls.load),
            trial,
            other,
        )
        worst = max(worst, status)
        J[:, j] = (other - predicted) / _STEP
    return worst


@kernel
def _advance(
    model: EvidenceModel, v_x: float, predicted: np.ndarray, J: np.ndarray, q: np.ndarray, S: np.ndarray
) -> None:
    """Integrate the motion ``q`` (M,) and its slopes with the nuisances ``S`` (M, 4) over a step, in place.

    Linearly implicit: at walking pace tyres answer within hundredths of a second, wheels within less.
    """
    M = q.shape[0]
    A, f = J[1 : 1 + M, :M].copy(), np.empty((M, 1 + _ACTING))
    A[0, 1] -= v_x
    f[:, 0] = predicted[1 : 1 + M]
    f[:, 1:] = J[1 : 1 + M, M:] + A @ S
    f[0, 0] -= v_x * q[1]
    f[0, 1 + SPEED] -= v_x * q[1]
    moved = np.linalg.solve(np.eye(M) - model.implicit * model.dt * A, model.dt * f)
    q += moved[:, 0]
    S += moved[:, 1:]


@kernel
def log_evidence(N: np.ndarray, s: np.ndarray, c: float, P: np.ndarray) -> float:
    """Logarithm of the evidence for a linear model whose parameters have the prior variances ``P`` (D,).

    With residuals e, slopes H and variances R: N = sum H' H/R (D, D), s = sum H' e/R, c = sum e^2/R.
    """
    L = np.linalg.cholesky(N + np.diag(1.0 / P))
    y = np.linalg.solve(L, s)
    total = -0.5 * (c - float(y @ y))
    for j in range(P.shape[0]):
        total -= math.log(L[j, j]) + 0.5 * math.log(P[j])
    return total


@kernel
def _compare(
    measured: np.ndarray,
    predicted: np.ndarray,
    q: np.ndarray,
    J: np.ndarray,
    S: np.ndarray,
    R: np.ndarray,
    N: np.ndarray,
    s: np.ndarray,
) -> float:
    """Take ``measured`` (3,), NaN for nothing, into ``N`` and ``s``, in place; returns what c gains."""
    M, H, gained = q.shape[0], np.zeros((3, NUISANCES)), 0.0
    H[:2, :_ACTING] = J[:2, M:] + J[:2, :M].copy() @ S
    H[2, :_ACTING] = S[1]
    for i in range(3):
        H[i, BIAS + i] = 1.0
        e = measured[i] - (predicted[i] if i < 2 else q[1])
        if math.isfinite(e):
            gained += e * e / R[i]
            s += H[i] * (e / R[i])
            N += np.outer(H[i], H[i]) / R[i]
    return gained


class _Steps(NamedTuple):
    """The drive, averaged over the steps of the small model."""

    steer: np.ndarray  #: (K,) [rad]
    force: np.ndarray  #: (K,) body force [N] or drive torque [N m]
    brake: np.ndarray  #: (K,) brake torque [N m]
    load: np.ndarray  #: (K,) of the axles over the static one [-]
    rate: np.ndarray  #: (K,) of the steering [rad/s]
    speed: np.ndarray  #: (K,) [m/s]
    measured: np.ndarray  #: (K, 3) a_x, a_y [m/s^2], yaw rate [rad/s]


@kernel
def _run(model: EvidenceModel, steps: _Steps, logs: np.ndarray) -> None:
    """Logarithms of the evidence for every soil after every step into ``logs`` (K, G)."""
    G, M = model.n.shape[0], _PREDICTED - 1 if model.full else _SPIN
    q, S, warms = np.zeros((G, M)), np.zeros((G, M, _ACTING)), np.zeros((G, 2, 3))
    N, s, c = np.zeros((G, NUISANCES, NUISANCES)), np.zeros((G, NUISANCES)), np.zeros(G)
    predicted, J = np.empty(_PREDICTED), np.empty((_PREDICTED, M + _ACTING))
    q[:, _SPIN:] = steps.speed[0] / model.plant.vehicle.r  # the wheels roll
    for k in range(steps.speed.shape[0]):
        controls = _Controls(steps.steer[k], steps.force[k], steps.brake[k], steps.load[k])
        rate, v_x = steps.rate[k], max(steps.speed[k], _SLOWEST)
        for g in range(G):
            N[g] *= model.kept
            s[g] *= model.kept
            c[g] *= model.kept
            status = _slopes(model, g, _Motion(v_x, q[g]), controls, rate, warms[g], predicted, J)
            if status < SUNK and np.isfinite(predicted).all() and np.isfinite(J).all():
                c[g] += _compare(steps.measured[k], predicted, q[g], J, S[g], model.R, N[g], s[g])
                _advance(model, v_x, predicted, J, q[g], S[g])
            else:
                c[g] += _IMPOSSIBLE
                q[g], S[g], warms[g] = 0.0, 0.0, 0.0
                q[g, _SPIN:] = v_x / model.plant.vehicle.r
            logs[k, g] = log_evidence(N[g], s[g], c[g], model.P[g])


@dataclass(frozen=True, kw_only=True)
class RobustPosterior:
    """Probability of each soil with the model uncertain. Row k belongs to the k-th sample."""

    n: np.ndarray  #: (G,) the soils [-]
    weights: np.ndarray  #: (T, G) probability of each [-]
    widest: float  #: see `EvidenceSettings`

    @property
    def mean(self) -> np.ndarray:
        """(T,) of n [-]"""
        return np.asarray(self.weights @ self.n)

    @property
    def sd(self) -> np.ndarray:
        """(T,) standard deviation of n [-]"""
        return self.distance(self.mean)

    def distance(self, n: np.ndarray) -> np.ndarray:
        """(T,) root mean square distance of the possible soils from ``n`` (T,) [-]."""
        return np.asarray(np.sqrt(np.sum(self.weights * np.square(self.n - n[:, None]), axis=1)))

    def robust(self, n: np.ndarray, sd: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Robust standard deviation (T,) [-] of a filter's estimate, and its robust validity flag (T,).

        Parameters
        ----------
        n, sd : arrays (T,)
            The filter's mean and standard deviation, given its model [-].
        valid : array (T,)
            The filter's own validity flag.
        """
        wide = np.hypot(sd, self.distance(n))
        return wide, valid & (wide <= self.widest * n)


def model_evidence(
    plant: Plant,
    settings: EvidenceSettings,
    inputs: np.ndarray,
    imu: np.ndarray,
    speed: np.ndarray,
    dt: float,
) -> RobustPosterior:
    """Probability of each soil along a drive, with the model uncertain.

    Parameters
    ----------
    plant : Plant
        The filter's own model, the paper's or the full one; its n and its ground are not used.
    settings : EvidenceSettings
    inputs : array (2 T - 1, 3)
        Commands at every half step: (steer [rad], F_u [N], NaN), in the full model (steer [rad], drive
        and brake torque [N m]).
    imu : array (T, 5)
        a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s] at the centre of gravity, without gravity,
        NaN = not measured; row 0 is not used.
    speed : array (T,)
        Forward speed, estimated by the filter or measured [m/s].
    dt : float
        Between samples [s].

    Raises
    ------
    InvalidParameter
        As `evidence_model`, and for arrays that do not belong together.
    """
    T, m = len(imu), settings.samples
    if inputs.shape != (2 * T - 1, 3) or len(speed) != T:
        raise InvalidParameter(
            f"imu has {T} rows, so inputs must be ({2 * T - 1}, 3) (half steps) and speed ({T},), "
            f"got {inputs.shape} and {speed.shape}"
        )
    model = evidence_model(plant, dt, settings)
    acting = _actuators(plant, inputs, dt) if model.full else inputs
    steps = _steps(acting, imu, speed, m, dt)
    logs = np.empty((len(steps.speed), settings.count))
    if len(logs):
        _run(model, steps, logs)
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    weights = np.vstack([np.ones((1, settings.count)), weights])  # nothing is known before the first step
    weights /= weights.sum(axis=1, keepdims=True)
    # The weights hold until the next step.
    return RobustPosterior(n=model.n, weights=weights[np.arange(T) // m], widest=settings.widest)


def _actuators(plant: Plant, commands: np.ndarray, dt: float) -> np.ndarray:
    """State of steering, drive and brake (2 T - 1, 3) under commands at every half step."""
    vehicle, acting = plant.vehicle, commands.copy()
    lags = np.maximum([vehicle.steer_lag, vehicle.torque_lag, vehicle.torque_lag], 1e-6)
    kept = np.exp(-0.5 * dt / lags)
    for k in range(1, len(acting)):
        acting[k] = commands[k] + kept * (acting[k - 1] - commands[k])
    return acting


def _steps(inputs: np.ndarray, imu: np.ndarray, speed: np.ndarray, samples: int, dt: float) -> _Steps:
    """Means of a drive over steps of ``samples``; a rest that fills no step is left out."""
    rows = [
        _step(inputs[2 * (k - samples) : 2 * k + 1], imu[k - samples + 1 : k + 1], dt)
        for k in range(samples, len(imu), samples)
    ]
    columns = np.array(rows).reshape(-1, 8)
    count = len(columns)
    means = speed[1 : count * samples + 1].reshape(count, samples).mean(axis=1)
    steer, force, brake, load, rate = np.ascontiguousarray(columns[:, :5].T)
    return _Steps(steer, force, brake, load, rate, means, np.ascontiguousarray(columns[:, 5:]))


def _step(inputs: np.ndarray, imu: np.ndarray, dt: float) -> tuple[float, ...]:
    """Means over the samples of a step: steer, force, brake, load, steering rate, a_x, a_y, yaw rate."""
    rate = (inputs[-1, 0] - inputs[0, 0]) / (len(imu) * dt)
    present = imu[np.isfinite(imu).all(axis=1)]
    mean = present.mean(axis=0) if len(present) else np.full(imu.shape[1], math.nan)
    # The axles carry what the body's vertical acceleration asks for.
    load = 1.0 + mean[_A_Z] / GRAVITY if len(present) else 1.0
    return (*inputs[1:].mean(axis=0), max(load, _LIGHTEST), rate, *mean[list(_USED)])
