"""Bank of joint unscented filters: a Gaussian sum over several soils at once.

On clay with zero steering the longitudinal force is the same for three sinkage exponents, and a single
filter settles on whichever root it meets first. Here each component of a Gaussian sum
(`estimators.filters.gaussian_sum`) is a joint filter (`estimators.filters.joint_ukf`) that starts settled on
its own soil.

Two tests protect the sum against a soil that has changed, or a true one that was dropped: the innovation
test, where all components keep predicting badly, and the whiteness of the best component's updates of eta
(`estimators.filters.change_test`). Either draws a new fan of components from the best state.

The estimate is flagged `valid` while one mode holds nearly all weight, its width is small, and the
innovations are as large as they should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimators.filters.belief_history import BeliefHistory
from estimators.filters.change_test import add_update, has_changed
from estimators.filters.gaussian_sum import (
    AGE,
    APART,
    DISTRUST,
    EXCESS,
    HIGH,
    LOW,
    MEAN,
    MODE,
    NIS,
    SD,
    SURPRISE,
    TIDY,
    VALID,
    BankCounts,
    BankRecord,
    BankRules,
    BankState,
    Ranged,
    check_fan,
    empty_bank,
    empty_history,
    exponent_fan,
    normalise,
    prune_and_merge,
    record_sum,
    report_sum,
    update_nis_test,
    weigh,
)
from estimators.filters.joint_ukf import joint_step
from estimators.models.half_car_on_map import ETA, SIZE, JointModel, JointSettings, check_run, settled_start
from estimators.numerics.bounded import to_range
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = [
    "BankHistory",
    "BankSettings",
    "Mode",
    "bank_rules",
    "bank_run",
    "bank_step",
    "run_bank",
    "start_bank",
]


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
        check_fan(self.n_fan, self.joint.n_range)
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


def bank_rules(model: JointModel, settings: BankSettings) -> BankRules:
    """The kernels' view of the settings."""
    prior = (settings.n_prior, settings.n_prior_sd)
    return BankRules(
        log_drop=math.log(settings.drop),
        merge=float(settings.merge),
        sure=float(settings.sure),
        widest=float(settings.widest),
        watch_time=float(settings.watch_time),
        surprise=float(settings.surprise),
        renew=float(settings.renew),
        change_time=float(settings.change_time),
        change_level=float(settings.change_level),
        fan=exponent_fan(
            settings.n_fan, settings.components, settings.overlap, prior, (model.low, model.high)
        ),
        start=np.square(np.array(settings.joint.start)),
    )


def start_bank(
    model: JointModel, settings: BankSettings, pose: tuple[float, float, float], v_x: float
) -> BankState:
    """The fan at the start: every component settled on its own soil.

    Parameters
    ----------
    pose : (X, Y, yaw)
        [m, m, rad]
    v_x : float
        Speed [m/s].

    Raises
    ------
    SolverFailure
        When a soil of the fan does not carry the vehicle.
    """
    rules = bank_rules(model, settings)
    state = empty_bank(settings.components, SIZE, 2 * SIZE + 1)
    X, Y, yaw = pose
    place = (float(X), float(Y), float(yaw))
    for i, (eta, variance) in enumerate(zip(rules.fan.etas, rules.fan.variances, strict=True)):
        start = settled_start(model, eta, variance, place, float(v_x))
        if start.status >= SUNK:
            raise SolverFailure(
                f"the soil with n = {to_range(eta, model.low, model.high):.3f} of the fan does not "
                "carry the vehicle: narrow n_fan"
            )
        state.means[i], state.covs[i], state.warms[i] = start.mean, start.cov, start.warm
        state.covs[i, np.arange(ETA), np.arange(ETA)] += rules.start
    state.log_weights[:] = rules.fan.log_prior
    normalise(state.log_weights)
    return state


@kernel
def _soil_changed(
    state: BankState, etas: FloatArray, variances: FloatArray, rules: BankRules, model: JointModel
) -> bool:
    """Test of the best component's updates of eta from ``etas``, ``variances`` (K,) before the sample."""
    best, window = np.argmax(state.log_weights), state.window
    if state.best[0] != best:
        window[:] = 0.0
        state.best[0] = best
    lost = variances[best] + model.Q[ETA] - state.covs[best, ETA, ETA]
    shift = state.means[best, ETA] - etas[best]
    add_update(window, shift, max(lost, 0.0), rules.change_time, model.dt)
    return has_changed(window, rules.change_time, rules.change_level)


@kernel
def _renew(state: BankState, rules: BankRules, model: JointModel) -> None:
    """Draw all components anew: every soil at pose and speed of the best component, settled on its own."""
    best, fan = np.argmax(state.log_weights), rules.fan
    base, cov = state.means[best].copy(), state.covs[best].copy()
    pose, speed = (base[at.X], base[at.Y], base[at.YAW]), max(base[at.V_X], 0.0)
    own = settled_start(model, base[ETA], 1.0, pose, speed).mean
    for i in range(state.log_weights.shape[0]):
        start = settled_start(model, fan.etas[i], fan.variances[i], pose, speed)
        state.log_weights[i] = fan.log_prior[i] if start.status < SUNK else -math.inf
        state.means[i] = start.mean
        for p in range(ETA):
            state.means[i, p] += base[p] - own[p]  # keeps the motion about the settled height
            start.cov[p, p] += rules.start[p]
            for q in range(ETA):
                start.cov[p, q] += DISTRUST * cov[p, q]
        state.covs[i], state.warms[i] = start.cov, start.warm
    state.watch[:] = 0.0
    state.window[:] = 0.0
    state.best[0] = 0
    normalise(state.log_weights)


