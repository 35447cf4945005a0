"""A Gaussian sum over the sinkage exponent: weights, moments, quantiles, modes, pruning and merging.

Each component is a Gaussian belief of some filter that starts on a soil of its own; the weights follow from
the likelihood of what each predicted (D. L. Alspach & H. W. Sorenson, IEEE Trans. Automatic Control 17(4),
1972). A component must be narrow where it starts: the sum stands for a wide belief, the linearisation only
for the width of one component. Components that carry no weight are dropped, and such as have become the same
are merged with their moments kept.

The functions of the sum take ``log_weights``, ``etas`` and ``variances`` (K,), where a log weight of -inf
marks a free place. `estimators.filters.joint_bank` (unscented components), `augmented_ekf_bank` (extended
Kalman filters with nuisances) and `online_joint_ukf` share them.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np

from estimators.filters.change_test import WINDOW
from estimators.filters.innovation_test import fading_share, nis_excess
from estimators.models.half_car_on_map import ETA
from estimators.numerics.bounded import from_range, moments, range_slope, to_range
from estimators.numerics.unscented import guarded_cholesky
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = [
    "AGE",
    "APART",
    "DISTRUST",
    "EXCESS",
    "REPORT",
    "TIDY",
    "BankCounts",
    "BankRecord",
    "BankRules",
    "BankState",
    "Fan",
    "Ranged",
    "check_fan",
    "empty_bank",
    "empty_history",
    "exponent_fan",
    "merge_components",
    "mixture_moments",
    "mixture_quantile",
    "mode_weights",
    "normalise",
    "prune_and_merge",
    "record_sum",
    "report_sum",
    "update_nis_test",
    "weigh",
]

#: Samples between two looks at which components to drop and to merge.
TIDY = 10
#: Columns of what a bank reports per sample.
(MEAN, SD, LOW, HIGH, NIS, MODE, SURPRISE, VALID) = range(8)
REPORT = 8
#: Innovation test of a bank: mean excess in standard deviations, time since the components were drawn [s].
(EXCESS, AGE) = range(2)
#: Components further apart than this many of their standard deviations belong to two modes.
APART = 3.0
#: Factor on the covariance of the best component's state when new components are drawn from it.
DISTRUST = 4.0
#: Reach of a component in the search for a quantile [standard deviations], and halvings of the interval.
_REACH, _HALVINGS = 9.0, 40
#: Probabilities between which the reported interval lies.
_LOWER, _UPPER = 0.025, 0.975


class Fan(NamedTuple):
    """Soils side by side over a range of n: one component each."""

    etas: FloatArray  #: (K,) their eta
    variances: FloatArray  #: (K,) variance of eta of each
    log_prior: np.ndarray  #: (K,) logarithms of their weights, up to a constant


class BankState(NamedTuple):
    """The components; a weight of 0 (log weight -inf) marks a free place."""

    means: FloatArray  #: (K, L), eta in column `estimators.models.half_car_on_map.ETA`
    covs: FloatArray  #: (K, L, L)
    warms: FloatArray  #: (K, points, 2, 3)
    log_weights: FloatArray  #: (K,)
    watch: FloatArray  #: (2,) innovation test, columns `EXCESS` and `AGE`
    window: FloatArray  #: (3,) of `estimators.filters.change_test`, for the best component
    best: FloatArray  #: (1,) the component that the window belongs to


class BankRules(NamedTuple):
    """The settings of a bank as the kernels need them."""

    log_drop: float
    merge: float
    sure: float
    widest: float
    watch_time: float
    surprise: float
    renew: float
    change_time: float
    change_level: float
    fan: Fan
    start: FloatArray  #: variances of the state at the start


class BankCounts(NamedTuple):
    """What happened to the components."""

    repairs: int  #: repaired factorisations
    failed: int  #: updates that had no contact solution
    renewed: int  #: times that all components were drawn anew


class BankRecord(NamedTuple):
    """A run of a bank, a row per sample, to be filled."""

    report: FloatArray  #: (T, REPORT)
    log_weights: FloatArray  #: (T, K)
    etas: FloatArray  #: (T, K)
    variances: FloatArray  #: (T, K) of eta
    speeds: FloatArray  #: (T,) forward speed of the heaviest component [m/s]


class Ranged(Protocol):
    """A model with bounds of n and a time between samples."""

    @property
    def low(self) -> float: ...

    @property
    def high(self) -> float: ...

    @property
    def dt(self) -> float: ...


def empty_bank(components: int, size: int, points: int) -> BankState:
    """Room for components with ``size`` states and as many warm starts as ``points``."""
    return BankState(
        means=np.empty((components, size)),
        covs=np.empty((components, size, size)),
        warms=np.empty((components, points, 2, at.CONTACT_SIZE)),
        log_weights=np.empty(components),
        watch=np.zeros(2),
        window=np.zeros(WINDOW),
        best=np.zeros(1, np.int64),
    )


def empty_history(samples: int, components: int) -> BankRecord:
    """Room for the run of a bank."""
    shape = (samples, components)
    return BankRecord(
        np.empty((samples, REPORT)), np.empty(shape), np.empty(shape), np.empty(shape), np.empty(samples)
    )


def check_fan(n_fan: tuple[float, float], n_range: tuple[float, float]) -> None:
    """Refuse a fan of soils that reaches beyond the range of n.

    Raises
    ------
    InvalidParameter
    """
    low, high = n_range
    if not low < n_fan[0] < n_fan[1] < high:
        raise InvalidParameter(f"n_fan must lie inside n_range = ({low}, {high}), got {n_fan}")


def exponent_fan(
    n_fan: tuple[float, float],
    components: int,
    overlap: float,
    prior: tuple[float, float],
    n_range: tuple[float, float],
) -> Fan:
    """Components in equal steps of n, weighted by a normal prior.

    Parameters
    ----------
    n_fan : (float, float)
        Where they stand [-].
    components : int
    overlap : float
        Standard deviation of each over their distance.
    prior : (float, float)
        Mean and standard deviation of n [-].
    n_range : (float, float)
        Bounds of n that eta stands for [-].
    """
    low, high = n_range
    spacing = (n_fan[1] - n_fan[0]) / components
    n = n_fan[0] + (np.arange(components) + 0.5) * spacing
    mean, sd = prior
    etas = np.array([from_range(value, low, high) for value in n])
    slopes = np.array([range_slope(eta, low, high) for eta in etas])
    return Fan(etas, (overlap * spacing / slopes) ** 2, -0.5 * ((n - mean) / sd) ** 2)


@kernel
def normalise(log_weights: FloatArray) -> bool:
    """Scale the weights to a sum of 1, in place; false when there is none."""
    top = log_weights.max()
    if not top > -math.inf:
        return False
    log_weights -= top + math.log(np.exp(log_weights - top).sum())
    return True


@kernel
def weigh(log_weights: FloatArray, before: FloatArray) -> None:
    """Normalise after an update, in place; where no component explains the sample the weights stay.

    A sample that no soil of the bank explains is no evidence between them.
    """
    if not normalise(log_weights):
        log_weights[:] = before


@kernel
def merge_components(log_weights: FloatArray, means: FloatArray, covs: FloatArray, i: int, j: int) -> None:
    """Give component ``i`` weight, mean and covariance of the pair; ``j`` is left without weight."""
    a, b = math.exp(log_weights[i]), math.exp(log_weights[j])
    share = b / (a + b)
    apart = means[j] - means[i]
    means[i] += share * apart
    for p in range(apart.shape[0]):
        for q in range(apart.shape[0]):
            mixed = (1.0 - share) * covs[i, p, q] + share * covs[j, p, q]
            covs[i, p, q] = mixed + share * (1.0 - share) * apart[p] * apart[q]
    log_weights[i] = math.log(a + b)
    log_weights[j] = -math.inf


@kernel
def _distance(state: BankState, i: int, j: int) -> float:
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
def prune_and_merge(state: BankState, log_drop: float, merge: float) -> None:
    """Drop components below a weight, merge those closer than ``merge`` (squared distance), in place."""
    log_weights = state.log_weights
    K = log_weights.shape[0]
    for i in range(K):
        if log_weights[i] < log_drop:
            log_weights[i] = -math.inf
    order = np.argsort(-log_weights)
    for a in range(K):
        i = order[a]
        for b in range(a + 1, K):
            j = order[b]
            if log_weights[i] > -math.inf and log_weights[j] > -math.inf:
                gap = state.means[i, ETA] - state.means[j, ETA]
                near = gap * gap < merge * (state.covs[i, ETA, ETA] + state.covs[j, ETA, ETA])
                if near and _distance(state, i, j) < merge:
                    merge_components(log_weights, state.means, state.covs, i, j)
    normalise(log_weights)


@kernel
def mixture_moments(
    log_weights: FloatArray, etas: FloatArray, variances: FloatArray, low: float, high: float
) -> tuple[float, float]:
    """Mean and standard deviation of n in (low, high) under the sum."""
    mean = square = total = 0.0
    for i in range(log_weights.shape[0]):
        if log_weights[i] > -math.inf:
            w = math.exp(log_weights[i])
            m, s = moments(etas[i], variances[i], low, high)
            total += w
            mean += w * m
            square += w * (s * s + m * m)
    mean, square = mean / total, square / total
    return mean, math.sqrt(max(square - mean * mean, 0.0))


@kernel
def mixture_quantile(
    log_weights: FloatArray, etas: FloatArray, variances: FloatArray, probability: float
) -> float:
    """Quantile of eta under the sum, by bisection."""
    low, high = math.inf, -math.inf
    for i in range(log_weights.shape[0]):
        if log_weights[i] > -math.inf:
            spread = _REACH * math.sqrt(variances[i])
            low = min(low, etas[i] - spread)
            high = max(high, etas[i] + spread)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = 0.0
        for i in range(log_weights.shape[0]):
            if log_weights[i] > -math.inf:
                z = (middle - etas[i]) / math.sqrt(2.0 * variances[i])
                below += math.exp(log_weights[i]) * 0.5 * (1.0 + math.erf(z))
        if below < probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def mode_weights(
    log_weights: FloatArray, etas: FloatArray, variances: FloatArray, modes: FloatArray
) -> float:
    """Number the modes of the sum in the order of eta into ``modes`` (K,); returns the largest weight.

    A new mode begins where neighbours are more than three of their standard deviations apart.
    Free places get -1.
    """
    order = np.argsort(etas)
    modes[:] = -1
    number, reach, weight, largest = -1, -math.inf, 0.0, 0.0
    for a in range(order.shape[0]):
        i = order[a]
        if log_weights[i] > -math.inf:
            spread = APART * math.sqrt(variances[i])
            if etas[i] - spread > reach:
                number, weight = number + 1, 0.0
            reach = max(reach, etas[i] + spread)
            modes[i] = number
            weight += math.exp(log_weights[i])
            largest = max(largest, weight)
    return largest


@kernel
def report_sum(state: BankState, nis: FloatArray, rules: BankRules, model: Ranged, out: FloatArray) -> None:
    """Mean, sd, 95 % interval, NIS, weight of the largest mode and validity of the sum into ``out``."""
    log_weights, etas, variances = state.log_weights, state.means[:, ETA], state.covs[:, ETA, ETA]
    K, mean_nis = log_weights.shape[0], 0.0
    for i in range(K):
        if log_weights[i] > -math.inf:
            mean_nis += math.exp(log_weights[i]) * nis[i]
    out[MEAN], out[SD] = mixture_moments(log_weights, etas, variances, model.low, model.high)
    out[LOW] = to_range(mixture_quantile(log_weights, etas, variances, _LOWER), model.low, model.high)
    out[HIGH] = to_range(mixture_quantile(log_weights, etas, variances, _UPPER), model.low, model.high)
    out[NIS] = mean_nis
    out[MODE] = mode_weights(log_weights, etas, variances, np.empty(K, np.int64))
    out[SURPRISE] = state.watch[EXCESS]
    sound = out[MODE] >= rules.sure and out[SD] <= rules.widest and out[SURPRISE] <= rules.surprise
    out[VALID] = 1.0 if sound and state.watch[AGE] > rules.watch_time else 0.0


@kernel
def update_nis_test(state: BankState, nis: FloatArray, channels: float, rules: BankRules, dt: float) -> None:
    """Innovation test of the sum: fading mean of the excess of the NIS, in its standard deviations."""
    excess = 0.0
    for i in range(nis.shape[0]):
        if state.log_weights[i] > -math.inf and math.isfinite(nis[i]):
            excess += math.exp(state.log_weights[i]) * nis_excess(nis[i], channels)
    share, watch = fading_share(dt, rules.watch_time), state.watch
    watch[EXCESS] += share * (excess * math.sqrt(2.0 * rules.watch_time / dt) - watch[EXCESS])
    watch[AGE] += dt


@kernel
def record_sum(state: BankState, history: BankRecord, k: int) -> None:
    """Weights, etas and variances of the components, and the speed of the heaviest, into row ``k``."""
    history.log_weights[k] = state.log_weights
    history.etas[k] = state.means[:, ETA]
    history.variances[k] = state.covs[:, ETA, ETA]
    history.speeds[k] = state.means[np.argmax(state.log_weights), at.V_X]
