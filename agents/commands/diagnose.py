"""``offroad diagnose``: errors of the simulation in measured runs, and their causes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table, write_bytes, write_json
from offroad_env.errors import DataError

if TYPE_CHECKING:
    from estimators.discrepancy.checks.holdout_gain import ChannelGain
    from estimators.discrepancy.summary import DiagnosisSummary
    from estimators.discrepancy.verdict import Diagnosis
    from estimators.logs.log import Log

__all__ = ["Diagnose"]

#: Stages of a diagnosis, for the progress bar.
_STAGES = 9

_Result = TypeVar("_Result")


@dataclass(kw_only=True)
class Diagnose(Results):
    """Find the errors of the simulation in measured runs, name their causes, and measure the gain.

    Writes diagnosis.html (a page with all figures), diagnosis.json (all numbers), and extended.json where
    causes are named: the environment takes it as model="extended.json". Several logs are runs of one
    vehicle on one soil. With --rig they are steady trials of one wheel, and rig.png shows them in place of
    a page. Data that must be corrected first end in exit status 1.
    """

    logs: Positional[tuple[Path, ...]]  #: logs: CSV or Parquet with a YAML of the same name, or ROS bags
    rig: bool = False  #: the logs are trials of a wheel rig
    structure: str | None = None  #: laws of the wheels instead of the logs', such as grid or field
    check: tuple[Path, ...] = ()  #: other runs, or trials of another wheel, to measure the gain without a fit

    def run(self) -> None:
        """Read, diagnose, write, and print the verdict."""
        from estimators.discrepancy.rig_diagnosis import diagnose_rig
        from estimators.discrepancy.summarise import summarise
        from estimators.logs import read_logs, with_structure

        if not self.logs:
            raise DataError("name at least one log")
        logs = with_structure(read_logs(self.logs), self.structure)
        if logs[0].rig != self.rig:
            kind = "trials of a wheel rig: add --rig" if logs[0].rig else "a drive, not trials of a wheel rig"
            raise DataError(f"{logs[0].name}: holds {kind}")
        if self.rig:
            diagnosis = self._with_bar(lambda progress: diagnose_rig(logs, progress=progress))
            self.publish(diagnosis, summarise(diagnosis))
        else:
            self.publish(*self._with_bar(lambda progress: _diagnosed(logs, progress)), logs[0])

    def publish(self, diagnosis: Diagnosis, summary: DiagnosisSummary, log: Log | None = None) -> None:
        """Write page, numbers and extended model, and print the summary.

        Parameters
        ----------
        diagnosis
            For what needs the fitted models: other runs, and the figure of a rig.
        summary
            Of the diagnosis; one with evidence gets a page.
        log
            What the page plays back.

        Raises
        ------
        DataError
            After all is written, where the data must be corrected first.
        """
        from agents.reports.diagnosis import made_by, render_diagnosis
        from estimators.discrepancy.sections import attempt
        from estimators.discrepancy.verdict import Verdict
        from estimators.discrepancy.wording import terminal_lines

        command = " ".join(["offroad", *sys.argv[1:]])
        numbers = summary.to_dict() | {"command": command, "made_by": made_by()}
        bad = summary.verdict is Verdict.DATA_PROBLEM
        # The first problem of the data is the error at the end.
        for line in terminal_lines(summary)[2 * bad :]:
            say(line)
        if self.check and not bad:
            numbers |= self._transferred(diagnosis) if self.rig else self._checked(diagnosis)
        if summary.evidence is not None:
            failed: dict[str, str] = {}
            page = attempt("page", lambda: render_diagnosis(summary, command, log), None, failed)
            if page is None:
                say(f"missing: page: {failed['page']}")
            else:
                say(f"report: {write_bytes(self.out / 'diagnosis.html', page.encode())}")
        say(f"numbers: {write_json(self.out / 'diagnosis.json', numbers)}")
        if summary.extended_model is not None:
            content = summary.extended_model.to_dict()
            say(f"extended model: {write_json(self.out / 'extended.json', content)}")
        if self.rig and not bad:
            from agents.studies.rig_fault_detection.figure import rig_figure

            self.save_figure(rig_figure(diagnosis), "rig")
        self.save_numbers(numbers)
        if bad:
            raise DataError(f"{summary.verdict}: {summary.sentence}")

    def _transferred(self, diagnosis: Diagnosis) -> dict[str, Any]:
        """Errors on the trials of ``--check``, printed and as numbers."""
        from estimators.discrepancy.rig.other_trials import transfer_to
        from estimators.discrepancy.verdict import RigDiagnosis
        from estimators.logs import read_logs

        if not isinstance(diagnosis, RigDiagnosis):
            raise TypeError(f"needs the diagnosis of a rig, got {type(diagnosis).__name__}")
        transfers = transfer_to(diagnosis, read_logs(self.check))
        for other in transfers:
            rows = [
                (
                    f"{gain.channel.replace('_', ' ')} [{other.unit[gain.channel]}]",
                    f"{other.stated[gain.channel]:.3g}",
                    f"{gain.nominal:.3g}",
                    f"{gain.extended:.3g}",
                    f"{-100.0 * (1.0 - gain.extended / max(gain.nominal, 1e-300)):+.0f} % "
                    f"({-100.0 * gain.high:+.0f} to {-100.0 * gain.low:+.0f})",
                )
                for gain in other.gains
            ]
            title = f"errors on {other.log}, {other.trials} trials, nothing fitted to them"
            heading = (
                "channel",
                "as stated",
                "n from the diagnosis",
                "with the causes",
                "change by the causes",
            )
            console().print(table(title, heading, rows))
        gains = {other.log: other.gains for other in transfers}
        return {"gain_on_other_runs": gains, "transfer": [asdict(other) for other in transfers]}

    def _checked(self, diagnosis: Diagnosis) -> dict[str, dict[str, tuple[ChannelGain, ...]]]:
        """Gains on the logs of ``--check``, printed and as numbers."""
        from estimators.discrepancy.other_runs import gains_on, restructured_gains_on
        from estimators.logs import read_logs, with_structure

        logs = with_structure(read_logs(self.check), self.structure)
        found = restructured_gains_on(diagnosis, logs)
        if not diagnosis.stated and not found:
            say("no cause is named, so there is nothing to gain on other runs")
            return {"gain_on_other_runs": {}}
        found = found or gains_on(diagnosis, logs)
        for name, gains in found.items():
            parts = (
                f"{g.channel} {100.0 * (1.0 - g.extended / max(g.nominal, 1e-300)):+.0f} %" for g in gains
            )
            say(f"reduction of errors on {name}: {', '.join(parts)}")
        return {"gain_on_other_runs": found}

    def _with_bar(self, work: Callable[[Callable[[str], None]], _Result]) -> _Result:
        """The result of ``work``, which reports its stages to a progress bar."""
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<14}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, transient=True, disable=not sys.stderr.isatty()) as bar:
            task = bar.add_task("", total=_STAGES)
            return work(lambda stage: bar.update(task, description=stage, advance=1))


def _diagnosed(logs: list[Log], progress: Callable[[str], None]) -> tuple[Diagnosis, DiagnosisSummary]:
    from estimators.discrepancy.diagnosis import diagnose
    from estimators.discrepancy.evidence import gather
    from estimators.discrepancy.summarise import summarise

    diagnosis = diagnose(logs, progress=progress)
    return diagnosis, summarise(diagnosis, gather(diagnosis, progress))
