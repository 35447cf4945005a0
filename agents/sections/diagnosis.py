"""What a simulation gets wrong: something is hidden in a log, and has to be found."""

from __future__ import annotations

from agents.diagnosis_page import percent
from agents.figures import diagnosis_page as figures
from agents.report import Section, Table, figure_picture
from agents.sections.context import Run
from estimators.discrepancy.diagnosis import Diagnosis, diagnose
from estimators.discrepancy.hide import HIDERS, draw_case, hidden_log
from estimators.discrepancy.misfit import WORST, misfit_of
from estimators.discrepancy.verdict import scores_of, sentence_of, to_dict

__all__ = ["DELAY", "diagnosis_section"]

#: What is hidden: the steering acts so much later than the log says [s].
DELAY = 0.1
#: Stages that a diagnosis reports, for the progress.
_STAGES = 6


def diagnosis_section(run: Run) -> Section:
    """A late steering is hidden in a simulated drive; the finder sees the log alone."""
    settings, stages = run.settings, []
    case = draw_case(settings.seed, duration=settings.log_duration)
    log = hidden_log(case, HIDERS["steer_delay"](DELAY))

    def report(stage: str) -> None:
        run.tick(len(stages) / _STAGES)
        stages.append(stage)

    diagnosis = diagnose([log], progress=report)
    numbers = to_dict(diagnosis)
    return Section(
        name="diagnose",
        title="What the simulation gets wrong, and why",
        sees=f"In a drive of {settings.log_duration:.0f} s the steering acted {DELAY:g} s later than logged. "
        f"The finder, which sees only the log, says {diagnosis.verdict}: {sentence_of(diagnosis)}",
        command="offroad demo --only diagnose",
        pictures=_pictures(diagnosis),
        tables=_tables(diagnosis),
        notes=(
            "What is hidden is written a second time, not with the finder's own law of it. Measured logs "
            "go through the same procedure: offroad diagnose LOG.",
        ),
        key=((f"Steering {DELAY:g} s late, hidden in a log", diagnosis.verdict),),
        data={"hidden": {"steer_delay": DELAY}, "diagnosis": numbers},
    )


def _pictures(diagnosis: Diagnosis) -> tuple:
    if diagnosis.search is None:
        return ()
    sets = [[rival.candidate.effect for rival in cause.rivals] for cause in diagnosis.causes]
    misfit = misfit_of(diagnosis.search.nominal, diagnosis.model)
    return (
        figure_picture(
            figures.worst_figure(misfit, extended=bool(diagnosis.causes)),
            f"The {WORST:.0f} s that the nominal simulation gets most wrong: measured, nominal, and with the "
            "causes that were found.",
        ),
        figure_picture(
            figures.cause_figure(scores_of(diagnosis), float(diagnosis.checks["threshold"]), sets),
            "Score of every effect against the nominal model. Many look like the true cause; what is bold is "
            "needed.",
        ),
    )


def _tables(diagnosis: Diagnosis) -> tuple[Table, ...]:
    if not diagnosis.gains:
        return ()
    channels = {gain.channel for gain in diagnosis.gains}
    rows = tuple(
        (
            gain.channel,
            figures.error_unit(gain.channel, channels),
            f"{gain.nominal:.3g}",
            f"{gain.extended:.3g}",
            percent(gain.low, gain.high),
        )
        for gain in diagnosis.gains
    )
    heading = ("error on windows that no fit has seen", "unit", "nominal", "extended", "less by (95 %)")
    return (Table(heading=heading, rows=rows, texts=2),)
