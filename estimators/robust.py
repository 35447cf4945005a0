"""A bank that doubts its own model: hypotheses about n with every nuisance in the belief.

Each component is an extended Kalman filter on the 26 numbers of `estimators.nuisances`. It is
linearised once a sample, where reading and next motion share the trial evaluations: 15 force
evaluations for the slopes and 4 for the mean, a fifth of what the unscented filter of
`estimators.joint` asks for less than half of the belief. What the linearisation cannot hold, the
several roots of the force, is the bank's to hold (`estimators.bank`, whose bookkeeping it shares).

*The moduli and n are confounded*: the pressure k h^n at the depth where the wheels run is well known,
its slope hardly. The belief holds that pressure in place of the moduli (`nuisances.tie`). In k
itself the two would turn against each other as n moves, and a linearised filter would take each
turn for information that it does not have.

*When does it vouch?* While n is narrow in one mode, and while the innovations have no lasting mean:
noise so large that it counts errors which last hides a wrong model from a test of size, but not
from a test of the mean (`_watch`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.bank import (
    REPORT,
    BankRun,
    BankState,
    Rules,
    bank_run,
    normalise,
    report_sum,
    tidy,
)
from estimators.bounds import linear_step
from estimators.joint import ETA, JointSettings, check_run
from estimators.nuisances import (
    CHANNELS,
    LENGTH,
    Doubt,
    DoubtModel,
    advance,
    linearise,
    process_noise,
    settled_belief,
)
from estimators.transforms import from_range, range_slope
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["RobustRun", "RobustSettings", "run_robust_bank"]

#: Samples between two looks at which components to drop and to merge.
_TIDY = 10
_LOG_2PI = math.log(2.0 * math.pi)
#: What place and motion of the best component are trusted less when a new fan is drawn from it.
_DISTRUST = 4.0


@dataclass(frozen=True, kw_only=True)
class RobustSettings:
    """The fan of hypotheses, what they doubt, and when they vouch for their estimate."""

    joint: JointSettings = field(default_factory=JointSettings)  #: noise, start and range of n
    doubt: Doubt = field(default_factory=Doubt)
    n_prior: float = 1.0  #: prior of n: the paper's first guess [-]
    n_prior_sd: float = 0.3  #: its standard deviation [-]
    n_fan: tuple[float, float] = (0.3, 1.3)  #: where the hypotheses stand [-]
    components: int = 20  #: soils in the fan
    overlap: float = 0.6  #: their standard deviation over their distance
    bump: float = 0.003  #: size of what the map lacks [m]
    drop: float = 1e-6  #: weight below which a component is dropped
    merge: float = 1.0  #: squared Mahalanobis distance below which two are one

    sure: float = 0.99  #: weight that the largest mode must have for a valid estimate
    widest: float = 0.15  #: largest standard deviation of n for a valid estimate, as a share of n
    watch_time: float = 2.0  #: time over which innovations are averaged [s]
    surprise: float = 5.0  #: excess of their mean's chi-square in its standard deviations: not valid
    renew: float = 10.0  #: and more than this draws a new fan

    def __post_init__(self) -> None:
        low, high = self.joint.n_range
        if not low < self.n_fan[0] < self.n_fan[1] < high:
            raise InvalidParameter(f"n_fan must lie inside n_range = ({low}, {high}), got {self.n_fan}")
        if not 1 <= self.components <= 200:
            raise InvalidParameter(f"components must be in [1, 200], got {self.components}")
        if not 0.0 < self.bump < 0.5:
            raise InvalidParameter(f"bump must be in (0, 0.5) m, got {self.bump} - in mm or cm?")
        if not 0.0 < self.drop < 0.1:
            raise InvalidParameter(f"drop must be in (0, 0.1), got {self.drop}")
        for name in ("n_prior_sd", "overlap", "merge", "widest", "watch_time", "surprise", "renew"):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class RobustRun:
    """What the bank believed, about n and about what it doubts."""

    bank: BankRun
    means: np.ndarray  #: (T, 26) mean of the sum, layout of `estimators.nuisances`
    sds: np.ndarray  #: (T, 26) its standard deviations


def _rules(model: DoubtModel, settings: RobustSettings) -> Rules:
    """The settings as the kernels need them."""
    low, high = settings.n_fan
    spacing = (high - low) / settings.components
    n = low + (np.arange(settings.components) + 0.5) * spacing
    etas = np.array([from_range(value, model.low, model.high) for value in n])
    slopes = np.array([range_slope(eta, model.low, model.high) for eta in etas])
    return Rules(
        log_drop=math.log(settings.drop),
        merge=float(settings.merge),
        sure=float(settings.sure),
        widest=math.inf,  # judged relative to n, see `run_robust_bank`
        watch_time=float(settings.watch_time),
        surprise=float(settings.surprise),
        renew=float(settings.renew),
        change_time=float(settings.watch_time),
        change_level=math.inf,  # its errors last, so its updates are not white
        etas=etas,
        variances=(settings.overlap * spacing / slopes) ** 2,
        log_prior=-0.5 * ((n - settings.n_prior) / settings.n_prior_sd) ** 2,
        start=np.empty(0),
    )


@kernel
def _place(state, slopes, rules, bump, model, fan):
    """Every soil of the fan settled on its own; ``fan`` = (pose, speed, steering input); returns failures."""
    pose, v_x, u = fan
    H, out = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    failed = 0
    for i in range(rules.etas.shape[0]):
        status, mean, cov, warm = settled_belief(model, rules.etas[i], rules.variances[i], bump, pose, v_x)
        status = max(status, linearise(mean, warm, u, model, slopes[i], H, out))
        state.means[i], state.covs[i], state.warms[i, 0] = mean, cov, warm
        sound = status < SUNK and np.isfinite(cov).all() and np.isfinite(slopes[i]).all()
        state.log_weights[i] = rules.log_prior[i] if sound else -math.inf
        failed += 0 if sound else 1
    normalise(state.log_weights)
    state.watch[:] = 0.0
    return failed


@kernel
def _component_step(mean, cov, warm, slopes, inputs, z, noise, model):
    """One sample of one component, in place; returns (log likelihood, nis, repairs, status).

    ``slopes`` (26, 26) of motion at the last sample, renewed; ``noise`` = (size of the bumps [m],
    indices of what was measured, innovation of those in standard deviations: filled). With a status
    of SUNK or worse the belief is as before.
    """
    bump, index, e = noise
    point, A = mean.copy(), np.empty((LENGTH, LENGTH))
    H, out, Q = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS), np.empty(LENGTH)
    status = advance(point, warm, inputs, model)
    rate = (inputs[2, 0] - inputs[0, 0]) / model.dt
    if status < SUNK and np.isfinite(point).all():
        status = max(status, linearise(point, warm, (inputs[2, 0], inputs[2, 1], rate), model, A, H, out))
    if not (status < SUNK and np.isfinite(A).all() and np.isfinite(H).all() and np.isfinite(point).all()):
        warm[:, 0] = 0.0  # a failed solve is no start for the next one
        return -math.inf, math.nan, 0, SUNK
    F = np.eye(LENGTH) + slopes * model.dt + (slopes @ slopes) * (0.5 * model.dt * model.dt)
    process_noise(point[at.V_X], bump, model, Q)
    gain, S, repairs = linear_step(cov, F, H[index], Q, model.R[index])
    mean[:], slopes[:] = point, A
    if index.shape[0] == 0:
        return 0.0, math.nan, repairs, status
    e[:] = np.linalg.solve(S, (z - out)[index])
    mean += gain.T @ e
    nis, log_density = 0.0, -0.5 * index.shape[0] * _LOG_2PI
    for j in range(index.shape[0]):
        nis += e[j] * e[j]
        log_density -= math.log(S[j, j])
    return log_density - 0.5 * nis, nis, repairs, status


@kernel
def _watch(state, mean, e, index, rules, dt):
    """Follow the mean of the innovations (K, m), in ``mean`` (7,), and what its chi-square exceeds m by.

    A mean over the time T that forgets exponentially has dt / (2 T) of the variance of a sample, and
    a chi-square of m channels has mean m and variance 2 m. Errors that last are in the noise already.
    """
    m, share, total = index.shape[0], min(dt / rules.watch_time, 1.0), 0.0
    for j in range(m):
        now = 0.0
        for i in range(e.shape[0]):
            if state.log_weights[i] > -math.inf:
                now += math.exp(state.log_weights[i]) * e[i, j]
        mean[index[j]] += share * (now - mean[index[j]])
        total += mean[index[j]] ** 2
    state.watch[0] = (total * 2.0 * rules.watch_time / dt - m) / math.sqrt(2.0 * m)
    state.watch[1] += dt


@kernel
def _renew(state, slopes, rules, bump, model, u):
    """Draw a new fan at the place and speed of the best component, every nuisance at its prior again."""
    best = np.argmax(state.log_weights)
    base, cov = state.means[best].copy(), state.covs[best].copy()
    pose = (base[at.X], base[at.Y], base[at.YAW])
    _place(state, slopes, rules, bump, model, (pose, max(base[at.V_X], 0.0), u))
    for i in range(rules.etas.shape[0]):
        for p in (at.V_Y, at.YAW_RATE):
            state.means[i, p] = base[p]
        for p in range(ETA):
            state.covs[i, p, p] += _DISTRUST * cov[p, p]


@kernel
def _step(state, slopes, inputs, z, rules, fan, out):
    """One sample for every component, in place; ``fan`` = (size of bumps, model, mean innovation (7,)).

    Returns (repairs, failed components, renewed 0 or 1).
    """
    bump, model, mean_innovation = fan
    K = state.log_weights.shape[0]
    nis, before = np.full(K, math.nan), state.log_weights.copy()
    index = np.flatnonzero(np.isfinite(z))
    e = np.zeros((K, index.shape[0]))
    repairs = failed = renewed = 0
    for i in range(K):
        if before[i] > -math.inf:
            log_likelihood, nis[i], repaired, status = _component_step(
                state.means[i],
                state.covs[i],
                state.warms[i, 0],
                slopes[i],
                inputs,
                z,
                (bump, index, e[i]),
                model,
            )
            repairs += repaired
            failed += 1 if status >= SUNK else 0
            state.log_weights[i] += log_likelihood
    if not normalise(state.log_weights):
        # No soil of the bank explains the sample at all: that is no evidence between them.
        state.log_weights[:] = before
    if index.shape[0] > 0:
        _watch(state, mean_innovation, e, index, rules, model.dt)
        if state.watch[0] > rules.renew and state.watch[1] > rules.watch_time:
            rate = (inputs[2, 0] - inputs[0, 0]) / model.dt
            _renew(state, slopes, rules, bump, model, (inputs[2, 0], inputs[2, 1], rate))
            mean_innovation[:] = 0.0
            renewed = 1
    report_sum(state, nis, rules, model, out)
    return repairs, failed, renewed


@kernel
def _sum_up(state, means, sds):
    """Mean and standard deviation of the sum over the components (26,)."""
    means[:], sds[:] = 0.0, 0.0
    for i in range(state.log_weights.shape[0]):
        if state.log_weights[i] > -math.inf:
            w = math.exp(state.log_weights[i])
            for p in range(LENGTH):
                means[p] += w * state.means[i, p]
                sds[p] += w * (state.covs[i, p, p] + state.means[i, p] ** 2)
    for p in range(LENGTH):
        sds[p] = math.sqrt(max(sds[p] - means[p] ** 2, 0.0))


@kernel
def _run(state, slopes, inputs, z, rules, fan, result):
    """The loop behind `run_robust_bank`; returns (repairs, failed, renewed)."""
    bump, model = fan
    report, logs, etas, variances, means, sds = result
    kinds = np.zeros(state.log_weights.shape[0], np.int64)  # all components are of one kind
    mean_innovation = np.zeros(CHANNELS)
    repairs = failed = renewed = 0
    report_sum(state, np.full(state.log_weights.shape[0], math.nan), rules, model, report[0])
    for k in range(z.shape[0]):
        if k > 0:
            step = inputs[2 * k - 2 : 2 * k + 1]
            counts = _step(state, slopes, step, z[k], rules, (bump, model, mean_innovation), report[k])
            repairs += counts[0]
            failed += counts[1]
            renewed += counts[2]
            if k % _TIDY == 0:
                tidy(state, rules.log_drop, rules.merge, kinds)
        logs[k], etas[k], variances[k] = state.log_weights, state.means[:, ETA], state.covs[:, ETA, ETA]
        _sum_up(state, means[k], sds[k])
    return repairs, failed, renewed


def run_robust_bank(
    model: DoubtModel,
    settings: RobustSettings,
    inputs: np.ndarray,
    z: np.ndarray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
) -> RobustRun:
    """Filter a whole run with a bank that starts settled and doubts its model.

    Parameters
    ----------
    model : DoubtModel
        Of `nuisances.doubt_model`, made with ``settings.joint`` and ``settings.doubt``.
    inputs, z
        As in `joint.run_joint_filter`; the position and course of ``z`` are not used.
    pose : (X, Y, yaw)
        At the start, on the map [m, m, rad].
    v_x : float
        Speed at the start [m/s].
    """
    inputs, z = check_run(inputs, z)
    T, K, bump = len(z), settings.components, float(settings.bump)
    rules = _rules(model, settings)
    covs, warms = np.empty((K, LENGTH, LENGTH)), np.empty((K, 1, 2, 3))
    state = BankState(np.empty((K, LENGTH)), covs, warms, np.empty(K), np.zeros(2), np.zeros(4))
    slopes = np.empty((K, LENGTH, LENGTH))
    rate = (inputs[2, 0] - inputs[0, 0]) / model.dt
    start = (tuple(float(p) for p in pose), float(v_x), (inputs[0, 0], inputs[0, 1], rate))
    if _place(state, slopes, rules, bump, model, start) == K:
        raise SolverFailure("no soil of the fan carries the vehicle: move n_fan")
    report, means, sds = np.empty((T, REPORT)), np.empty((T, LENGTH)), np.empty((T, LENGTH))
    history = (np.empty((T, K)), np.empty((T, K)), np.empty((T, K)))
    seen = np.ascontiguousarray(z[:, :CHANNELS])
    counts = _run(state, slopes, inputs, seen, rules, (bump, model), (report, *history, means, sds))
    bank = bank_run(model, report, history, tuple(int(count) for count in counts))
    narrow = bank.sd <= settings.widest * bank.n
    return RobustRun(bank=replace(bank, valid=bank.valid & narrow), means=means, sds=sds)
