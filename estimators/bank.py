"""Several hypotheses about the soil at once: a Gaussian sum of joint filters.

On clay with zero steering the longitudinal force is the same for three sinkage exponents, and a
single filter settles on whichever root it meets first. Here each component is a joint filter
(`estimators.joint`) that starts settled on its own soil, and their weights follow from the
likelihood of what each predicted (D. L. Alspach & H. W. Sorenson, IEEE Trans. Automatic Control
17(4), 1972). A component must be narrow where it starts: the sum stands for a wide belief, the
linearisation only for the width of one component.

Components that carry no weight are dropped, and such as have become the same are merged with
their moments kept. Where all that are left keep predicting badly - the soil has changed, or the
true one was dropped - a new fan is drawn from the best state: nothing is lost for good. And where
the best one changes its mind about n faster than the samples may teach it, the soil has changed: the
updates of a filter that is right are white and have the variance that its belief loses by them. A
change shows there within tenths of a second, in the size of the innovations after seconds.

The bank vouches for its estimate (`valid`) while one mode holds nearly all weight, its width is
small, and the innovations are as large as they should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.joint import (
    ETA,
    SIZE,
    JointModel,
    JointSettings,
    check_run,
    hypothesis,
    joint_step,
)
from estimators.transforms import from_range, moments, range_slope, to_range
from estimators.ukf_compiled import guarded_cholesky
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = [
    "REPORT",
    "VALID",
    "BankRun",
    "BankSettings",
    "BankState",
    "Mode",
    "Rules",
    "bank_rules",
    "bank_run",
    "bank_step",
    "normalise",
    "report_sum",
    "run_bank",
    "start_bank",
    "tidy",
    "watch_innovations",
]

#: Samples between two looks at which components to drop and to merge.
_TIDY = 10
#: Columns of what a bank reports per sample.
(MEAN, SD, LOW, HIGH, NIS, MODE, SURPRISE, VALID) = range(8)
REPORT = 8
#: Components further apart than this many of their standard deviations belong to two modes.
_APART = 3.0
#: What the state of the best component is trusted less when a new fan is drawn from it.
_DISTRUST = 4.0


@dataclass(frozen=True, kw_only=True)
class BankSettings:
    """The fan of hypotheses and how long they live."""

    joint: JointSettings = field(default_factory=JointSettings)
    n_prior: float = 1.0  #: prior of n: the paper's first guess [-]
    n_prior_sd: float = 0.3  #: its standard deviation: every soil of the fan within 2.4 of them [-]
    n_fan: tuple[float, float] = (0.3, 1.3)  #: where the hypotheses stand [-]
    components: int = 20  #: hypotheses at the start
    overlap: float = 0.6  #: their standard deviation over their distance: 0.6 makes the sum flat to 1 %
    drop: float = 1e-8  #: weight below which a component is dropped
    merge: float = 0.5  #: squared Mahalanobis distance (11 states) below which two are one

    sure: float = 0.99  #: weight that the largest mode must have for a valid estimate
    widest: float = 0.1  #: largest standard deviation of n for a valid estimate [-]
    watch_time: float = 2.0  #: time over which innovations are averaged [s]
    surprise: float = 5.0  #: their mean excess in its standard deviations: more is no valid estimate
    renew: float = 10.0  #: and more than this draws a new fan
    change_time: float = 1.0  #: fading window in which the best component's changes of n add up [s]
    #: Their sum in its standard deviations that draws a new fan too: soils that stay reach 4 on the tuning
    #: seeds, a step of 0.15 passes 8 within a second.
    change_level: float = 6.0

    def __post_init__(self) -> None:
        low, high = self.joint.n_range
        if not low < self.n_fan[0] < self.n_fan[1] < high:
            raise InvalidParameter(f"n_fan must lie inside n_range = ({low}, {high}), got {self.n_fan}")
        if not 1 <= self.components <= 200:
            raise InvalidParameter(f"components must be in [1, 200], got {self.components}")
        if not 0.0 < self.drop < 0.1:
            raise InvalidParameter(f"drop must be in (0, 0.1), got {self.drop}")
        fields = ("n_prior_sd", "overlap", "merge", "widest", "watch_time", "surprise", "renew")
        for name in (*fields, "change_time", "change_level"):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")


class Mode(NamedTuple):
    """Components that overlap in n."""

    weight: float  #: [-]
    mean: float  #: of n [-]
    sd: float  #: of n [-]


class BankState(NamedTuple):
    """The components; a weight of 0 (log weight -inf) marks a free place."""

    means: np.ndarray  #: (K, L), eta in column `joint.ETA`; L = 11 here
    covs: np.ndarray  #: (K, L, L)
    warms: np.ndarray  #: (K, points, 2, 3)
    log_weights: np.ndarray  #: (K,)
    watch: np.ndarray  #: (2,) mean excess of the innovations in standard deviations; time since a fan [s]
    #: (4,) number of the best component; sum of its changes of eta and their variance in a fading window;
    #: age of that window [s]
    moved: np.ndarray


class Rules(NamedTuple):
    """The settings as the kernels need them."""

    log_drop: float
    merge: float
    sure: float
    widest: float
    watch_time: float
    surprise: float
    renew: float
    change_time: float
    change_level: float
    etas: np.ndarray  #: (K,) centres of the fan
    variances: np.ndarray  #: (K,) variances of eta in it
    log_prior: np.ndarray  #: (K,)
    start: np.ndarray  #: (10,) variances of the start


def bank_rules(model: JointModel, settings: BankSettings) -> Rules:
    """The kernels' view of the settings."""
    low, high = settings.n_fan
    spacing = (high - low) / settings.components
    n = low + (np.arange(settings.components) + 0.5) * spacing
    etas = np.array([from_range(value, model.low, model.high) for value in n])
    slopes = np.array([range_slope(eta, model.low, model.high) for eta in etas])
    return Rules(
        log_drop=math.log(settings.drop),
        merge=float(settings.merge),
        sure=float(settings.sure),
        widest=float(settings.widest),
        watch_time=float(settings.watch_time),
        surprise=float(settings.surprise),
        renew=float(settings.renew),
        change_time=float(settings.change_time),
        change_level=float(settings.change_level),
        etas=etas,
        variances=(settings.overlap * spacing / slopes) ** 2,
        log_prior=-0.5 * ((n - settings.n_prior) / settings.n_prior_sd) ** 2,
        start=np.square(np.array(settings.joint.start)),
    )


