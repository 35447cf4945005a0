"""Transfer: the causes found on one wheel applied to trials of another, with nothing fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.checks.holdout_gain import ChannelGain
from estimators.discrepancy.rig.fit import held_out_trials
from estimators.discrepancy.rig.settings import measured_trials
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
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
    left_out: int  #: trials that have no slip along the wheel, or no load
    unit: dict[str, str]  #: of every channel
    stated: dict[str, float]  #: root mean square error of the model as the log states it, by channel
    gains: tuple[ChannelGain, ...]  #: of the causes over the nominal model, with the n that was fitted there


def transfer_to(diagnosis: RigDiagnosis, logs: Sequence[Log]) -> tuple[Transfer, ...]:
    """Errors on the trials of each log: laws, effects and n are those that the diagnosis found elsewhere.

    Raises
    ------
    DataError
        If a log holds no trials of a rig, or the model breaks down on them.
    ValueError
        If nothing was fitted.
    """
    if diagnosis.search is None or diagnosis.model is None:
        raise ValueError("the diagnosis ended before a model was fitted: there is nothing to compare")
    found = []
    for log in logs:
        if not log.rig:
            raise DataError(f"{log.name}: holds a drive, not trials of a wheel rig")
        run = RigModel(log, measured_trials([log]))
        nominal, model = diagnosis.search.nominal, diagnosis.model
        own = trials_of(nominal.runs).structure
        as_stated = replace(nominal.point, nuisances=np.zeros(len(nominal.nuisances)))
        try:
            stated = held_out_trials(nominal.moved(as_stated), run.with_structure(own))
            gains = rig_gains(held_out_trials(nominal, run), held_out_trials(model, run))
        except OffroadError as error:
            raise DataError(f"{log.name}: the model has no solution for these trials: {error}") from error
        found.append(
            Transfer(
                log=log.name,
                trials=len(run.trials),
                left_out=run.trials.left_out,
                unit={gain.channel: UNITS.get(gain.channel, "N") for gain in gains},
                stated={
                    channel.name: float(np.sqrt(np.mean(stated.residual[channel.rows] ** 2)))
                    for channel in run.channels
                },
                gains=gains,
            )
        )
    return tuple(found)
