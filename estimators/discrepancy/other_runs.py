"""What an extended model gains on runs of which no part was used to find it."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.discrepancy.diagnosis import Diagnosis
from estimators.discrepancy.gain import ChannelGain, channel_gains, held_out
from estimators.discrepancy.run_model import RunModel
from estimators.discrepancy.windows import REPORT
from estimators.logs.log import Log

__all__ = ["gains_on"]


def gains_on(diagnosis: Diagnosis, logs: Sequence[Log]) -> dict[str, tuple[ChannelGain, ...]]:
    """Residuals of the nominal and of the extended model, by log and channel; only starts are fitted.

    Raises
    ------
    DataError
        If a log is too short.
    SolverFailure
        When a model breaks down there.
    """
    search, found = diagnosis.search, {}
    for log in logs:
        run = RunModel(log, whole=REPORT)
        pair = [held_out(fit, [run]) for fit in (search.nominal, search.extended)]
        found[log.name] = channel_gains(*pair)
    return found
