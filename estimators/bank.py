"""Several hypotheses about the soil at once: a Gaussian sum of joint filters.

On clay with zero steering the longitudinal force is the same for three sinkage exponents, and a
single filter settles on whichever root it meets first. Here each component is a joint filter
(`estimators.joint`) that starts settled on its own soil, and their weights follow from the
likelihood of what each predicted (D. L. Alspach & H. W. Sorenson, IEEE Trans. Automatic Control
17(4), 1972). A component must be narrow where it starts: the sum stands for a wide belief, the
linearisation only for the width of one component.

Components that carry no weight are dropped, and such as have become the same are merged with
their moments kept. Where all that are left keep predicting badly, a new fan is drawn from the
best state: nothing that was dropped is lost for good.
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
    joint_step,
    prior,
)
from estimators.transforms import moments, to_range
from estimators.ukf_compiled import guarded_cholesky
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK

__all__ = ["BankRun", "BankSettings", "Mode", "bank_step", "modes_of", "run_bank", "start_bank"]

#: Samples between two looks at which components to drop and to merge.
_TIDY = 10
#: Columns of what a bank reports per sample.
(MEAN, SD, LOW, HIGH, NIS, TOP, ALIVE) = range(7)
_REPORT = 7
#: Half width of a 95 % interval in standard deviations.
_Z95 = 1.959964


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

    def __post_init__(self) -> None:
        low, high = self.joint.n_range
        if not low < self.n_fan[0] < self.n_fan[1] < high:
            raise InvalidParameter(f"n_fan must lie inside n_range = ({low}, {high}), got {self.n_fan}")
        if not 1 <= self.components <= 200:
            raise InvalidParameter(f"components must be in [1, 200], got {self.components}")
        if not 0.0 < self.drop < 0.1:
            raise InvalidParameter(f"drop must be in (0, 0.1), got {self.drop}")
        if not (self.overlap > 0.0 and self.merge > 0.0):
            raise InvalidParameter("overlap and merge must be > 0")


class Mode(NamedTuple):
    """Components that overlap in n."""

    weight: float  #: [-]
    mean: float  #: of n [-]
    sd: float  #: of n [-]


class BankState(NamedTuple):
    """The components; a weight of 0 (log weight -inf) marks a free place."""

    means: np.ndarray  #: (K, 11)
    covs: np.ndarray  #: (K, 11, 11)
    warms: np.ndarray  #: (K, 23, 2, 3)
    log_weights: np.ndarray  #: (K,)


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
    K = settings.components
    state = BankState(
        np.empty((K, SIZE)),
        np.empty((K, SIZE, SIZE)),
        np.empty((K, 2 * SIZE + 1, 2, 3)),
        np.zeros(K),
    )
    low, high = settings.n_fan
    spacing = (high - low) / K
    for i in range(K):
        n = low + (i + 0.5) * spacing
        mean, cov, warm = prior(model, settings.joint, n, settings.overlap * spacing, pose, v_x)
        state.means[i], state.covs[i], state.warms[i] = mean, cov, warm
        state.log_weights[i] = -0.5 * ((n - settings.n_prior) / settings.n_prior_sd) ** 2
    _normalise(state.log_weights)
    return state


@kernel
def _normalise(log_weights):
    """Scale the weights to a sum of 1; false when there is none."""
    top = log_weights.max()
    if not top > -math.inf:
        return False
    log_weights -= top + math.log(np.exp(log_weights - top).sum())
    return True


@kernel
def _distance(state, i, j):
    """Squared Mahalanobis distance of two components under the sum of their covariances."""
    factor = np.empty((SIZE, SIZE))
    guarded_cholesky(state.covs[i] + state.covs[j], factor)
    apart = state.means[i] - state.means[j]
    total = 0.0
    for p in range(SIZE):
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
    for p in range(SIZE):
        for q in range(SIZE):
            mixed = (1.0 - share) * state.covs[i, p, q] + share * state.covs[j, p, q]
            state.covs[i, p, q] = mixed + share * (1.0 - share) * apart[p] * apart[q]
    state.log_weights[i] = math.log(a + b)
    state.log_weights[j] = -math.inf


@kernel
def _tidy(state, log_drop, merge):
    """Drop components without weight, merge those that have become one."""
    K = state.log_weights.shape[0]
    for i in range(K):
        if state.log_weights[i] < log_drop:
            state.log_weights[i] = -math.inf
    order = np.argsort(-state.log_weights)
    for a in range(K):
        i = order[a]
        for b in range(a + 1, K):
            j = order[b]
            if state.log_weights[i] > -math.inf and state.log_weights[j] > -math.inf:
                gap = state.means[i, ETA] - state.means[j, ETA]
                near = gap * gap < merge * (state.covs[i, ETA, ETA] + state.covs[j, ETA, ETA])
                if near and _distance(state, i, j) < merge:
                    _absorb(state, i, j)
    _normalise(state.log_weights)


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
def _report(state, nis, model, out):
    """Mean, sd, 95 % interval, NIS and largest weight of the sum into ``out``."""
    mean = square = mean_nis = 0.0
    alive = 0
    for i in range(state.log_weights.shape[0]):
        if state.log_weights[i] > -math.inf:
            w = math.exp(state.log_weights[i])
            m, s = moments(state.means[i, ETA], state.covs[i, ETA, ETA], model.low, model.high)
            mean += w * m
            square += w * (s * s + m * m)
            mean_nis += w * nis[i]
            alive += 1
    out[MEAN], out[SD] = mean, math.sqrt(max(square - mean * mean, 0.0))
    out[LOW] = to_range(_quantile(state, 0.025), model.low, model.high)
    out[HIGH] = to_range(_quantile(state, 0.975), model.low, model.high)
    out[NIS], out[TOP], out[ALIVE] = mean_nis, math.exp(state.log_weights.max()), alive


@kernel
def bank_step(state, inputs, z, model, out):
    """One sample for every component, in place; returns (repairs, failed components).

    ``inputs`` and ``z`` as in `joint.joint_step`; ``out`` receives the report.
    """
    K = state.log_weights.shape[0]
    nis, before = np.full(K, math.nan), state.log_weights.copy()
    repairs = failed = 0
    for i in range(K):
        if before[i] > -math.inf:
            log_likelihood, nis[i], repaired, status = joint_step(
                state.means[i], state.covs[i], state.warms[i], inputs, z, model
            )
            repairs += repaired
            failed += 1 if status >= SUNK else 0
            state.log_weights[i] += log_likelihood
    if not _normalise(state.log_weights):
        state.log_weights[:] = before
    _report(state, nis, model, out)
    return repairs, failed


@kernel
def _run(state, inputs, z, model, limits, report, history):
    """The loop behind `run_bank`; returns (repairs, failed). ``history`` = (log weights, eta, variance)."""
    log_drop, merge = limits
    logs, etas, variances = history
    repairs = failed = 0
    K = state.log_weights.shape[0]
    _report(state, np.full(K, math.nan), model, report[0])
    for k in range(z.shape[0]):
        if k > 0:
            repaired, lost = bank_step(state, inputs[2 * k - 2 : 2 * k + 1], z[k], model, report[k])
            repairs += repaired
            failed += lost
            if k % _TIDY == 0:
                _tidy(state, log_drop, merge)
        logs[k] = state.log_weights
        etas[k] = state.means[:, ETA]
        variances[k] = state.covs[:, ETA, ETA]
    return repairs, failed
