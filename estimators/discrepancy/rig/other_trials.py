"""Transfer: the causes found on one wheel applied to trials of another, with nothing fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.checks.holdout_gain import ChannelGain
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.rig.fit import held_out_trials
from estimators.discrepancy.rig.settings import measured_trials
from estimators.discrepancy.rig.trial_model import RigModel
from estimators.discrepancy.rig.trial_table import Trials
from estimators.discrepancy.rig_diagnosis import UNITS, rig_gains
from estimators.discrepancy.verdict import RigDiagnosis
from estimators.logs.log import Log
from offroad_env.errors import DataError, OffroadError

__all__ = ["Transfer", "transfer_to"]


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """Errors on other trials of the model as stated, with n alone, and with the causes."""

    log: str
    trials: int
    left_out: int  #: trials that have no slip along the wheel, no load, or no solution in a model
    unit: dict[str, str]  #: of every channel
    stated: dict[str, float]  #: root mean square error of the model as the log states it, by channel
    gains: tuple[ChannelGain, ...]  #: of the causes over the nominal model, with the n that was fitted there


def transfer_to(diagnosis: RigDiagnosis, logs: Sequence[Log]) -> tuple[Transfer, ...]:
    """Errors on the trials of each log: laws, effects and n are those that the diagnosis found elsewhere.

    Raises
    ------
    DataError
        If a log holds no trials of a rig, or no trial has a solution.
    ValueError
        If nothing was fitted.
    """
    if diagnosis.search is None or diagnosis.model is None:
        raise ValueError("the diagnosis ended before a model was fitted: there is nothing to compare")
    nominal, model = diagnosis.search.nominal, diagnosis.model
    stated = nominal.moved(replace(nominal.point, nuisances=np.zeros(len(nominal.nuisances))))
    return tuple(_transfer((stated, nominal, model), log) for log in logs)


def _transfer(models: tuple[FitResult, FitResult, FitResult], log: Log) -> Transfer:
    """Errors of the stated, the nominal and the extended model on the trials of one log."""
    if not log.rig:
        raise DataError(f"{log.name}: holds a drive, not trials of a wheel rig")
    trials = measured_trials([log])
    borne = np.all([_borne(model, log, trials) for model in models], axis=0)
    if not borne.any():
        raise DataError(f"{log.name}: the models have no solution for any of these trials")
    run = RigModel(log, trials.only(borne))
    stated, nominal, extended = (held_out_trials(model, run) for model in models)
    gains = rig_gains(nominal, extended)
    return Transfer(
        log=log.name,
        trials=int(borne.sum()),
        left_out=trials.left_out + int((~borne).sum()),
        unit={gain.channel: UNITS.get(gain.channel, "N") for gain in gains},
        stated={
            channel.name: float(np.sqrt(np.mean(stated.residual[channel.rows] ** 2)))
            for channel in run.channels
        },
        gains=gains,
    )


def _borne(model: FitResult, log: Log, trials: Trials) -> np.ndarray:
    """Whether the model has a solution, (M,): by condition, where all at once have none."""
    whole = np.ones(len(trials), dtype=bool)
    try:
        held_out_trials(model, RigModel(log, trials))
    except OffroadError:
        for condition in np.unique(trials.condition):
            rows = trials.condition == condition
            try:
                held_out_trials(model, RigModel(log, trials.only(rows)))
            except OffroadError:
                whole[rows] = False
    return whole
