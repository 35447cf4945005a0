"""Quality of the data of the logs of a diagnosis, which goes on where the checks themselves break down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from estimators.discrepancy.sections import attempt
from estimators.logs.channel_checks import OUTSIDE
from estimators.logs.immobile_findings import IMMOBILE, hardly_driven
from estimators.logs.log import Log
from estimators.logs.quality import QualityReport, quality
from estimators.logs.units import Finding

__all__ = ["DATA_QUALITY", "quality_of", "unusable", "used_findings"]

#: The section, as `Diagnosis.failed` calls it.
DATA_QUALITY = "data quality"
#: The age of the pose, which the sensors determine before any fit: kind of a finding, and its channel.
_OLD_POSE = ("clock", "yaw")


def quality_of(logs: Sequence[Log], failed: dict[str, str]) -> tuple[QualityReport, ...]:
    """A report of each log; an empty one where the checks break down, with the reason noted in ``failed``."""
    return tuple(
        attempt(
            DATA_QUALITY if len(logs) == 1 else f"{DATA_QUALITY} of {log.name}",
            partial(quality, log),
            QualityReport.unchecked(log),
            failed,
        )
        for log in logs
    )


def unusable(logs: Sequence[Log], reports: Sequence[QualityReport]) -> tuple[Finding, ...]:
    """Why nothing can be fitted: the data, a vehicle that is not steered, or one that hardly drives.

    Only the first of these that there is: each has its own verdict, or its own sentence.
    """
    problems = _named(logs, [report.problems for report in reports])
    unsteered = [[one for one in report.findings if one.kind == OUTSIDE] for report in reports]
    stuck = [[one for one in report.findings if hardly_driven(one)] for report in reports]
    return problems or _named(logs, unsteered) or _named(logs, stuck)


def used_findings(logs: Sequence[Log], reports: Sequence[QualityReport]) -> tuple[Finding, ...]:
    """What a reader of the verdict must know of the data: old poses, and that the vehicle gets stuck."""
    found = [
        [one for one in report.findings if one.kind == IMMOBILE or (one.kind, one.channel) == _OLD_POSE]
        for report in reports
    ]
    return _named(logs, found)


def _named(logs: Sequence[Log], findings: Sequence[Sequence[Finding]]) -> tuple[Finding, ...]:
    """Findings by log in one row; of several logs each begins with the name of its log."""
    if len(logs) == 1:
        return tuple(findings[0])
    return tuple(
        replace(one, sentence=f"{log.name}: {one.sentence}")
        for log, own in zip(logs, findings, strict=True)
        for one in own
    )