@kernel
def bank_step(
    state: BankState,
    inputs: FloatArray,
    z: FloatArray,
    rules: BankRules,
    model: JointModel,
    out: FloatArray,
) -> BankCounts:
    """One sample for every component, in place.

    ``inputs`` and ``z`` as in `estimators.filters.joint_ukf.joint_step`; ``out`` receives the report, columns
    of `estimators.filters.gaussian_sum`.
    """
    K = state.log_weights.shape[0]
    nis, before = np.full(K, math.nan), state.log_weights.copy()
    etas, variances = state.means[:, ETA].copy(), state.covs[:, ETA, ETA].copy()
    repairs = failed = renewed = 0
    for i in range(K):
        if before[i] > -math.inf:
            update = joint_step(state.means[i], state.covs[i], state.warms[i], inputs, z, model)
            nis[i] = update.nis
            repairs += update.repairs
            failed += 1 if update.status >= SUNK else 0
            state.log_weights[i] += update.log_likelihood
    weigh(state.log_weights, before)
    channels = np.isfinite(z).sum()
    if channels > 0:
        update_nis_test(state, nis, float(channels), rules, model.dt)
        changed = _soil_changed(state, etas, variances, rules, model)
        if (changed or state.watch[EXCESS] > rules.renew) and state.watch[AGE] > rules.watch_time:
            _renew(state, rules, model)
            renewed = 1
    report_sum(state, nis, rules, model, out)
    return BankCounts(repairs, failed, renewed)


@kernel
def _run(
    state: BankState,
    inputs: FloatArray,
    z: FloatArray,
    rules: BankRules,
    model: JointModel,
    history: BankRecord,
) -> BankCounts:
    """The loop behind `run_bank`."""
    repairs = failed = renewed = 0
    unknown = np.full(state.log_weights.shape[0], math.nan)
    report_sum(state, unknown, rules, model, history.report[0])
    for k in range(z.shape[0]):
        if k > 0:
            step = inputs[2 * k - 2 : 2 * k + 1]
            counts = bank_step(state, step, z[k], rules, model, history.report[k])
            repairs += counts.repairs
            failed += counts.failed
            renewed += counts.renewed
            if k % TIDY == 0:
                prune_and_merge(state, rules.log_drop, rules.merge)
        record_sum(state, history, k)
    return BankCounts(repairs, failed, renewed)


@dataclass(frozen=True, kw_only=True)
class BankHistory:
    """Belief of a bank of filters over a run. Row k belongs to the k-th sample; row 0 is the prior."""

    #: Of the whole sum about n; the NIS is weighted, the speed the heaviest component's.
    belief: BeliefHistory
    mode_weight: FloatArray  #: (T,) weight of the largest mode [-]
    surprise: FloatArray  #: (T,) mean excess of the innovations in standard deviations
    weights: FloatArray  #: (T, K) weights of the components, 0 for free places
    exponents: FloatArray  #: (T, K) n of the components [-]
    spreads: FloatArray  #: (T, K) their standard deviations, to first order [-]
    renewed: int  #: times that all components were drawn anew

    def modes(self, k: int) -> list[Mode]:
        """The modes of n at sample ``k``, heaviest first."""
        alive = np.flatnonzero(self.weights[k] > 0.0)
        alive = alive[np.argsort(self.exponents[k, alive])]
        groups: list[list[int]] = []
        reach = -math.inf
        for i in alive:
            spread = APART * self.spreads[k, i]
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


def bank_run(model: Ranged, history: BankRecord, counts: BankCounts) -> BankHistory:
    """A run from what its kernel recorded."""
    report, share = history.report, 1.0 / (1.0 + np.exp(-history.etas))
    span = model.high - model.low
    belief = BeliefHistory(
        t=model.dt * np.arange(len(report)),
        n=report[:, MEAN],
        sd=report[:, SD],
        low=report[:, LOW],
        high=report[:, HIGH],
        nis=report[:, NIS],
        valid=report[:, VALID] > 0.5,
        speed=history.speeds,
        repairs=int(counts.repairs),
        lost=int(counts.failed),
    )
    return BankHistory(
        belief=belief,
        mode_weight=report[:, MODE],
        surprise=report[:, SURPRISE],
        weights=np.exp(history.log_weights),
        exponents=model.low + span * share,
        spreads=span * share * (1.0 - share) * np.sqrt(history.variances),
        renewed=int(counts.renewed),
    )


def run_bank(
    model: JointModel,
    settings: BankSettings,
    inputs: FloatArray,
    z: FloatArray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
) -> BankHistory:
    """Filter a whole run with a bank that starts settled.

    Parameters
    ----------
    model : JointModel
        Of `estimators.models.half_car_on_map.joint_model`, made with ``settings.joint``.
    settings : BankSettings
    inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`.
    pose : (X, Y, yaw)
        At the start [m, m, rad].
    v_x : float
        Speed at the start [m/s].

    Raises
    ------
    InvalidParameter, SolverFailure
        For arrays that do not belong together, or a soil of the fan that does not carry the vehicle.
    """
    inputs, z = check_run(inputs, z)
    state, rules = start_bank(model, settings, pose, v_x), bank_rules(model, settings)
    history = empty_history(len(z), settings.components)
    counts = _run(state, inputs, z, rules, model, history)
    return bank_run(model, history, counts)
