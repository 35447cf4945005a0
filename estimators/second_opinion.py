"""What an estimate of n is worth to somebody who doubts the model that it was made with.

A filter that believes its model exactly - mass, moduli, sensors, steering - reads whatever is wrong
in it as another soil, and is certain of that: its innovations look right, since on straight clay a
wrong mass *is* another n. Its standard deviation and its flag hold *given the model*. This module
tells what else would explain the drive once the model may be wrong by as much as a careful engineer
would state beforehand (`nuisances.Doubt`).

*The opinion.* Every soil of a grid over n gets a small model of the horizontal motion: side speed,
yaw rate and, where torque drives the wheels, their spin, under the vehicle's own force laws, axles
loaded by the vertical acceleration that was felt and settled on that soil, at the speed that the
filter believes in. What it predicts for a_x, a_y and yaw rate is compared with what was felt. Seven
doubts are not known and are not chosen either: mass, moduli (with slip sinkage), steering lag, speed,
a bias of each channel (misalignment, which feels gravity, included). They act linearly, through the
motion as well, with the stated priors, so they integrate out exactly (D. V. Lindley & A. F. M. Smith,
J. R. Stat. Soc. B 34, 1972): what remains is the evidence for each soil, and soils that the data
cannot tell apart share it. A consider covariance (S. F. Schmidt, NASA TN D-3300, 1966) holds to first
order about the filter's own estimate; this sees every root of the force, and doubts that the
innovations rule out no longer count.

*What becomes of the estimate.* Its standard deviation in doubt is the root mean square distance of
the soils that remain possible from the filter's mean, together with the filter's own. Another root
far away, an opinion that differs, and plain ignorance all widen it. The estimate is trusted while
the filter vouches for it and this is below 15 % of n, as `estimators.robust` asks.

The ground is not known. In the paper's model slopes do nothing; in the full one an accelerometer that
hangs on the vehicle feels the wheels' forces and no slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.models import plant_with
from estimators.nuisances import Doubt, slip_sinkage, with_mass
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import full_derivative
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
#: Doubts that act on the motion; the biases act on the readings.
_ACTING = 4
#: What a small model says of an instant: a_x, a_y, yaw acceleration, and the axles' spin accelerations.
#: All but the first are rates of its motion: side speed, yaw rate, spins (which the paper's model lacks).
_SAID = 5
_SPIN = 2
#: Share of a step that is implicit: the midpoint rule for the paper's motion, Euler's for stiff wheels.
_IMPLICIT = {"paper": 0.5, "full": 1.0}
#: Slip at which doubt about slip sinkage is stated for wheels that have none of their own [-].
_SLIP = 0.15
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
        for name in ("memory", "speed", "error", "error_time", "widest"):
            values = getattr(self, name)
            if not all(value > 0.0 for value in (values if isinstance(values, tuple) else (values,))):
                raise InvalidParameter(f"{name} must be > 0, got {values}")
        if not min(self.noise) >= 0.0:
            raise InvalidParameter(f"noise must be >= 0, got {self.noise}")


class OpinionModel(NamedTuple):
    """What the kernels need besides the drive."""

    plant: Plant
    full: bool  #: of the full model, with wheels that turn by torque
    implicit: float  #: share of a step
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
        For a plant on hard ground.
    """
    if plant.soil.rigid > 0.5:
        raise InvalidParameter("the plant must stand on deformable soil: hard ground has no n")
    kind, doubt, n = plant_model(plant), settings.doubt, np.linspace(*settings.soils, settings.count)
    sinks = math.log(slip_sinkage(plant.slip if kind == "paper" else _SLIP))
    step = dt * settings.samples
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
        full=kind == "full",
        implicit=_IMPLICIT[kind],
        dt=float(step),
        n=n,
        stiffness=-n * doubt.slip_sinkage[0] * sinks,
        P=P,
        R=R,
        kept=math.exp(-step / settings.memory),
    )