def start_bank(
    model: JointModel, settings: BankSettings, pose: tuple[float, float, float], v_x: float
) -> BankState:
    """The fan at the start: every hypothesis settled on its own soil.

    Parameters
    ----------
    pose : (X, Y, yaw)
        [m, m, rad]
    v_x : float
        Speed [m/s].
    """
    rules = bank_rules(model, settings)
    K = settings.components
    covs, warms = np.empty((K, SIZE, SIZE)), np.empty((K, 2 * SIZE + 1, 2, 3))
    state = BankState(np.empty((K, SIZE)), covs, warms, rules.log_prior.copy(), np.zeros(2), np.zeros(4))
    place = tuple(float(p) for p in pose)
    for i in range(K):
        status, state.means[i], covs[i], warm = hypothesis(
            model, rules.etas[i], rules.variances[i], place, float(v_x)
        )
        if status >= SUNK:
            raise SolverFailure(
                f"the soil with n = {to_range(rules.etas[i], model.low, model.high):.3f} of the fan does not "
                "carry the vehicle: narrow n_fan"
            )
        covs[i, np.arange(ETA), np.arange(ETA)] += rules.start
        warms[i] = warm
    normalise(state.log_weights)
    return state


@kernel
def normalise(log_weights):
    """Scale the weights to a sum of 1; false when there is none."""
    top = log_weights.max()
    if not top > -math.inf:
        return False
    log_weights -= top + math.log(np.exp(log_weights - top).sum())
    return True


@kernel
def _distance(state, i, j):
    """Squared Mahalanobis distance of two components under the sum of their covariances."""
    size = state.means.shape[1]
    factor = np.empty((size, size))
    guarded_cholesky(state.covs[i] + state.covs[j], factor)
    apart = state.means[i] - state.means[j]
    total = 0.0
    for p in range(size):
        for q in range(p):
            apart[p] -= factor[p, q] * apart[q]
        apart[p] /= factor[p, p]
        total += apart[p] * apart[p]
    return total


