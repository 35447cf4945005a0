"""Quality of the data of the logs of a diagnosis, which goes on where the checks themselves break down."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.discrepancy.sections import attempt
from estimators.logs.log import Log
from estimators.logs.quality import QualityReport, quality

__all__ = ["DATA_QUALITY", "quality_of"]

#: The section, as `Diagnosis.failed` calls it.
DATA_QUALITY = "data quality"


def quality_of(logs: Sequence[Log], failed: dict[str, str]) -> tuple[QualityReport, ...]:
    """A report of each log; an empty one where the checks break down, with the reason noted in ``failed``."""
    return tuple(
        attempt(
            DATA_QUALITY if len(logs) == 1 else f"{DATA_QUALITY} of {log.name}",
            lambda log=log: quality(log),  # type: ignore[misc]
            QualityReport.unchecked(log),
            failed,
        )
        for log in logs
    )
