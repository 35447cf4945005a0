"""Every filter on a truth that it does not believe in, and what its estimate was worth.

=============  ================================================================================
``bank``       `estimators.bank`: many soils, one exact model; inertial unit
``robust``     `estimators.robust`: many soils, every nuisance in the belief; inertial unit, rims
``embedded``   `estimators.embedded`: n alone, constant gains; inertial unit, rim speeds, GNSS
``propagated`` the paper's: n alone, its own state; inertial unit
=============  ================================================================================

The propagated filter has no validity flag of its own: it gets that of `row_filters.innovation_flag`,
which looks at the size of its innovations and the width of its interval.

All but the robust bank believe their model exactly, and what they say holds given that model. What a
user can go by is that together with a second opinion (`estimators.second_opinion`): `run_filter` gives
the filter's own word, `in_doubt` the pair of standard deviation and flag that doubts the model.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimators.bank import (
    HIGH,
    LOW,
    MEAN,
    REPORT,
    SD,
    VALID,
    BankSettings,
    bank_rules,
    bank_step,
    report_sum,
    start_bank,
    tidy,
)
from estimators.consistency import coverage
from estimators.embedded import EmbeddedParameterUKF
from estimators.joint import IMU_CHANNELS, JointSettings, joint_model
from estimators.mismatch import MismatchTwin
from estimators.nuisances import doubt_model
from estimators.paper import CHOICES, SETTINGS
from estimators.parameter import run_parameter_filter
from estimators.protocol import Pose
from estimators.protocol_runs import row_plant
from estimators.robust import RobustSettings, run_robust_bank
from estimators.row_filters import innovation_flag
from estimators.second_opinion import OpinionSettings, form_opinion
from estimators.transforms import interval
from offroad_env.physics import state as at
from offroad_env.sensors import ImuConfig
from offroad_env.simulator import settled_state

__all__ = [
    "FILTERS",
    "Belief",
    "Candidate",
    "MismatchSummary",
    "Verdict",
    "in_doubt",
    "judge",
    "run_filter",
    "summarise_verdicts",
]

_SPEED = CHOICES["start_speed"].value
_POSE = (0.0, 0.0, 0.0)
#: Samples between two looks at the components of the bank, as in `estimators.bank`.
_TIDY = 10
_NORMAL_95, _NORMAL_99 = 1.959964, 2.575829
#: An error of n beyond this share, outside of the interval and vouched for, is a silent divergence.
_DIVERGED = 0.2
#: ... when it lasts so long [s].
_LASTING = 2.0


class Belief(NamedTuple):
    """What a filter said about n."""

    n: np.ndarray  #: (T,) [-]
    sd: np.ndarray  #: (T,) [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval [-]
    high: np.ndarray  #: (T,) its upper end [-]
    valid: np.ndarray  #: (T,) bool
    speed: np.ndarray  #: (T,) forward speed that it believes in [m/s]
    seconds: float  #: processor time [s]


class Verdict(NamedTuple):
    """What the estimate of one run was worth; shares over time, errors relative to the true n."""

    filter: str
    mismatch: str
    row: int
    seed: int
    errors: list[float]  #: quantiles 0.05, 0.10 ... 0.95 of the error while the flag is up [-]
    flagged: int  #: samples with the flag up
    covered: float  #: share of them whose 95 % interval holds the truth; NaN for none
    flag_excited: float  #: share of the excited time with the flag up; NaN where nothing excites
    excited: int  #: excited samples
    error_all: float  #: median error over the whole run, flag or not [-]
    covered_all: float  #: coverage over the whole run
    end_error: float  #: signed error at the end [-]
    end_sd: float  #: standard deviation that the filter claims there, relative to n [-]
    silent: bool  #: for 2 s in all it vouched for more than 20 % error, outside of its own interval
    real_time_factor: float  #: simulated seconds per processor second


def _bank(twin: MismatchTwin, seen: np.ndarray) -> tuple[np.ndarray, ...]:
    """The loop of `bank.run_bank`, which keeps no speeds."""
    settings = BankSettings()
    model = joint_model(row_plant(twin.row), twin.dt, settings.joint)
    state, rules = start_bank(model, settings, _POSE, _SPEED), bank_rules(model, settings)
    report, speed = np.empty((len(seen), REPORT)), np.full(len(seen), _SPEED)
    kinds = np.zeros(settings.components, np.int64)
    report_sum(state, np.full(settings.components, math.nan), rules, model, report[0])
    for k in range(1, len(seen)):
        bank_step(state, twin.inputs[2 * k - 2 : 2 * k + 1], seen[k], rules, model, report[k])
        if k % _TIDY == 0:
            tidy(state, rules.log_drop, rules.merge, kinds)
        speed[k] = state.means[np.argmax(state.log_weights), at.V_X]
    return *report[:, [MEAN, SD, LOW, HIGH]].T, report[:, VALID] > 0.5, speed


def _robust(twin: MismatchTwin, seen: np.ndarray) -> tuple[np.ndarray, ...]:
    settings = RobustSettings()
    model = doubt_model(row_plant(twin.row), twin.dt, settings.joint, settings.doubt)
    run = run_robust_bank(model, settings, twin.inputs, seen, pose=_POSE, v_x=_SPEED)
    bank = run.bank
    return bank.n, bank.sd, bank.low, bank.high, bank.valid, run.means[:, at.V_X]


def _embedded(twin: MismatchTwin, seen: np.ndarray) -> tuple[np.ndarray, ...]:
    low, high = JointSettings().n_range
    unit = ImuConfig(body_axes=False)
    estimator = EmbeddedParameterUKF(row_plant(twin.row), (low, high), dt=twin.dt, imu=unit)
    estimates = [estimator.reset(SETTINGS["half_car"].n_prior, 0.25, Pose(*_POSE, _SPEED))]
    speed = np.full(len(seen), _SPEED)
    for k in range(1, len(seen)):
        steer, force, _ = twin.inputs[2 * k - 1]
        z = seen[k]
        estimates.append(estimator.update((float(steer), float(force), 0.0), z[:5], z[5:7], z[7:]))
        speed[k] = estimator.pose.v
    n, sd = (np.array([getattr(e, name) for e in estimates]) for name in ("mean", "sd"))
    valid = np.array([e.valid for e in estimates])
    return n, sd, n - _NORMAL_95 * sd, n + _NORMAL_95 * sd, valid, speed


def _propagated(twin: MismatchTwin, seen: np.ndarray) -> tuple[np.ndarray, ...]:
    settings = SETTINGS["half_car"]
    plant = row_plant(twin.row)
    plant = plant._replace(soil=plant.soil._replace(n=settings.n_prior))
    start = settled_state(plant, v_x=_SPEED)
    run = run_parameter_filter(plant, start, twin.inputs, seen[:, :5], twin.dt, settings)
    beliefs = list(zip(run.eta, run.variance, strict=True))
    low, high = np.transpose([interval(eta, v, *settings.n_range) for eta, v in beliefs])
    wide = np.array([interval(eta, v, *settings.n_range, _NORMAL_99) for eta, v in beliefs])
    valid = innovation_flag(run.nis, wide[:, 1] - wide[:, 0], IMU_CHANNELS, twin.dt)
    return run.n, run.sd, low, high, valid, run.states[:, at.V_X]


class Candidate(NamedTuple):
    """A filter of the study."""

    loop: Callable[[MismatchTwin, np.ndarray], tuple[np.ndarray, ...]]  #: all of `Belief` but its seconds
    sensors: str  #: that it sees, see `protocol_runs.SENSORS`
    module: str  #: that it lives in
    title: str
    exact: bool = True  #: it believes its model exactly


FILTERS: dict[str, Candidate] = {
    "robust": Candidate(_robust, "imu+wheels", "estimators.robust", "robust bank", False),
    "bank": Candidate(_bank, "imu", "estimators.bank", "plain bank"),
    "embedded": Candidate(_embedded, "imu+wheels+gnss", "estimators.embedded", "embedded UKF"),
    "propagated": Candidate(_propagated, "imu", "estimators.parameter", "propagated"),
}


def run_filter(name: str, twin: MismatchTwin) -> Belief:
    """Run one of `FILTERS` on a truth; what it believes about everything but n is the nominal row."""
    candidate = FILTERS[name]
    seen = twin.readings(candidate.sensors)
    begin = time.process_time()
    beliefs = candidate.loop(twin, seen)
    return Belief(*beliefs, seconds=time.process_time() - begin)


def in_doubt(name: str, twin: MismatchTwin, belief: Belief) -> Belief:
    """What a filter said, to somebody who doubts its model: `belief` itself where the filter does so.

    The second opinion has the filter's own model, sensors and speed.
    """
    if not FILTERS[name].exact:
        return belief
    begin = time.process_time()
    imu = twin.readings("imu")[:, :IMU_CHANNELS]
    opinion = form_opinion(row_plant(twin.row), OpinionSettings(), twin.inputs, imu, belief.speed, twin.dt)
    sd, trusted = opinion.doubted(belief.n, belief.sd, belief.valid)
    return belief._replace(
        sd=sd,
        low=np.minimum(belief.low, belief.n - _NORMAL_95 * sd),
        high=np.maximum(belief.high, belief.n + _NORMAL_95 * sd),
        valid=trusted,
        seconds=belief.seconds + time.process_time() - begin,
    )


def judge(name: str, twin: MismatchTwin, belief: Belief) -> Verdict:
    """Compare what a filter said with the truth."""
    signed = (belief.n - twin.n) / twin.n
    error, up = np.abs(signed), belief.valid
    inside = (belief.low <= twin.n) & (twin.n <= belief.high)
    wrong = up & (error > _DIVERGED) & ~inside
    flagged, acts = int(up.sum()), int(twin.excited.sum())
    return Verdict(
        filter=name,
        mismatch=twin.mismatch,
        row=twin.row.number,
        seed=twin.seed,
        errors=[float(q) for q in np.quantile(error[up], np.arange(0.05, 0.96, 0.05))] if flagged else [],
        flagged=flagged,
        covered=coverage(belief.low, belief.high, twin.n, up),
        flag_excited=float(up[twin.excited].mean()) if acts else math.nan,
        excited=acts,
        error_all=float(np.median(error)),
        covered_all=float(inside.mean()),
        end_error=float(signed[-1]),
        end_sd=float(belief.sd[-1] / twin.n[-1]),
        silent=bool(wrong.sum() * twin.dt >= _LASTING),
        real_time_factor=float(twin.t[-1] / max(belief.seconds, 1e-9)),
    )


class MismatchSummary(NamedTuple):
    """One filter under one mismatch, over rows and seeds."""

    filter: str
    mismatch: str
    runs: int
    error: float  #: median relative error of n over the time that the flag is up [-]
    error_high: float  #: its 90 % quantile
    coverage: float  #: of the 95 % interval over the same time
    flag: float  #: share of the excited time that the flag is up
    error_all: float  #: median over the runs of the median error, flag or not [-]
    coverage_all: float  #: of the 95 % interval over all time
    silent: int  #: runs that diverged silently
    real_time_factor: float  #: median over the runs


def summarise_verdicts(verdicts: Sequence[Verdict]) -> MismatchSummary:
    """A line of the table from the runs of one filter under one mismatch.

    Every run counts by the time that its flag is up; within a run its quantiles stand for that time.
    """
    first = verdicts[0]
    up = [v for v in verdicts if v.flagged]
    error = error_high = covered = math.nan
    if up:
        values = np.concatenate([v.errors for v in up])
        weights = np.concatenate([np.full(len(v.errors), v.flagged / len(v.errors)) for v in up])
        order = np.argsort(values)
        share = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
        error, error_high = (float(np.interp(q, share, values[order])) for q in (0.5, 0.9))
        covered = float(np.average([v.covered for v in up], weights=[v.flagged for v in up]))
    acting = [v for v in verdicts if v.excited]
    flag = np.average([v.flag_excited for v in acting], weights=[v.excited for v in acting])
    return MismatchSummary(
        filter=first.filter,
        mismatch=first.mismatch,
        runs=len(verdicts),
        error=error,
        error_high=error_high,
        coverage=covered,
        flag=float(flag) if acting else math.nan,
        error_all=float(np.median([v.error_all for v in verdicts])),
        coverage_all=float(np.mean([v.covered_all for v in verdicts])),
        silent=sum(v.silent for v in verdicts),
        real_time_factor=float(np.median([v.real_time_factor for v in verdicts])),
    )