@kernel
def _say(model, belief, motion, drive, warm, said):
    """What the small model of a soil says of an instant into ``said`` (5,); returns the contact status.

    ``belief`` = (n, log factors of mass and moduli), ``motion`` = (v_x, (v_y, yaw rate, spins...)),
    ``drive`` = (steer, F_u or drive torque, brake torque, load of the axles over the static one).
    """
    n, mass, stiffness = belief
    v_x, q = motion
    steer, force, brake, load = drive
    plant = model.plant
    own = plant_with(
        plant,
        with_mass(plant.vehicle, math.exp(mass) * load),
        with_pressure(plant.soil, n, math.exp(stiffness)),
    )
    x, rates, readings = np.zeros(at.STATE_SIZE), np.zeros(at.STATE_SIZE), np.empty(at.READINGS_SIZE)
    x[at.V_X], x[at.V_Y], x[at.YAW_RATE] = v_x, q[0], q[1]
    said[3] = said[4] = 0.0
    if model.full:
        x[at.OMEGA_F], x[at.OMEGA_R] = q[_SPIN], q[_SPIN + 1]
        x[at.STEER], x[at.DRIVE], x[at.BRAKE] = steer, force, brake
        full_derivative(x, (steer, force, brake), own, warm, rates, readings)
        said[3], said[4] = rates[at.OMEGA_F], rates[at.OMEGA_R]
    else:
        paper_derivative(x, (steer, force, math.nan), own, warm, rates, readings)
    # A vehicle of the load's weight has the axles' forces; the mass that they move is not heavier.
    said[0], said[1], said[2] = readings[at.A_X] * load, readings[at.A_Y] * load, readings[at.YAW_ACC]
    return readings[at.STATUS]


@kernel
def _slopes(model, g, motion, drive, rate, warm, said, J):
    """What soil ``g`` says (5,) and its slopes ``J`` (5, M + 4) with motion and doubts; contact status.

    ``rate`` [rad/s] is the steering's.
    """
    v_x, q = motion
    soil, M = (model.n[g], 0.0, model.stiffness[g]), q.shape[0]
    worst = _say(model, soil, motion, drive, warm, said)
    trial, other = np.empty((2, 3)), np.empty(_SAID)
    for j in range(M + _ACTING):
        step, moved = np.zeros(_ACTING), q.copy()
        if j < M:
            moved[j] += _STEP
        else:
            step[j - M] = _STEP
        trial[:] = warm
        status = _say(
            model,
            (soil[0], step[MASS], soil[2] + step[STIFFNESS]),
            (v_x * (1.0 + step[SPEED]), moved),
            (drive[0] - step[LAG] * rate, drive[1], drive[2], drive[3]),
            trial,
            other,
        )
        worst = max(worst, status)
        J[:, j] = (other - said) / _STEP
    return worst


@kernel
def _advance(model, v_x, said, J, q, S):
    """Carry the motion ``q`` (M,) and its slopes with the doubts ``S`` (M, 4) over a step, in place.

    Linearly implicit: at walking pace tyres answer within hundredths of a second, wheels within less.
    """
    M = q.shape[0]
    A, f = J[1 : 1 + M, :M].copy(), np.empty((M, 1 + _ACTING))
    A[0, 1] -= v_x
    f[:, 0] = said[1 : 1 + M]
    f[:, 1:] = J[1 : 1 + M, M:] + A @ S
    f[0, 0] -= v_x * q[1]
    f[0, 1 + SPEED] -= v_x * q[1]
    moved = np.linalg.solve(np.eye(M) - model.implicit * model.dt * A, model.dt * f)
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
def _compare(seen, said, q, J, S, R, N, s):
    """Take what was ``seen`` (3,), NaN for nothing, into ``N`` and ``s``, in place; returns what c gains."""
    M, H, gained = q.shape[0], np.zeros((3, DOUBTS)), 0.0
    H[:2, :_ACTING] = J[:2, M:] + J[:2, :M].copy() @ S
    H[2, :_ACTING] = S[1]
    for i in range(3):
        H[i, BIAS + i] = 1.0
        e = seen[i] - (said[i] if i < 2 else q[1])
        if math.isfinite(e):
            gained += e * e / R[i]
            s += H[i] * (e / R[i])
            N += np.outer(H[i], H[i]) / R[i]
    return gained


