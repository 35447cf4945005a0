"""Every filter for n under one protocol: the same twins, prior, noise and score.

A twin (`estimators.protocol_runs.row_twin`) is a true drive with noise in start, motion and sensors.
Each function of `FILTERS` runs one filter on it and reports the same things; all start from the same
prior of n, N(1.0, 0.3^2), settled on the soil that they believe in. Only the paper's parameter filter
keeps its own narrower prior, with which its settings were found.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from estimators.bank import BankSettings, run_bank
from estimators.bounds import posterior_bound
from estimators.consistency import coverage, surprise
from estimators.ekf import run_ekf
from estimators.joint import ETA, JointModel, JointRun, JointSettings, prior, run_joint_filter
from estimators.paper import CHOICES, KNOWN_SETTINGS, SETTINGS, row_plant
from estimators.parameter import ParameterSettings, run_parameter_filter
from estimators.particle import ParticleSettings, run_particles
from estimators.protocol_runs import SENSORS, RowTwin, row_model
from estimators.scores import SETTLED, mean_square_error, time_to_5pct
from estimators.smoother import run_smoother
from estimators.transforms import interval
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.simulator import settled_state

__all__ = [
    "FILTERS",
    "WRONG",
    "RowFilter",
    "RowOutcome",
    "RowScore",
    "ends_wrong",
    "innovation_flag",
    "row_bound",
    "run_filter",
    "score_run",
    "scored",
]

#: Prior of n shared by all filters that estimate the state too: the bank's.
_PRIOR = (BankSettings().n_prior, BankSettings().n_prior_sd)
#: A filter without a validity flag of its own is believed while its 99 % interval is narrower than the
#: distance between two soils that pull alike on clay, and its innovations are as large as they should be.
_NARROW = 0.08
_SURPRISE = 5.0
_WATCH_TIME = 2.0
_Z_99 = 2.575829
_START_POSE = (0.0, 0.0, 0.0)
#: Error of n beyond which an estimate belongs to another soil [-].
WRONG = 0.05


class RowOutcome(NamedTuple):
    """What a filter believed on one twin."""

    n: np.ndarray  #: (T,) mean of n [-]
    sd: np.ndarray  #: (T,) its standard deviation [-]
    low: np.ndarray  #: (T,) lower end of the 95 % interval [-]
    high: np.ndarray  #: (T,) its upper end [-]
    nis: np.ndarray  #: (T,) normalised innovation squared
    valid: np.ndarray  #: (T,) bool: the filter vouches for mean and interval
    channels: int  #: measured at each update
    repairs: int  #: repaired factorisations
    lost: int  #: samples or particles left out because some point had no contact solution
    seconds: float  #: processor time [s]


class RowFilter(NamedTuple):
    """One filter of the comparison."""

    title: str
    module: str  #: whose sources its results depend on
    run: Callable[[RowTwin, str, JointSettings], RowOutcome]  #: (twin, sensors, noise settings)


def innovation_flag(run_nis: np.ndarray, width: np.ndarray, channels: int, dt: float) -> np.ndarray:
    """Validity (T,) of a filter without a flag of its own, from NIS (T,) and width of its 99 % interval."""
    calm = surprise(run_nis, channels, dt, _WATCH_TIME) <= _SURPRISE
    late = dt * np.arange(len(width)) > _WATCH_TIME
    return calm & late & (width <= _NARROW)


def _channels(z: np.ndarray) -> int:
    """Channels of every sample; those of GNSS, which come now and then, are judged apart."""
    return int(np.isfinite(z).all(axis=0).sum())


def _only_full(nis: np.ndarray, z: np.ndarray, channels: int) -> np.ndarray:
    """NIS of the samples that measured ``channels`` channels, NaN elsewhere."""
    return np.where(np.isfinite(z).sum(axis=1) == channels, nis, math.nan)


def _gaussian(run: JointRun, model: JointModel, z: np.ndarray, seconds: float) -> RowOutcome:
    eta, variance = run.means[:, ETA], run.covariances[:, ETA, ETA]
    ends = [interval(e, v, model.low, model.high, _Z_99) for e, v in zip(eta, variance, strict=True)]
    channels = _channels(z)
    nis = _only_full(run.nis, z, channels)
    return RowOutcome(
        n=run.n,
        sd=run.sd,
        low=run.low,
        high=run.high,
        nis=nis,
        valid=innovation_flag(nis, np.diff(ends, axis=1)[:, 0], channels, model.dt),
        channels=channels,
        repairs=run.repairs,
        lost=run.skipped,
        seconds=seconds,
    )


def _start(model: JointModel, settings: JointSettings, n: float = _PRIOR[0], sd: float = _PRIOR[1]):
    return prior(model, settings, n, sd, _START_POSE, CHOICES["start_speed"].value)


def _joint(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    model, z = row_model(twin.row, settings), twin.readings(sensors)
    start, begin = _start(model, settings), time.process_time()
    run = run_joint_filter(model, start, twin.inputs, z)
    return _gaussian(run, model, z, time.process_time() - begin)


def _ekf(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    model, z = row_model(twin.row, settings), twin.readings(sensors)
    start, begin = _start(model, settings), time.process_time()
    run = run_ekf(model, start, twin.inputs, z)
    return _gaussian(run, model, z, time.process_time() - begin)


def _bank(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    model, z, own = row_model(twin.row, settings), twin.readings(sensors), BankSettings(joint=settings)
    begin = time.process_time()
    run = run_bank(model, own, twin.inputs, z, pose=_START_POSE, v_x=CHOICES["start_speed"].value)
    seconds, channels = time.process_time() - begin, _channels(z)
    return RowOutcome(
        n=run.n,
        sd=run.sd,
        low=run.low,
        high=run.high,
        nis=_only_full(run.nis, z, channels),
        valid=run.valid,
        channels=channels,
        repairs=run.repairs,
        lost=run.failed,
        seconds=seconds,
    )


def _particles(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    model, z, own = row_model(twin.row, settings), twin.readings(sensors), ParticleSettings(joint=settings)
    begin = time.process_time()
    run = run_particles(
        model, own, twin.inputs, z, pose=_START_POSE, v_x=CHOICES["start_speed"].value, seed=twin.seed
    )
    seconds, channels = time.process_time() - begin, _channels(z)
    nis = _only_full(run.nis, z, channels)
    return RowOutcome(
        n=run.n,
        sd=run.sd,
        low=run.low,
        high=run.high,
        nis=nis,
        valid=innovation_flag(nis, run.width, channels, model.dt),
        channels=channels,
        repairs=run.repairs,
        lost=run.failed,
        seconds=seconds,
    )


def _smoother(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    """Started at the soil where the bank ends: a reference for the width of the peak, not a search.

    The settled start is linearised there, since it bends too much from 1.0 to the truth.
    """
    model, z = row_model(twin.row, settings), twin.readings(sensors)
    begin = time.process_time()
    end = _bank(twin, sensors, settings)
    n = float(np.clip(end.n[-1], model.low + 0.02, model.high - 0.02))
    guess = run_joint_filter(model, _start(model, settings, n, 0.02), twin.inputs, z)
    done = run_smoother(model, _start(model, settings, n), twin.inputs, z, guess.means)
    return _gaussian(done.run, model, z, time.process_time() - begin)


def _parameter(twin: RowTwin, settings: ParameterSettings, *, known: bool) -> RowOutcome:
    plant = row_plant(twin.row, n=settings.n_prior)
    start = settled_state(plant, v_x=CHOICES["start_speed"].value)
    states = None
    if known:
        states = np.zeros((len(twin.z), at.STATE_SIZE))
        states[:, :ETA] = twin.truth[:, :ETA]
    begin = time.process_time()
    run = run_parameter_filter(plant, start, twin.inputs, twin.z[:, :5], twin.dt, settings, known=states)
    seconds, channels = time.process_time() - begin, 5
    low, high = settings.n_range
    ends = [
        (*interval(e, v, low, high), *interval(e, v, low, high, _Z_99))
        for e, v in zip(run.eta, run.variance, strict=True)
    ]
    ends = np.array(ends)
    return RowOutcome(
        n=run.n,
        sd=run.sd,
        low=ends[:, 0],
        high=ends[:, 1],
        nis=run.nis,
        valid=innovation_flag(run.nis, ends[:, 3] - ends[:, 2], channels, twin.dt),
        channels=channels,
        repairs=run.repairs,
        lost=run.skipped,
        seconds=seconds,
    )


def _propagated(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    return _parameter(twin, SETTINGS["half_car"], known=False)


def _known(twin: RowTwin, sensors: str, settings: JointSettings) -> RowOutcome:
    return _parameter(twin, KNOWN_SETTINGS["half_car"], known=True)


FILTERS: dict[str, RowFilter] = {
    "propagated": RowFilter("parameter UKF, state propagated", "estimators.paper", _propagated),
    "known": RowFilter("parameter UKF, state known", "estimators.paper", _known),
    "joint": RowFilter("joint UKF", "estimators.joint", _joint),
    "ekf": RowFilter("EKF", "estimators.ekf", _ekf),
    "particle": RowFilter("particle filter", "estimators.particle", _particles),
    "bank": RowFilter("bank of joint UKF", "estimators.bank", _bank),
    "smoother": RowFilter("batch smoother (reference)", "estimators.smoother", _smoother),
}
#: Filters that look at the inertial unit only.
_IMU_ONLY = ("propagated", "known")


def run_filter(
    name: str, twin: RowTwin, *, sensors: str = "imu", settings: JointSettings | None = None
) -> RowOutcome:
    """Run one of `FILTERS` on a twin.

    Parameters
    ----------
    name : str
        Key of `FILTERS`.
    twin : RowTwin
        Drawn with the same ``settings``.
    sensors : str
        One of `protocol_runs.SENSORS`; the parameter filter takes "imu" only.
    settings : JointSettings, optional
        Noise that the filter believes in; default: the one setting for all rows.
    """
    if name not in FILTERS:
        raise InvalidParameter(f"filter must be one of {', '.join(FILTERS)}, got {name!r}")
    if sensors not in SENSORS or (name in _IMU_ONLY and sensors != "imu"):
        raise InvalidParameter(f"the filter {name} cannot use the sensors {sensors!r}")
    return FILTERS[name].run(twin, sensors, settings or JointSettings())


def row_bound(twin: RowTwin, *, sensors: str = "imu", settings: JointSettings | None = None) -> np.ndarray:
    """Posterior Cramer-Rao bound on sd(n) along a twin, with the Q and P0 of the filters, (T,) [-]."""
    settings = settings or JointSettings()
    model = row_model(twin.row, settings)
    start = _start(model, settings, float(twin.n[0]))
    return posterior_bound(model, start, twin.truth, twin.inputs, twin.readings(sensors))


class RowScore(NamedTuple):
    """One run of one filter against its truth."""

    mse: float  #: mean square error of n over the run [-]
    late_mse: float  #: after 20 s [-]; NaN for shorter runs
    coverage: float  #: share of the time with the truth inside the 95 % interval
    coverage_late: float  #: after 20 s
    coverage_valid: float  #: while the flag is up
    valid: float  #: share of the time that the flag is up
    nis: float  #: mean normalised innovation squared
    nis_count: int  #: updates in that mean
    channels: int  #: its expectation for a consistent filter
    time_to_5pct: float  #: from here on the error stays below 5 % [s]; inf when it does not
    end: float  #: last estimate [-]
    end_sd: float  #: its standard deviation [-]
    wrong: bool  #: vouches at the end for another soil than the true one
    repairs: int
    lost: int
    seconds: float  #: processor time [s]
    updates: int


def ends_wrong(outcome: RowOutcome, twin: RowTwin) -> bool:
    """Whether the filter vouches at the end for an estimate that belongs to another soil."""
    return bool(outcome.valid[-1] and abs(outcome.n[-1] - twin.n[-1]) > WRONG)


def score_run(outcome: RowOutcome, twin: RowTwin) -> RowScore:
    """The numbers of one line of the table."""
    error, late = outcome.n - twin.n, twin.t >= SETTLED
    finite = np.isfinite(outcome.nis)
    inside = (outcome.low, outcome.high, twin.n)
    return RowScore(
        mse=mean_square_error(outcome.n, twin.n),
        late_mse=float(np.mean(error[late] ** 2)) if late.any() else math.nan,
        coverage=coverage(*inside),
        coverage_late=coverage(*inside, late),
        coverage_valid=coverage(*inside, outcome.valid),
        valid=float(outcome.valid.mean()),
        nis=float(outcome.nis[finite].mean()) if finite.any() else math.nan,
        nis_count=int(finite.sum()),
        channels=outcome.channels,
        time_to_5pct=time_to_5pct(twin.t, outcome.n, twin.n),
        end=float(outcome.n[-1]),
        end_sd=float(outcome.sd[-1]),
        wrong=ends_wrong(outcome, twin),
        repairs=outcome.repairs,
        lost=outcome.lost,
        seconds=outcome.seconds,
        updates=len(twin.z) - 1,
    )


def failed_score(twin: RowTwin) -> RowScore:
    """Score of a filter that stopped: an infinite error, never vouched for."""
    worst = math.inf
    return RowScore(
        worst, worst, 0.0, 0.0, math.nan, 0.0, math.nan, 0, 5, worst, math.nan, worst, False, 0, 0, 0.0,
        len(twin.z) - 1,
    )  # fmt: skip


def scored(name: str, twin: RowTwin, **kwargs) -> RowScore:
    """Run a filter and score it; one that finds no solution any more counts as failed."""
    try:
        return score_run(run_filter(name, twin, **kwargs), twin)
    except SolverFailure:
        return failed_score(twin)
