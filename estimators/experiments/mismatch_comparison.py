"""Filters on a truth that differs from their model: error, coverage and validity flag.

The filters of `COMPARED` run on the rows of `estimators.experiments.model_mismatch`, each with the sensors
that it needs. All but the augmented bank take their model for exact, so interval and flag hold given that
model (`run_filter`). `robust_history` widens the interval and lowers the flag by the evidence that remains
for other soils once the model may be wrong (`estimators.filters.model_evidence`); that is what a user can go
by. The paper's filter has no validity flag of its own and gets that of
`estimators.analysis.consistency.innovation_flag`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.analysis.scores import Score, score
from estimators.experiments.buzhardt_tallapragada import CHOICES, SETTINGS, row_plant
from estimators.experiments.model_mismatch import MismatchedRow
from estimators.filters.belief_history import NORMAL_95, BeliefHistory
from estimators.filters.model_evidence import EvidenceSettings, model_evidence
from estimators.filters.protocol import Pose
from estimators.filters.registry import FILTERS, filter_id
from estimators.filters.whole_run import FilterRun
from estimators.filters.whole_run import run_filter as run_whole
from estimators.models.half_car_on_map import IMU_CHANNELS, JointSettings
from offroad_env.errors import InvalidParameter

__all__ = [
    "COMPARED",
    "MismatchScore",
    "MismatchSummary",
    "robust_history",
    "run_filter",
    "score_mismatch",
    "summarise_scores",
]

#: Ids of the filters that are compared.
COMPARED = ("augmented_ekf_bank", "map_ukf_bank", "online_parameter_ukf", "parameter_ukf")
#: Standard deviation of the online filter's prior [-].
_ONLINE_SD = 0.25


class MismatchScore(NamedTuple):
    """Score of one filter on one seed of a row under one mismatch."""

    filter: str
    mismatch: str
    row: int
    seed: int
    flag_excited: float  #: share of the excited time with the flag up; NaN without excitation
    excited: int  #: excited samples
    real_time_factor: float  #: simulated seconds per processor second
    score: Score


def run_filter(name: str, drive: MismatchedRow) -> BeliefHistory:
    """Run one of the `COMPARED` filters; its model is the nominal row.

    Parameters
    ----------
    name : str
        An id of `COMPARED`, or a short name.
    drive : MismatchedRow

    Raises
    ------
    InvalidParameter
        For another filter.
    """
    known = filter_id(name, COMPARED)
    run = FilterRun(
        plant=row_plant(drive.row),
        dt=drive.dt,
        inputs=drive.inputs,
        z=drive.readings(FILTERS[known].sensors),
        pose=Pose(0.0, 0.0, 0.0, CHOICES["start_speed"].value),
        parameter=SETTINGS["half_car"],
        n_range=JointSettings().n_range,
    )
    if FILTERS[known].make is not None:
        run = replace(run, n_prior=SETTINGS["half_car"].n_prior, sd=_ONLINE_SD)
    return run_whole(known, run)


def robust_history(name: str, drive: MismatchedRow, history: BeliefHistory) -> BeliefHistory:
    """A filter's history, robust to model errors: ``history`` itself where the filter's model has them.

    The evidence is computed with the filter's own model, sensors and speed.
    """
    if not FILTERS[filter_id(name, COMPARED)].exact_model:
        return history
    if history.speed is None or history.seconds is None:
        raise InvalidParameter("history must hold speed and seconds: run it by `run_filter`")
    begin = time.process_time()
    imu = drive.readings("imu")[:, :IMU_CHANNELS]
    posterior = model_evidence(
        row_plant(drive.row), EvidenceSettings(), drive.inputs, imu, history.speed, drive.dt
    )
    sd, valid = posterior.robust(history.n, history.sd, history.flag)
    return replace(
        history,
        sd=sd,
        low=np.minimum(history.low, history.n - NORMAL_95 * sd),
        high=np.maximum(history.high, history.n + NORMAL_95 * sd),
        valid=valid,
        seconds=history.seconds + time.process_time() - begin,
    )


def score_mismatch(name: str, drive: MismatchedRow, history: BeliefHistory) -> MismatchScore:
    """Compare a filter's history with the truth."""
    excited = int(drive.excited.sum())
    return MismatchScore(
        filter=filter_id(name, COMPARED),
        mismatch=drive.mismatch,
        row=drive.row.number,
        seed=drive.seed,
        flag_excited=float(history.flag[drive.excited].mean()) if excited else math.nan,
        excited=excited,
        real_time_factor=history.real_time_factor,
        score=score(history, drive.n),
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


def summarise_scores(runs: Sequence[MismatchScore]) -> MismatchSummary:
    """A line of the table from the runs of one filter under one mismatch.

    Every run counts by the time that its flag is up; within a run its quantiles stand for that time.
    """
    first = runs[0]
    up = [run.score for run in runs if run.score.flagged]
    error = error_high = covered = math.nan
    if up:
        values = np.concatenate([s.flagged_errors for s in up])
        weights = np.concatenate(
            [np.full(len(s.flagged_errors), s.flagged / len(s.flagged_errors)) for s in up]
        )
        order = np.argsort(values)
        share = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
        error, error_high = (float(np.interp(q, share, values[order])) for q in (0.5, 0.9))
        covered = float(np.average([s.coverage_valid for s in up], weights=[s.flagged for s in up]))
    acting = [run for run in runs if run.excited]
    flag = math.nan
    if acting:
        flag = float(np.average([r.flag_excited for r in acting], weights=[r.excited for r in acting]))
    return MismatchSummary(
        filter=first.filter,
        mismatch=first.mismatch,
        runs=len(runs),
        error=error,
        error_high=error_high,
        coverage=covered,
        flag=flag,
        error_all=float(np.median([run.score.median_error for run in runs])),
        coverage_all=float(np.mean([run.score.coverage for run in runs])),
        silent=sum(run.score.silent for run in runs),
        real_time_factor=float(np.median([run.real_time_factor for run in runs])),
    )
