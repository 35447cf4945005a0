"""Diagnosis of a simulated drive whose steering acts late."""

from __future__ import annotations

from agents.demo.context import Run
from agents.reports import diagnosis_figures as figures
from agents.reports.diagnosis import percent
from agents.reports.page import Picture, Section, Table, figure_picture
from estimators.discrepancy.checks.misfit import WORST, misfit_of
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.summary import DiagnosisSummary
from estimators.discrepancy.verdict import Diagnosis

__all__ = ["DELAY", "diagnosis_section"]

#: The injected fault: the steering acts so much later than logged [s].
DELAY = 0.1
#: Stages that a diagnosis reports, for the progress.
_STAGES = 6


def diagnosis_section(run: Run) -> Section:
    """Diagnosis of a drive with late steering; it sees the log alone."""
    settings = run.settings
    stages: list[str] = []
    case = draw_case(settings.seed, duration=settings.log_duration)
    log = simulated_log(case, FAULTS["steer_delay"](DELAY))

    def report(stage: str) -> None:
        run.tick(len(stages) / _STAGES)
        stages.append(stage)

    diagnosis = diagnose([log], progress=report)
    summary = summarise(diagnosis)
    return Section(
        name="diagnose",
        title="Errors of the simulation and their causes",
        sees=f"In a drive of {settings.log_duration:.0f} s the steering acted {DELAY:g} s later than logged. "
        f"The diagnosis, which sees only the log: {summary.verdict}. {summary.sentence}",
        command="offroad demo --only diagnose",
        pictures=_pictures(diagnosis, summary),
        tables=_tables(summary),
        notes=(
            "The fault is implemented independently of the library's effect of the same name. Measured logs "
            "go through the same procedure: offroad diagnose LOG.",
        ),
        key=((f"Verdict on a log whose steering acts {DELAY:g} s late", summary.verdict.value),),
        data={"injected": {"steer_delay": DELAY}, "diagnosis": summary.to_dict()},
    )


def _pictures(diagnosis: Diagnosis, summary: DiagnosisSummary) -> tuple[Picture, ...]:
    if diagnosis.search is None or diagnosis.model is None:
        return ()
    misfit = misfit_of(diagnosis.search.nominal, diagnosis.model)
    return (
        figure_picture(
            figures.worst_figure(misfit, extended=bool(summary.causes)),
            f"The worst {WORST:.0f} s of the nominal simulation: measured, nominal, and with the causes that "
            "were found.",
        ),
        figure_picture(
            figures.cause_figure(summary.scores, summary.threshold, summary.effects),
            "Score of every effect against the nominal model. Many effects resemble the true cause; those of "
            "the verdict are bold.",
        ),
    )


def _tables(summary: DiagnosisSummary) -> tuple[Table, ...]:
    if not summary.gains:
        return ()
    channels = {gain.channel for gain in summary.gains}
    rows = tuple(
        (
            gain.channel,
            figures.error_unit(gain.channel, channels),
            f"{gain.nominal:.3g}",
            f"{gain.extended:.3g}",
            percent(gain.low, gain.high),
        )
        for gain in summary.gains
    )
    heading = ("error on test data", "unit", "nominal", "extended", "reduction (95 %)")
    return (Table(heading=heading, rows=rows, texts=2),)
