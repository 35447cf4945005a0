"""Gain of an extended model on runs of which no part was used to find it."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.discrepancy.checks.holdout_gain import ChannelGain, channel_gains, held_out
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.model.windows import REPORT
from estimators.discrepancy.structure_comparison import gains_with
from estimators.discrepancy.verdict import Diagnosis, VehicleDiagnosis
from estimators.logs.log import Log

__all__ = ["gains_on", "restructured_gains_on"]


def restructured_gains_on(diagnosis: Diagnosis, logs: Sequence[Log]) -> dict[str, tuple[ChannelGain, ...]]:
    """The same where another structure was named: errors of predictions, to which nothing is fitted.

    Each run may have a soil of its own: n departs from the stated one as in the diagnosed runs. Empty where
    no structure was named.
    """
    if not isinstance(diagnosis, VehicleDiagnosis) or diagnosis.restructured is None:
        return {}
    return {log.name: gains_with(diagnosis.restructured, log) for log in logs}


def gains_on(diagnosis: Diagnosis, logs: Sequence[Log]) -> dict[str, tuple[ChannelGain, ...]]:
    """Residuals of the nominal and of the extended model, by log and channel; only starts are fitted.

    Raises
    ------
    DataError
        If a log is too short.
    SolverFailure
        When a model breaks down there.
    ValueError
        If nothing was fitted.
    """
    search, model = diagnosis.search, diagnosis.model
    if search is None or model is None:
        raise ValueError("the diagnosis ended before a model was fitted: there is nothing to compare")
    found = {}
    for log in logs:
        run = RunModel(log, whole=REPORT, nuisances=search.nominal.problem.nuisances)
        nominal, extended = (held_out(fit, [run]) for fit in (search.nominal, model))
        found[log.name] = channel_gains(nominal, extended)
    return found
