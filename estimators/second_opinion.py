"""What an estimate of n is worth to somebody who doubts the model that it was made with.

A filter that believes its model exactly - mass, moduli, sensors, steering - reads whatever is wrong
in it as another soil, and is certain of that: its innovations look right, since on straight clay a
wrong mass *is* another n. Its standard deviation and its flag hold *given the model*. This module
tells what else would explain the drive once the model may be wrong by as much as a careful engineer
would state beforehand (`nuisances.Doubt`).

*The opinion.* Every soil of a grid over n gets a small model of the horizontal motion: side speed
and yaw rate under the vehicle's own force laws, axles loaded by the vertical acceleration that was
felt and settled on that soil, at the speed that the filter believes in. What it predicts for a_x, a_y
and yaw rate is compared with what was felt. Seven doubts are not known and are not chosen either:
mass, moduli (with slip sinkage), steering lag, speed, a bias of each channel (misalignment, which
feels gravity, included). They act linearly, through the motion as well, with the stated priors, so
they integrate out exactly (D. V. Lindley & A. F. M. Smith, J. R. Stat. Soc. B 34, 1972): what
remains is the evidence for each soil, and soils that the data cannot tell apart share it. A consider
covariance (S. F. Schmidt, NASA TN D-3300, 1966) holds to first order about the filter's own estimate;
this sees every root of the force, and doubts that the innovations rule out no longer count.

*What becomes of the estimate.* Its standard deviation in doubt is the root mean square distance of
the soils that remain possible from the filter's mean, together with the filter's own. Another root
far away, an opinion that differs, and plain ignorance all widen it. The estimate is trusted while
the filter vouches for it and this is below 15 % of n, as `estimators.robust` asks.

It knows the paper's model only, whose wheels slip by a constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.nuisances import Doubt, slip_sinkage, with_mass
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.paper_model import paper_derivative
from offroad_env.physics.vehicle_model import Plant, with_pressure
from offroad_env.simulator import plant_model
from offroad_env.terrain import flat

__all__ = [
    "DOUBTS",
    "Opinion",
    "OpinionModel",
    "OpinionSettings",
    "evidence",
    "form_opinion",
    "opinion_model",
]

#: What is in doubt: logarithms of the factors of mass, moduli and speed, the lag of the steering [s], and
#: the biases of a_x, a_y [m/s^2] and yaw rate [rad/s].
MASS, STIFFNESS, LAG, SPEED, BIAS = range(5)
DOUBTS = 7
#: Channels that are compared: a_x, a_y, yaw rate, among those of the inertial unit.
_USED = (0, 1, 4)
_A_Z = 2
#: Columns of the slopes of (a_x, a_y, yaw acceleration): side speed, yaw rate, then four doubts.
_MOTION, _ACTING = 2, 4
_STEP = 1e-5  # of the one-sided differences
#: Slowest speed at which the motion is followed [m/s].
_SLOWEST = 0.5
#: Least load of the axles over the static one: wheels in the air tell nothing of the soil.
_LIGHTEST = 0.1
#: Distance in its logarithm at which a soil without a contact solution counts as impossible.
_IMPOSSIBLE = 1e6


@dataclass(frozen=True, kw_only=True)
class OpinionSettings:
    """Which soils, which doubts, and what the small model leaves out."""

    doubt: Doubt = field(default_factory=Doubt)
    soils: tuple[float, float] = (0.3, 1.3)  #: where they stand [-], each as probable as the next
    count: int = 41  #: 0.025 apart
    samples: int = 5  #: of the inertial unit to a step: the motion turns within half a second
    memory: float = 20.0  #: in which evidence fades [s]: a new soil is trusted again after some 13 s
    speed: float = 0.05  #: doubt of the logarithm of the speed's factor [-]
    #: What the small model leaves out, per channel [m/s^2, m/s^2, rad/s], and how long it lasts [s]: load
    #: that rocks between the axles turns a vehicle in deep bends by 0.1 rad/s for half a second. With half
    #: of it the truth of such a drive lies outside of the 95 % interval for 3 % of the time instead of 0.2 %.
    error: tuple[float, float, float] = (0.1, 0.15, 0.03)
    error_time: float = 0.3
    noise: tuple[float, float, float] = (0.2, 0.2, 0.0175)  #: of the sensors a sample, the paper's
    widest: float = 0.15  #: largest standard deviation in doubt of a trusted estimate, as a share of n

    def __post_init__(self) -> None:
        if not 0.05 < self.soils[0] < self.soils[1] <= 2.5:
            raise InvalidParameter(f"soils must be 0.05 < low < high <= 2.5, got {self.soils}")
        if not (3 <= self.count <= 200 and 1 <= self.samples <= 100):
            raise InvalidParameter(
                f"count must be in [3, 200] and samples in [1, 100], got {self.count} and {self.samples}"
            )
        for name in ("memory", "speed", "error", "error_time", "noise", "widest"):
            values = getattr(self, name)
            if not all(value > 0.0 for value in (values if isinstance(values, tuple) else (values,))):
                raise InvalidParameter(f"{name} must be > 0, got {values}")


class OpinionModel(NamedTuple):
    """What the kernels need besides the drive."""

    plant: Plant
    dt: float  #: of a step [s]
    n: np.ndarray  #: (G,) the soils [-]
    stiffness: np.ndarray  #: (G,) expected logarithm of the moduli's factor: half of slip sinkage [-]
    P: np.ndarray  #: (G, DOUBTS) variances of the doubts
    R: np.ndarray  #: (3,) variances of a step's mean reading
    kept: float  #: share of the evidence that a step keeps [-]


def opinion_model(plant: Plant, dt: float, settings: OpinionSettings) -> OpinionModel:
    """The kernels' view of a plant and of what is in doubt about it; ``dt`` [s] between samples.

    Raises
    ------
    InvalidParameter
        For a plant that is not the paper's, or stands on hard ground.
    """
    if plant_model(plant) != "paper" or plant.soil.rigid > 0.5:
        raise InvalidParameter("a second opinion needs the paper's model on deformable soil")
    doubt, n = settings.doubt, np.linspace(*settings.soils, settings.count)
    sinks, step = math.log(slip_sinkage(plant.slip)), dt * settings.samples
    P = np.empty((settings.count, DOUBTS))
    P[:, MASS], P[:, LAG], P[:, SPEED] = doubt.mass**2, doubt.lag**2, settings.speed**2
    P[:, STIFFNESS] = doubt.stiffness**2 + (n * doubt.slip_sinkage[1] * sinks) ** 2
    P[:, BIAS : BIAS + 2] = doubt.acceleration_bias**2 + (doubt.misalignment * GRAVITY) ** 2
    P[:, BIAS + 2] = doubt.rate_bias**2
    R = np.square(settings.noise) / settings.samples
    R += np.square(settings.error) * 2.0 * settings.error_time / step
    return OpinionModel(
        # The ground is felt, not read from a map; without springs each axle carries what it is given.
        plant=plant._replace(ground=flat(), half_car=0.0),
        dt=float(step),
        n=n,
        stiffness=-n * doubt.slip_sinkage[0] * sinks,
        P=P,
        R=R,
        kept=math.exp(-step / settings.memory),
    )


@kernel
def _accelerations(model, belief, motion, drive, warm, readings):
    """(a_x, a_y, yaw acceleration, contact status) of one soil.

    ``belief`` = (n, log factors of mass and moduli), ``motion`` = (v_x, v_y, yaw rate), ``drive`` =
    (steer, F_u, load of the axles over the static one).
    """
    n, mass, stiffness = belief
    plant, load = model.plant, drive[2]
    own = Plant(
        with_mass(plant.vehicle, math.exp(mass) * load),
        with_pressure(plant.soil, n, math.exp(stiffness)),
        plant.ground,
        plant.soil_map,
        plant.slip,
        plant.resultant,
        plant.half_car,
        plant.v_eps,
        plant.fine,
        plant.effects,
    )
    x, rates = np.zeros(at.YAW_RATE + 1), np.empty(at.YAW_RATE + 1)
    x[at.V_X], x[at.V_Y], x[at.YAW_RATE] = motion
    paper_derivative(x, (drive[0], drive[1], math.nan), own, warm, rates, readings)
    # A vehicle of the load's weight has the axles' forces; the mass that they move is not heavier.
    a_x, a_y = readings[at.A_X] * load, readings[at.A_Y] * load
    return a_x, a_y, readings[at.YAW_ACC], readings[at.STATUS]


@kernel
def _slopes(model, g, motion, drive, rate, warm, y, J):
    """Accelerations ``y`` (3,) of soil ``g`` and their slopes ``J`` (3, 6); returns the contact status.

    Columns: side speed, yaw rate, mass, stiffness, lag, speed; ``rate`` [rad/s] is the steering's.
    """
    readings, trial = np.empty(at.READINGS_SIZE), np.empty((2, 3))
    v_x, v_y, yaw_rate = motion
    soil = (model.n[g], 0.0, model.stiffness[g])
    y[0], y[1], y[2], worst = _accelerations(model, soil, motion, drive, warm, readings)
    for j in range(_MOTION + _ACTING):
        step = np.zeros(_MOTION + _ACTING)
        step[j] = _STEP
        there = (v_x * (1.0 + step[_MOTION + SPEED]), v_y + step[0], yaw_rate + step[1])
        other = (soil[0], step[_MOTION + MASS], soil[2] + step[_MOTION + STIFFNESS])
        turned = (drive[0] - step[_MOTION + LAG] * rate, drive[1], drive[2])
        trial[:] = warm
        a_x, a_y, yaw_acc, status = _accelerations(model, other, there, turned, trial, readings)
        worst = max(worst, status)
        J[0, j], J[1, j], J[2, j] = (a_x - y[0]) / _STEP, (a_y - y[1]) / _STEP, (yaw_acc - y[2]) / _STEP
    return worst


@kernel
def _advance(v_x, y, J, q, S, dt):
    """Carry (v_y, yaw rate) ``q`` and its slopes with the doubts ``S`` (2, 4) over a step, in place.

    Linearly implicit midpoint rule: at walking pace the tyres answer within hundredths of a second.
    """
    A = np.empty((2, 2))
    A[0, 0], A[0, 1], A[1, 0], A[1, 1] = J[1, 0], J[1, 1] - v_x, J[2, 0], J[2, 1]
    f = np.empty((2, 1 + _ACTING))
    f[0, 0], f[1, 0] = y[1] - v_x * q[1], y[2]
    for j in range(_ACTING):
        f[0, 1 + j] = A[0, 0] * S[0, j] + A[0, 1] * S[1, j] + J[1, _MOTION + j]
        f[1, 1 + j] = A[1, 0] * S[0, j] + A[1, 1] * S[1, j] + J[2, _MOTION + j]
    f[0, 1 + SPEED] -= v_x * q[1]
    moved = np.linalg.solve(np.eye(2) - 0.5 * dt * A, dt * f)
    q += moved[:, 0]
    S += moved[:, 1:]


@kernel
def evidence(N, s, c, P):
    """Logarithm of the evidence for a linear model whose doubts have the prior variances ``P`` (D,).

    With residuals e, slopes H and variances R: N = sum H' H/R (D, D), s = sum H' e/R, c = sum e^2/R.
    """
    L = np.linalg.cholesky(N + np.diag(1.0 / P))
    y = np.linalg.solve(L, s)
    total = -0.5 * (c - y @ y)
    for j in range(P.shape[0]):
        total -= math.log(L[j, j]) + 0.5 * math.log(P[j])
    return total


@kernel
def _compare(seen, y, q, J, S, R, N, s):
    """Take what was ``seen`` (3,), NaN for nothing, into ``N`` and ``s``, in place; returns what c gains."""
    H, added = np.zeros((3, DOUBTS)), 0.0
    for j in range(_ACTING):
        for i in range(2):
            H[i, j] = J[i, _MOTION + j] + J[i, 0] * S[0, j] + J[i, 1] * S[1, j]
        H[2, j] = S[1, j]
    for i in range(3):
        H[i, BIAS + i] = 1.0
        e = seen[i] - (y[i] if i < 2 else q[1])
        if not math.isfinite(e):
            continue
        added += e * e / R[i]
        s += H[i] * (e / R[i])
        N += np.outer(H[i], H[i]) / R[i]
    return added


@kernel
def _run(model, steps, logs):
    """Logarithms of the evidence for every soil after every step into ``logs`` (K, G).

    ``steps`` (K, 8): steer, F_u, rate of the steering, speed, load, a_x, a_y, yaw rate.
    """
    G = model.n.shape[0]
    q, S, warms = np.zeros((G, 2)), np.zeros((G, 2, _ACTING)), np.zeros((G, 2, 3))
    N, s, c = np.zeros((G, DOUBTS, DOUBTS)), np.zeros((G, DOUBTS)), np.zeros(G)
    y, J = np.empty(3), np.empty((3, _MOTION + _ACTING))
    for k in range(steps.shape[0]):
        steer, force, rate, speed, load = steps[k, :5]
        v_x = max(speed, _SLOWEST)
        for g in range(G):
            N[g] *= model.kept
            s[g] *= model.kept
            c[g] *= model.kept
            motion = (v_x, q[g, 0], q[g, 1])
            status = _slopes(model, g, motion, (steer, force, load), rate, warms[g], y, J)
            if status < SUNK and np.isfinite(y).all() and np.isfinite(J).all():
                c[g] += _compare(steps[k, 5:], y, q[g], J, S[g], model.R, N[g], s[g])
                _advance(v_x, y, J, q[g], S[g], model.dt)
            else:
                c[g] += _IMPOSSIBLE
                q[g], S[g], warms[g] = 0.0, 0.0, 0.0
            logs[k, g] = evidence(N[g], s[g], c[g], model.P[g])


@dataclass(frozen=True, kw_only=True)
class Opinion:
    """What a drive says about n to somebody who doubts the model. Row k belongs to the k-th sample."""

    n: np.ndarray  #: (G,) the soils [-]
    weights: np.ndarray  #: (T, G) how probable each is [-]
    widest: float  #: see `OpinionSettings`

    @property
    def mean(self) -> np.ndarray:
        """(T,) of n [-]"""
        return self.weights @ self.n

    @property
    def sd(self) -> np.ndarray:
        """(T,) standard deviation of n [-]"""
        return self.distance(self.mean)

    def distance(self, n: np.ndarray) -> np.ndarray:
        """(T,) root mean square distance of the soils that remain possible from ``n`` (T,) [-]."""
        return np.sqrt(np.sum(self.weights * np.square(self.n - n[:, None]), axis=1))

    def doubted(self, n: np.ndarray, sd: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation in doubt (T,) [-] of a filter's estimate, and whether it is trusted (T,).

        Parameters
        ----------
        n, sd : arrays (T,)
            The filter's mean and standard deviation, given its model [-].
        valid : array (T,)
            Whether it vouches for them.
        """
        wide = np.hypot(sd, self.distance(n))
        return wide, valid & (wide <= self.widest * n)


