"""Errors of the settings of a rig: loads and slips are measured, too (errors in variables).

Repeats of a condition were meant to be alike, but their loads and slips scatter. A model that is compared
with every repeat at its own setting is rewarded for being insensitive to settings whose scatter is an error
of the measurement, or to which it answers too strongly. So all repeats are compared at the mean setting of
their condition, and what they differ by tells their noise alone. That mean has an error, too: a latent
setting of each condition (see `trial_model.RigModel`), whose prior follows from how much of the scatter is
error. Sinkage and forces that follow the settings of the repeats show that their scatter is real; the share
that is real is the reliability ratio (Fuller, Measurement Error Models, 1987, section 1.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.rig.trial_model import RigModel
from estimators.discrepancy.rig.trial_table import Trials, condition_means
from estimators.logs.log import Log
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at
from offroad_env.physics.contact import deepest_sinkage

__all__ = ["Reliability", "measured_trials", "reliability_of"]

#: Standard deviations below the estimate of a reliability: settings are believed no more than is certain.
_CERTAIN = 1.645

#: Steps of the derivatives: share of the load, slip.
_LOAD_STEP, _SLIP_STEP = 1e-3, 1e-4
#: Prior of a reliability: settings are what was measured, with this standard deviation.
_PRIOR = 0.5
#: Deeper than this share of the deepest sinkage the soil of the model may fail: no derivative.
_FAILING = 0.9
#: Fewer repeats in all, beyond one for each condition, tell nothing.
_FEWEST = 8


class Reliability(NamedTuple):
    """Share of the scatter between repeats that is real: 1 = measured without error, 0 = all error."""

    load: float
    slip: float


def measured_trials(logs: Sequence[Log]) -> Trials:
    """The trials of all logs at the mean settings of their conditions, with the errors of these means.

    Raises
    ------
    DataError
        As `Trials.of`.
    """
    trials = Trials.of(logs)
    try:
        real = reliability_of(logs[0], trials)
    except OffroadError:
        # A wheel that this soil cannot support has no derivatives to judge by.
        real = Reliability(0.0, 0.0)
    return _at_means(trials, real)


def reliability_of(log: Log, trials: Trials) -> Reliability:
    """Lower ends of the reliabilities of load and slip.

    From a regression of what repeats differ by on what the model makes of their different settings.

    Raises
    ------
    SolverFailure
        When the model cannot be run.
    """
    if len(trials) - len(np.unique(trials.condition)) < _FEWEST:
        return Reliability(0.0, 0.0)
    load, slip = (condition_means(trials.condition, own) for own in (trials.load, trials.slip))
    # A step away from a limit of the slip stays within it.
    step = np.where(slip > 0.0, -_SLIP_STEP, _SLIP_STEP)
    run = RigModel(log, replace(trials, load=load, slip=slip))
    heavier = RigModel(log, replace(trials, load=(1.0 + _LOAD_STEP) * load, slip=slip))
    slipping = RigModel(log, replace(trials, load=load, slip=slip + step))
    base, by_load, by_slip = (one.simulate(one.setup) for one in (run, heavier, slipping))
    deepest = deepest_sinkage(log.wheel.r)
    borne = by_load.readings[:, at.SINKAGE] < _FAILING * deepest
    borne &= base.readings[:, at.SINKAGE] < _FAILING * deepest
    changes = (
        (
            run.predict(run.setup, by_load) - run.predict(run.setup, base),
            _LOAD_STEP * load,
            trials.load - load,
        ),
        (run.predict(run.setup, by_slip) - run.predict(run.setup, base), step, trials.slip - slip),
    )
    normal, score = np.eye(2) / _PRIOR**2, np.full(2, 1.0 / _PRIOR**2)
    for channel in run.channels:
        own, group = channel.record, run.condition_of(channel)
        away = run.y[channel.rows] - condition_means(group, run.y[channel.rows])
        spare = len(own) - len(np.unique(group))
        variance = float(np.sum(away**2)) / max(spare, 1)
        if spare < 1 or variance <= 0.0:
            continue
        table = np.stack([c[channel.rows] / by[own] * moved[own] for c, by, moved in changes], axis=1)
        table = np.where(borne[own][:, None], table, 0.0)
        normal += table.T @ table / variance
        score += table.T @ away / variance
    covariance = np.linalg.inv(normal)
    low = covariance @ score - _CERTAIN * np.sqrt(np.diag(covariance))
    return Reliability(*np.clip(low, 0.0, 1.0).tolist())


def _at_means(trials: Trials, real: Reliability) -> Trials:
    """Settings at the means of their conditions, and the errors of these means."""
    load, load_error = _at_mean(trials, trials.load, real.load)
    slip, slip_error = _at_mean(trials, trials.slip, real.slip)
    return replace(trials, load=load, slip=slip, load_error=load_error, slip_error=slip_error)


def _at_mean(trials: Trials, values: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """A setting at the means of its conditions, and the errors of these means, (M,) each."""
    count = np.bincount(trials.condition)[trials.condition]
    spare = max(len(trials) - len(np.unique(trials.condition)), 1)
    mean = condition_means(trials.condition, values)
    scatter = np.sqrt(float(np.sum((values - mean) ** 2)) / spare)
    return mean, scatter * np.sqrt((1.0 - share) / count)
