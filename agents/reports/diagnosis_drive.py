"""What the page of a diagnosis begins with: its verdict as a light and a sentence, and the drive."""

from __future__ import annotations

from agents.reports.log_playback import log_playback
from agents.reports.page import PageVerdict, Section
from estimators.discrepancy.summary import DiagnosisSummary
from estimators.discrepancy.verdict import Verdict
from estimators.logs.log import Log

__all__ = ["drive_section", "page_verdict"]

_PROBLEMS = (Verdict.DATA_PROBLEM, Verdict.OUTSIDE, Verdict.UNEXPLAINED)
_UNDECIDED = (Verdict.NUMERICS, Verdict.NOT_TESTABLE)


def page_verdict(summary: DiagnosisSummary) -> PageVerdict:
    """Green where the simulation is right, amber where its errors have names, red and grey otherwise."""
    sentence = summary.sentence[:1].upper() + summary.sentence[1:]
    sentence = sentence if sentence.endswith((".", "?")) else f"{sentence}."
    if summary.verdict is Verdict.NO_EFFECT:
        return PageVerdict(light="good", sentence=sentence)
    if summary.verdict in _UNDECIDED:
        return PageVerdict(light="neutral", sentence=sentence)
    return PageVerdict(light="problem" if summary.verdict in _PROBLEMS else "caution", sentence=sentence)


def drive_section(summary: DiagnosisSummary, log: Log) -> Section | None:
    """The log played back, with n before and after the causes; None where no motion can be made out."""
    exponents = {}
    if summary.n is not None:
        before = summary.n.before
        exponents["nominal model"] = (before.value, before.low, before.high)
        single = summary.n.single
        if summary.causes and single is not None:
            exponents["with the causes"] = (single.value, single.low, single.high)
    played = log_playback(log, exponents=exponents)
    if played is None:
        return None
    return Section(
        name="drive",
        title=f"The drive: {log.name}",
        sees="Where the vehicle went and what was measured on the way.",
        playback=played,
    )