@kernel
def _absorb(state, i, j):
    """Merge component j into i with mean and covariance of the pair kept."""
    a, b = math.exp(state.log_weights[i]), math.exp(state.log_weights[j])
    share = b / (a + b)
    apart = state.means[j] - state.means[i]
    state.means[i] += share * apart
    for p in range(apart.shape[0]):
        for q in range(apart.shape[0]):
            mixed = (1.0 - share) * state.covs[i, p, q] + share * state.covs[j, p, q]
            state.covs[i, p, q] = mixed + share * (1.0 - share) * apart[p] * apart[q]
    state.log_weights[i] = math.log(a + b)
    state.log_weights[j] = -math.inf


@kernel
def tidy(state, log_drop, merge, kinds):
    """Drop components without weight, merge those of one kind (K,) that have become one."""
    K = state.log_weights.shape[0]
    for i in range(K):
        if state.log_weights[i] < log_drop:
            state.log_weights[i] = -math.inf
    order = np.argsort(-state.log_weights)
    for a in range(K):
        i = order[a]
        for b in range(a + 1, K):
            j = order[b]
            both = state.log_weights[i] > -math.inf and state.log_weights[j] > -math.inf
            if both and kinds[i] == kinds[j]:
                gap = state.means[i, ETA] - state.means[j, ETA]
                near = gap * gap < merge * (state.covs[i, ETA, ETA] + state.covs[j, ETA, ETA])
                if near and _distance(state, i, j) < merge:
                    _absorb(state, i, j)
    normalise(state.log_weights)


@kernel
def _quantile(state, probability):
    """Quantile of eta under the sum, by bisection."""
    low, high = math.inf, -math.inf
    for i in range(state.log_weights.shape[0]):
        if state.log_weights[i] > -math.inf:
            spread = 9.0 * math.sqrt(state.covs[i, ETA, ETA])
            low = min(low, state.means[i, ETA] - spread)
            high = max(high, state.means[i, ETA] + spread)
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = 0.0
        for i in range(state.log_weights.shape[0]):
            if state.log_weights[i] > -math.inf:
                z = (middle - state.means[i, ETA]) / math.sqrt(2.0 * state.covs[i, ETA, ETA])
                below += math.exp(state.log_weights[i]) * 0.5 * (1.0 + math.erf(z))
        if below < probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def _mode_weights(state, modes):
    """Number the modes of the sum in the order of eta into ``modes`` (K,); returns the largest weight.

    A new mode begins where neighbours are more than three of their standard deviations apart.
    Free places get -1.
    """
    order = np.argsort(state.means[:, ETA])
    modes[:] = -1
    number, reach, weight, largest = -1, -math.inf, 0.0, 0.0
    for a in range(order.shape[0]):
        i = order[a]
        if state.log_weights[i] > -math.inf:
            spread = _APART * math.sqrt(state.covs[i, ETA, ETA])
            if state.means[i, ETA] - spread > reach:
                number, weight = number + 1, 0.0
            reach = max(reach, state.means[i, ETA] + spread)
            modes[i] = number
            weight += math.exp(state.log_weights[i])
            largest = max(largest, weight)
    return largest


@kernel
def report_sum(state, nis, rules, model, out):
    """Mean, sd, 95 % interval, NIS, weight of the largest mode and validity of the sum into ``out``."""
    mean = square = mean_nis = 0.0
    K = state.log_weights.shape[0]
    for i in range(K):
        if state.log_weights[i] > -math.inf:
            w = math.exp(state.log_weights[i])
            m, s = moments(state.means[i, ETA], state.covs[i, ETA, ETA], model.low, model.high)
            mean += w * m
            square += w * (s * s + m * m)
            mean_nis += w * nis[i]
    out[MEAN], out[SD] = mean, math.sqrt(max(square - mean * mean, 0.0))
    out[LOW] = to_range(_quantile(state, 0.025), model.low, model.high)
    out[HIGH] = to_range(_quantile(state, 0.975), model.low, model.high)
    out[NIS], out[MODE] = mean_nis, _mode_weights(state, np.empty(K, np.int64))
    out[SURPRISE] = state.watch[0]
    sound = out[MODE] >= rules.sure and out[SD] <= rules.widest and state.watch[0] <= rules.surprise
    out[VALID] = 1.0 if sound and state.watch[1] > rules.watch_time else 0.0