@kernel
def _run(model, steps, logs):
    """Logarithms of the evidence for every soil after every step into ``logs`` (K, G).

    ``steps`` (K, 9): the drive of `_say`, rate of the steering, speed, and what was seen: a_x, a_y, yaw
    rate.
    """
    G, M = model.n.shape[0], _SAID - 1 if model.full else _SPIN
    q, S, warms = np.zeros((G, M)), np.zeros((G, M, _ACTING)), np.zeros((G, 2, 3))
    N, s, c = np.zeros((G, DOUBTS, DOUBTS)), np.zeros((G, DOUBTS)), np.zeros(G)
    said, J = np.empty(_SAID), np.empty((_SAID, M + _ACTING))
    q[:, _SPIN:] = steps[0, 5] / model.plant.vehicle.r  # the wheels roll
    for k in range(steps.shape[0]):
        drive = (steps[k, 0], steps[k, 1], steps[k, 2], steps[k, 3])
        rate, v_x = steps[k, 4], max(steps[k, 5], _SLOWEST)
        for g in range(G):
            N[g] *= model.kept
            s[g] *= model.kept
            c[g] *= model.kept
            status = _slopes(model, g, (v_x, q[g]), drive, rate, warms[g], said, J)
            if status < SUNK and np.isfinite(said).all() and np.isfinite(J).all():
                c[g] += _compare(steps[k, 6:], said, q[g], J, S[g], model.R, N[g], s[g])
                _advance(model, v_x, said, J, q[g], S[g])
            else:
                c[g] += _IMPOSSIBLE
                q[g], S[g], warms[g] = 0.0, 0.0, 0.0
                q[g, _SPIN:] = v_x / model.plant.vehicle.r
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
        The filter's own model, the paper's or the full one; its n and its ground are not used.
    settings : OpinionSettings
    inputs : array (2 T - 1, 3)
        Commands at every half step: (steer [rad], F_u [N], NaN), in the full model (steer [rad], drive
        and brake torque [N m]).
    imu : array (T, 5)
        a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s] at the centre of gravity, without gravity,
        NaN = not measured; row 0 is not used.
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
    acting = _actuators(plant, inputs, dt) if model.full else inputs
    ends = range(m, T, m)
    steps = np.array(
        [
            _step(acting[2 * (k - m) : 2 * k + 1], imu[k - m + 1 : k + 1], speed[k - m + 1 : k + 1], dt)
            for k in ends
        ]
    ).reshape(-1, 9)
    logs = np.empty((len(steps), settings.count))
    if len(steps):
        _run(model, steps, logs)
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    weights = np.vstack([np.ones((1, settings.count)), weights])  # nothing is known before the first step
    weights /= weights.sum(axis=1, keepdims=True)
    # An opinion holds until the next one.
    return Opinion(n=model.n, weights=weights[np.arange(T) // m], widest=settings.widest)


def _actuators(plant: Plant, commands: np.ndarray, dt: float) -> np.ndarray:
    """What steering, drive and brake do (2 T - 1, 3) under commands at every half step."""
    vehicle, acting = plant.vehicle, commands.copy()
    lags = np.maximum([vehicle.steer_lag, vehicle.torque_lag, vehicle.torque_lag], 1e-6)
    kept = np.exp(-0.5 * dt / lags)
    for k in range(1, len(acting)):
        acting[k] = commands[k] + kept * (acting[k - 1] - commands[k])
    return acting


def _step(inputs: np.ndarray, imu: np.ndarray, speed: np.ndarray, dt: float) -> tuple[float, ...]:
    """A row of `_run`'s ``steps``: means over the samples of a step."""
    rate = (inputs[-1, 0] - inputs[0, 0]) / (len(imu) * dt)
    present = imu[np.isfinite(imu).all(axis=1)]
    felt = present.mean(axis=0) if len(present) else np.full(imu.shape[1], math.nan)
    # The axles carry what the body feels.
    load = 1.0 + felt[_A_Z] / GRAVITY if len(present) else 1.0
    drive = (*inputs[1:].mean(axis=0), max(load, _LIGHTEST))
    return (*drive, rate, speed.mean(), *felt[list(_USED)])