def form_opinion(
    plant: Plant,
    settings: OpinionSettings,
    inputs: np.ndarray,
    imu: np.ndarray,
    speed: np.ndarray,
    dt: float,
) -> Opinion:
    """Form an opinion along a drive.

    Parameters
    ----------
    plant : Plant
        The filter's own model, of the paper's kind; its n and its ground are not used.
    settings : OpinionSettings
    inputs : array (2 T - 1, 3)
        (steer [rad], F_u [N], NaN) at every half step.
    imu : array (T, 5)
        a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s], NaN = not measured; row 0 is not used.
    speed : array (T,)
        Forward speed that the filter believes in, or that is measured [m/s].
    dt : float
        Between samples [s].

    Raises
    ------
    InvalidParameter
        As `opinion_model`, and for arrays that do not belong together.
    """
    T, m = len(imu), settings.samples
    if inputs.shape != (2 * T - 1, 3) or len(speed) != T:
        raise InvalidParameter(
            f"imu has {T} rows, so inputs must be ({2 * T - 1}, 3) (half steps) and speed ({T},), "
            f"got {inputs.shape} and {speed.shape}"
        )
    model = opinion_model(plant, dt, settings)
    ends = np.arange(m, T, m)
    steps = np.array([_step(inputs[2 * (k - m) : 2 * k + 1], imu[k - m + 1 : k + 1], dt) for k in ends])
    steps = np.column_stack([steps[:, :3], [speed[k - m + 1 : k + 1].mean() for k in ends], steps[:, 3:]])
    logs = np.empty((len(steps), settings.count))
    _run(model, np.ascontiguousarray(steps), logs)
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    weights = np.vstack([np.ones((1, settings.count)), weights])  # nothing is known before the first step
    weights /= weights.sum(axis=1, keepdims=True)
    # An opinion holds until the next one.
    return Opinion(n=model.n, weights=weights[np.arange(T) // m], widest=settings.widest)


def _step(inputs: np.ndarray, imu: np.ndarray, dt: float) -> tuple[float, ...]:
    """(steer, F_u, rate of the steering, load, a_x, a_y, yaw rate): means over the samples of a step."""
    rate = (inputs[-1, 0] - inputs[0, 0]) / (len(imu) * dt)
    present = imu[np.isfinite(imu).all(axis=1)]
    felt = present.mean(axis=0) if len(present) else np.full(imu.shape[1], math.nan)
    # The axles carry what the body feels.
    load = 1.0 + felt[_A_Z] / GRAVITY if len(present) else 1.0
    return (*inputs[1:, :2].mean(axis=0), rate, max(load, _LIGHTEST), *felt[list(_USED)])