@kernel
def watch_innovations(state, nis, channels, rules, dt):
    """Follow the mean excess of the innovations, in standard deviations of that mean.

    A NIS of m channels has mean m and variance 2 m; a mean over the time T that forgets
    exponentially has dt / (2 T) of the variance of a sample.
    """
    excess = 0.0
    for i in range(nis.shape[0]):
        if state.log_weights[i] > -math.inf and math.isfinite(nis[i]):
            excess += math.exp(state.log_weights[i]) * (nis[i] - channels) / math.sqrt(2.0 * channels)
    share = min(dt / rules.watch_time, 1.0)
    state.watch[0] += share * (excess * math.sqrt(2.0 * rules.watch_time / dt) - state.watch[0])
    state.watch[1] += dt


@kernel
def _changed(state, before, rules, model):
    """Whether the best component changes its mind faster than the samples may teach it.

    ``before`` = (eta, its variance), each (K,), ahead of the sample.
    """
    best, moved = np.argmax(state.log_weights), state.moved
    if int(moved[0]) != best:
        moved[:] = 0.0
        moved[0] = best
    kept = 1.0 - model.dt / rules.change_time
    learnt = before[1][best] + model.Q[ETA] - state.covs[best, ETA, ETA]
    moved[1] = kept * moved[1] + state.means[best, ETA] - before[0][best]
    moved[2] = kept * kept * moved[2] + max(learnt, 0.0)
    moved[3] += model.dt
    excess = moved[1] * moved[1] > rules.change_level * rules.change_level * moved[2]
    return excess and moved[3] > rules.change_time


@kernel
def _renew(state, rules, model):
    """Draw a new fan: every soil again, at the pose and speed of the best component, settled on its own."""
    best = np.argmax(state.log_weights)
    base, cov = state.means[best].copy(), state.covs[best].copy()
    pose, speed = (base[at.X], base[at.Y], base[at.YAW]), max(base[at.V_X], 0.0)
    _, own, _, _ = hypothesis(model, base[ETA], 1.0, pose, speed)
    for i in range(state.log_weights.shape[0]):
        status, mean, spread, warm = hypothesis(model, rules.etas[i], rules.variances[i], pose, speed)
        state.log_weights[i] = rules.log_prior[i] if status < SUNK else -math.inf
        state.means[i] = mean
        for p in range(ETA):
            state.means[i, p] += base[p] - own[p]  # keeps the motion about the settled height
            spread[p, p] += rules.start[p]
            for q in range(ETA):
                spread[p, q] += _DISTRUST * cov[p, q]
        state.covs[i], state.warms[i] = spread, warm
    state.watch[:] = 0.0
    state.moved[:] = 0.0
    normalise(state.log_weights)


@kernel
def bank_step(state, inputs, z, rules, model, out):
    """One sample for every component, in place; returns (repairs, failed components, renewed 0 or 1).

    ``inputs`` and ``z`` as in `joint.joint_step`; ``out`` receives the report.
    """
    K = state.log_weights.shape[0]
    nis, before = np.full(K, math.nan), state.log_weights.copy()
    belief = (state.means[:, ETA].copy(), state.covs[:, ETA, ETA].copy())
    repairs = failed = renewed = 0
    for i in range(K):
        if before[i] > -math.inf:
            log_likelihood, nis[i], repaired, status = joint_step(
                state.means[i], state.covs[i], state.warms[i], inputs, z, model
            )
            repairs += repaired
            failed += 1 if status >= SUNK else 0
            state.log_weights[i] += log_likelihood
    if not normalise(state.log_weights):
        # No soil of the bank explains the sample at all: that is no evidence between them.
        state.log_weights[:] = before
    channels = np.isfinite(z).sum()
    if channels > 0:
        watch_innovations(state, nis, channels, rules, model.dt)
        changed = _changed(state, belief, rules, model)
        if (changed or state.watch[0] > rules.renew) and state.watch[1] > rules.watch_time:
            _renew(state, rules, model)
            renewed = 1
    report_sum(state, nis, rules, model, out)
    return repairs, failed, renewed


