"""Bank of augmented extended Kalman filters: n with every nuisance of the model in the belief.

Each component is an extended Kalman filter on the 26 numbers of `estimators.models.uncertain_half_car`. It is
linearised once a sample, where reading and next motion share the trial evaluations: 15 force
evaluations for the slopes and 4 for the mean, a fifth of what the unscented filter of
`estimators.filters.joint_ukf` needs for less than half of the states. What the linearisation cannot
represent, the several roots of the force, is left to the Gaussian sum (`estimators.filters.gaussian_sum`).

*The moduli and n are confounded.* The state holds the pressure at the depth where the wheels run in place of
the moduli (`estimators.models.uncertain_half_car.tie`). In the moduli themselves the two would rotate against
each other as n moves, and a linearised filter would take each turn for information that is not there.

*Validity.* The estimate is flagged valid while n is narrow in one mode, and while the innovations have no
lasting mean: noise so large that it covers errors which last hides a wrong model from a test of their size,
but not from a test of their mean (`_innovation_test`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from estimators.filters.gaussian_sum import (
    AGE,
    DISTRUST,
    EXCESS,
    TIDY,
    BankCounts,
    BankRecord,
    BankRules,
    BankState,
    check_fan,
    empty_bank,
    empty_history,
    exponent_fan,
    normalise,
    prune_and_merge,
    record_sum,
    report_sum,
    weigh,
)
from estimators.filters.innovation_test import chi_square_excess, fading_share, mean_innovation_test
from estimators.filters.joint_bank import BankHistory, bank_run
from estimators.filters.joint_ukf import JointUpdate
from estimators.filters.linearised import condition_mean, linear_step
from estimators.models.half_car_on_map import ETA, JointSettings, check_run
from estimators.models.uncertain_half_car import (
    CHANNELS,
    LENGTH,
    BodyInput,
    ModelUncertainty,
    UncertainModel,
    advance,
    body_input,
    linearise,
    process_noise,
    settled_belief,
)
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.records import FloatArray

__all__ = ["AugmentedBankSettings", "AugmentedHistory", "run_augmented_ekf_bank"]


@dataclass(frozen=True, kw_only=True)
class AugmentedBankSettings:
    """The fan of soils, what is uncertain about the model, and when the estimate is flagged valid."""

    joint: JointSettings = field(default_factory=JointSettings)  #: noise, start and range of n
    uncertainty: ModelUncertainty = field(default_factory=ModelUncertainty)  #: of the nuisances
    n_prior: float = 1.0  #: prior of n: the paper's first guess [-]
    n_prior_sd: float = 0.3  #: its standard deviation [-]
    n_fan: tuple[float, float] = (0.3, 1.3)  #: where the components stand [-]
    components: int = 20  #: soils in the fan
    overlap: float = 0.6  #: their standard deviation over their distance
    bump: float = 0.003  #: size of what the map lacks [m]
    drop: float = 1e-6  #: weight below which a component is dropped
    merge: float = 1.0  #: squared Mahalanobis distance below which two are one

    sure: float = 0.99  #: weight that the largest mode must have for a valid estimate
    widest: float = 0.15  #: largest standard deviation of n for a valid estimate, as a share of n
    watch_time: float = 2.0  #: time over which innovations are averaged [s]
    surprise: float = 5.0  #: excess of their mean's chi-square in its standard deviations: not valid
    renew: float = 10.0  #: more than this draws all components anew

    def __post_init__(self) -> None:
        check_fan(self.n_fan, self.joint.n_range)
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
class AugmentedHistory:
    """Beliefs of the bank over a run, about n and about the nuisances."""

    bank: BankHistory
    means: FloatArray  #: (T, 26) mean of the sum, layout of `estimators.models.uncertain_half_car`
    sds: FloatArray  #: (T, 26) its standard deviations


class _Bank(NamedTuple):
    """The components with what extended Kalman filters keep from sample to sample."""

    sum: BankState
    slopes: FloatArray  #: (K, 26, 26) of motion, at the last sample
    mean_innovation: FloatArray  #: (7,) fading mean of the whitened innovations


class _Setting(NamedTuple):
    """What holds for every sample."""

    model: UncertainModel
    rules: BankRules
    bump: float  #: size of what the map lacks [m]


class _Sample(NamedTuple):
    """One step of the inputs and what was measured at its end."""

    inputs: FloatArray  #: (3, 3) (steer, F_u, NaN) at the start, middle and end
    z: FloatArray  #: (7,) NaN where nothing was measured
    present: np.ndarray  #: (m,) channels that were measured


class _Record(NamedTuple):
    """A run, to be filled."""

    history: BankRecord
    means: FloatArray  #: (T, 26)
    sds: FloatArray  #: (T, 26)


def _rules(model: UncertainModel, settings: AugmentedBankSettings) -> BankRules:
    """The settings as the kernels need them."""
    prior = (settings.n_prior, settings.n_prior_sd)
    return BankRules(
        log_drop=math.log(settings.drop),
        merge=float(settings.merge),
        sure=float(settings.sure),
        widest=math.inf,  # judged relative to n, see `run_augmented_ekf_bank`
        watch_time=float(settings.watch_time),
        surprise=float(settings.surprise),
        renew=float(settings.renew),
        change_time=float(settings.watch_time),
        change_level=math.inf,  # its errors last, so its updates are not white
        fan=exponent_fan(
            settings.n_fan, settings.components, settings.overlap, prior, (model.low, model.high)
        ),
        start=np.empty(0),
    )


@kernel
def _settle(
    bank: _Bank, setting: _Setting, pose: tuple[float, float, float], v_x: float, u: BodyInput
) -> int:
    """Every soil of the fan settled on its own, in place; returns how many do not carry the vehicle."""
    state, fan = bank.sum, setting.rules.fan
    H, out = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS)
    failed = 0
    for i in range(fan.etas.shape[0]):
        start = settled_belief(setting.model, fan.etas[i], fan.variances[i], setting.bump, pose, v_x)
        slopes = bank.slopes[i]
        status = max(start.status, linearise(start.mean, start.warm, u, setting.model, slopes, H, out))
        state.means[i], state.covs[i], state.warms[i, 0] = start.mean, start.cov, start.warm
        sound = status < SUNK and np.isfinite(start.cov).all() and np.isfinite(slopes).all()
        state.log_weights[i] = fan.log_prior[i] if sound else -math.inf
        failed += 0 if sound else 1
    normalise(state.log_weights)
    state.watch[:] = 0.0
    return failed


@kernel
def _component_step(
    mean: FloatArray,
    cov: FloatArray,
    warm: FloatArray,
    slopes: FloatArray,
    sample: _Sample,
    setting: _Setting,
    innovation: FloatArray,
) -> JointUpdate:
    """One sample of one component, in place.

    ``slopes`` (26, 26) of motion at the last sample are renewed; ``innovation`` (m,) receives the whitened
    innovation. With a status of SUNK or worse the belief is as before.
    """
    model, index = setting.model, sample.present
    point, A = mean.copy(), np.empty((LENGTH, LENGTH))
    H, out, Q = np.empty((CHANNELS, LENGTH)), np.empty(CHANNELS), np.empty(LENGTH)
    status = advance(point, warm, sample.inputs, model)
    if status < SUNK and np.isfinite(point).all():
        status = max(status, linearise(point, warm, body_input(sample.inputs, model.dt), model, A, H, out))
    if not (status < SUNK and np.isfinite(A).all() and np.isfinite(H).all() and np.isfinite(point).all()):
        warm[:, 0] = 0.0  # a failed solve is no start for the next one
        return JointUpdate(-math.inf, math.nan, 0, SUNK)
    F = np.eye(LENGTH) + slopes * model.dt + (slopes @ slopes) * (0.5 * model.dt * model.dt)
    process_noise(point[at.V_X], setting.bump, model, Q)
    step = linear_step(cov, F, H[index], Q, model.R[index])
    mean[:], slopes[:] = point, A
    if index.shape[0] == 0:
        return JointUpdate(0.0, math.nan, step.repairs, status)
    innovation[:] = (sample.z - out)[index]
    evidence = condition_mean(mean, step, innovation)
    return JointUpdate(evidence.log_likelihood, evidence.nis, step.repairs, status)


@kernel
def _innovation_test(bank: _Bank, innovations: FloatArray, index: FloatArray, setting: _Setting) -> None:
    """Innovation test of the sum: chi-square of the mean of the whitened ``innovations`` (K, m), in place.

    Errors that last are in the noise already, so the mean of a right model is zero.
    """
    state, m, watch_time = bank.sum, index.shape[0], setting.rules.watch_time
    mixed, mean = np.zeros(m), bank.mean_innovation[index]
    for i in range(innovations.shape[0]):
        if state.log_weights[i] > -math.inf:
            w = math.exp(state.log_weights[i])
            for j in range(m):
                mixed[j] += w * innovations[i, j]
    variance = np.full(m, setting.model.dt / (2.0 * watch_time))
    total = mean_innovation_test(mean, mixed, variance, fading_share(setting.model.dt, watch_time))
    for j in range(m):
        bank.mean_innovation[index[j]] = mean[j]
    state.watch[EXCESS] = chi_square_excess(total, float(m))
    state.watch[AGE] += setting.model.dt


@kernel
def _renew(bank: _Bank, setting: _Setting, u: BodyInput) -> None:
    """Draw all components anew at place and speed of the best one, every nuisance at its prior again."""
    state = bank.sum
    best = np.argmax(state.log_weights)
    base, cov = state.means[best].copy(), state.covs[best].copy()
    pose = (base[at.X], base[at.Y], base[at.YAW])
    _settle(bank, setting, pose, max(base[at.V_X], 0.0), u)
    for i in range(state.log_weights.shape[0]):
        for p in (at.V_Y, at.YAW_RATE):
            state.means[i, p] = base[p]
        for p in range(ETA):
            state.covs[i, p, p] += DISTRUST * cov[p, p]
    bank.mean_innovation[:] = 0.0


@kernel
def _step(bank: _Bank, sample: _Sample, setting: _Setting, out: FloatArray) -> BankCounts:
    """One sample for every component, in place; ``out`` receives the report."""
    state, rules, model = bank.sum, setting.rules, setting.model
    K = state.log_weights.shape[0]
    nis, before = np.full(K, math.nan), state.log_weights.copy()
    innovations = np.zeros((K, sample.present.shape[0]))
    repairs = failed = renewed = 0
    for i in range(K):
        if before[i] > -math.inf:
            update = _component_step(
                state.means[i],
                state.covs[i],
                state.warms[i, 0],
                bank.slopes[i],
                sample,
                setting,
                innovations[i],
            )
            nis[i] = update.nis
            repairs += update.repairs
            failed += 1 if update.status >= SUNK else 0
            state.log_weights[i] += update.log_likelihood
    weigh(state.log_weights, before)
    if sample.present.shape[0] > 0:
        _innovation_test(bank, innovations, sample.present, setting)
        if state.watch[EXCESS] > rules.renew and state.watch[AGE] > rules.watch_time:
            _renew(bank, setting, body_input(sample.inputs, model.dt))
            renewed = 1
    report_sum(state, nis, rules, model, out)
    return BankCounts(repairs, failed, renewed)


@kernel
def _state_moments(state: BankState, means: FloatArray, sds: FloatArray) -> None:
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
def _run(bank: _Bank, inputs: FloatArray, z: FloatArray, setting: _Setting, record: _Record) -> BankCounts:
    """The loop behind `run_augmented_ekf_bank`."""
    state, rules, report = bank.sum, setting.rules, record.history.report
    repairs = failed = renewed = 0
    unknown = np.full(state.log_weights.shape[0], math.nan)
    report_sum(state, unknown, rules, setting.model, report[0])
    for k in range(z.shape[0]):
        if k > 0:
            sample = _Sample(inputs[2 * k - 2 : 2 * k + 1], z[k], np.flatnonzero(np.isfinite(z[k])))
            counts = _step(bank, sample, setting, report[k])
            repairs += counts.repairs
            failed += counts.failed
            renewed += counts.renewed
            if k % TIDY == 0:
                prune_and_merge(state, rules.log_drop, rules.merge)
        record_sum(state, record.history, k)
        _state_moments(state, record.means[k], record.sds[k])
    return BankCounts(repairs, failed, renewed)


def run_augmented_ekf_bank(
    model: UncertainModel,
    settings: AugmentedBankSettings,
    inputs: FloatArray,
    z: FloatArray,
    *,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    v_x: float,
) -> AugmentedHistory:
    """Filter a whole run with a bank that starts settled and takes its model as uncertain.

    Parameters
    ----------
    model : UncertainModel
        Of `estimators.models.uncertain_half_car.uncertain_model`, made with ``settings.joint`` and
        ``settings.uncertainty``.
    settings : AugmentedBankSettings
    inputs, z
        As in `estimators.filters.joint_ukf.run_joint_filter`; position and course of ``z`` are not used.
    pose : (X, Y, yaw)
        At the start, on the map [m, m, rad].
    v_x : float
        Speed at the start [m/s].

    Raises
    ------
    InvalidParameter, SolverFailure
        For arrays that do not belong together, or when no soil of the fan carries the vehicle.
    """
    inputs, z = check_run(inputs, z)
    T, K = len(z), settings.components
    setting = _Setting(model, _rules(model, settings), float(settings.bump))
    bank = _Bank(empty_bank(K, LENGTH, 1), np.empty((K, LENGTH, LENGTH)), np.zeros(CHANNELS))
    rate = (inputs[2, 0] - inputs[0, 0]) / model.dt
    X, Y, yaw = pose
    place, u = (float(X), float(Y), float(yaw)), BodyInput(inputs[0, 0], inputs[0, 1], rate)
    if _settle(bank, setting, place, float(v_x), u) == K:
        raise SolverFailure("no soil of the fan carries the vehicle: move n_fan")
    record = _Record(empty_history(T, K), np.empty((T, LENGTH)), np.empty((T, LENGTH)))
    counts = _run(bank, inputs, np.ascontiguousarray(z[:, :CHANNELS]), setting, record)
    bank_history = bank_run(model, record.history, counts)
    belief = bank_history.belief
    flagged = replace(belief, valid=belief.flag & (belief.sd <= settings.widest * belief.n))
    return AugmentedHistory(bank=replace(bank_history, belief=flagged), means=record.means, sds=record.sds)