@kernel
def _run(state, inputs, z, rules, model, report, history):
    """The loop behind `run_bank`; ``history`` = (log weights, eta, variance), each (T, K).

    Returns (repairs, failed, renewed).
    """
    logs, etas, variances = history
    repairs = failed = renewed = 0
    kinds = np.zeros(state.log_weights.shape[0], np.int64)  # all components are of one kind
    report_sum(state, np.full(state.log_weights.shape[0], math.nan), rules, model, report[0])
    for k in range(z.shape[0]):
        if k > 0:
            counts = bank_step(state, inputs[2 * k - 2 : 2 * k + 1], z[k], rules, model, report[k])
            repairs += counts[0]
            failed += counts[1]
            renewed += counts[2]
            if k % _TIDY == 0:
                tidy(state, rules.log_drop, rules.merge, kinds)
        logs[k] = state.log_weights
        etas[k] = state.means[:, ETA]
        variances[k] = state.covs[:, ETA, ETA]
    return repairs, failed, renewed


@dataclass(frozen=True, kw_only=True)
class BankRun:
    """What a bank believed. Row k belongs to the k-th sample; row 0 is the prior."""

    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) standard deviation of n [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval of the sum [-]
    high: np.ndarray  #: (T,) its upper end [-]
    nis: np.ndarray  #: (T,) normalised innovation squared, weighted over the components
    mode_weight: np.ndarray  #: (T,) weight of the largest mode [-]
    surprise: np.ndarray  #: (T,) mean excess of the innovations in standard deviations
    valid: np.ndarray  #: (T,) bool: the bank vouches for mean and interval
    weights: np.ndarray  #: (T, K) weights of the components, 0 for free places
    exponents: np.ndarray  #: (T, K) n of the components [-]
    spreads: np.ndarray  #: (T, K) their standard deviations, to first order [-]
    repairs: int  #: repaired factorisations
    failed: int  #: updates of components that had no contact solution
    renewed: int  #: fans drawn anew

    def modes(self, k: int) -> list[Mode]:
        """The modes of n at sample ``k``, heaviest first."""
        alive = np.flatnonzero(self.weights[k] > 0.0)
        alive = alive[np.argsort(self.exponents[k, alive])]
        groups: list[list[int]] = []
        reach = -math.inf
        for i in alive:
            spread = _APART * self.spreads[k, i]
            if self.exponents[k, i] - spread > reach:
                groups.append([])
            groups[-1].append(int(i))
            reach = max(reach, self.exponents[k, i] + spread)
        return sorted((self._mode(k, group) for group in groups), reverse=True)

    def _mode(self, k: int, group: list[int]) -> Mode:
        w, n = self.weights[k, group], self.exponents[k, group]
        total = float(w.sum())
        mean = float(w @ n) / total
        return Mode(
            total, mean, math.sqrt(float(w @ (self.spreads[k, group] ** 2 + (n - mean) ** 2)) / total)
        )


def bank_run(
    model: JointModel,
    report: np.ndarray,
    history: tuple[np.ndarray, np.ndarray, np.ndarray],
    counts: tuple[int, int, int],
) -> BankRun:
    """A run from its reports (T, REPORT), its log weights, eta and variances (T, K) each, and its counts."""
    logs, etas, variances = history
    share = 1.0 / (1.0 + np.exp(-etas))
    span = model.high - model.low
    return BankRun(
        n=report[:, MEAN],
        sd=report[:, SD],
        low=report[:, LOW],
        high=report[:, HIGH],
        nis=report[:, NIS],
        mode_weight=report[:, MODE],
        surprise=report[:, SURPRISE],
        valid=report[:, VALID] > 0.5,
        weights=np.exp(logs),
        exponents=model.low + span * share,
        spreads=span * share * (1.0 - share) * np.sqrt(variances),
        repairs=counts[0],
        failed=counts[1],
        renewed=counts[2],
    )


def run_bank(
    model: JointModel,
    settings: BankSettings,
    inputs: np.ndarray,
    z: np.ndarray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
) -> BankRun:
    """Filter a whole run with a bank that starts settled.

    Parameters
    ----------
    model : JointModel
        Of `joint.joint_model`, made with ``settings.joint``.
    inputs, z
        As in `joint.run_joint_filter`.
    pose : (X, Y, yaw)
        At the start [m, m, rad].
    v_x : float
        Speed at the start [m/s].
    """
    inputs, z = check_run(inputs, z)
    T, K = len(z), settings.components
    state, rules = start_bank(model, settings, pose, v_x), bank_rules(model, settings)
    report = np.empty((T, REPORT))
    history = (np.empty((T, K)), np.empty((T, K)), np.empty((T, K)))
    repairs, failed, renewed = _run(state, inputs, z, rules, model, report, history)
    return bank_run(model, report, history, (int(repairs), int(failed), int(renewed)))
