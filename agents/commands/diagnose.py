"""``offroad diagnose``: what the simulation gets wrong in measured runs."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from agents.commands.output import Results, say, write_bytes, write_json
from offroad_env.errors import DataError

if TYPE_CHECKING:
    from estimators.discrepancy.diagnosis import Diagnosis
    from estimators.discrepancy.evidence import Evidence

__all__ = ["Diagnose"]

#: Stages of a diagnosis, for the progress bar.
_STAGES = 9


@dataclass(kw_only=True)
class Diagnose(Results):
    """Say what the simulation gets wrong in measured runs, name the cause, and measure the gain.

    Writes diagnosis.html (a page with all figures), diagnosis.json (all numbers), and extended.json where
    causes were found: the environment takes it as model="extended.json". Several logs are runs of one
    vehicle on one soil. With --rig they are steady trials of one wheel, and rig.png shows them in place of
    a page. Data that must be mended first end in exit status 1.
    """

    logs: Positional[tuple[Path, ...]]  #: logs: CSV or Parquet with a YAML of the same name, or ROS bags
    rig: bool = False  #: the logs are trials of a wheel rig
    check: tuple[Path, ...] = ()  #: other runs of the vehicle: what the causes gain there, nothing is fitted

    def run(self) -> None:
        """Read, diagnose, write, and say the verdict."""
        from estimators.discrepancy.rig import diagnose_rig
        from estimators.logs import read_logs

        if not self.logs:
            raise DataError("name at least one log")
        logs = read_logs(self.logs)
        if logs[0].rig != self.rig:
            kind = "trials of a wheel rig: add --rig" if logs[0].rig else "a drive, not trials of a wheel rig"
            raise DataError(f"{logs[0].name}: holds {kind}")
        if self.rig and self.check:
            raise DataError("--check takes runs of a vehicle: trials of a rig are split by condition")
        if self.rig:
            self.publish(self._with_bar(lambda progress: diagnose_rig(logs, progress=progress)), None)
        else:
            self.publish(*self._with_bar(lambda progress: _diagnosed(logs, progress)))

    def publish(self, diagnosis: Diagnosis, evidence: Evidence | None) -> None:
        """Write page, numbers and extended model, and say what matters.

        Parameters
        ----------
        diagnosis
        evidence
            What the page shows besides; None for a rig, which has a figure in place of the page.

        Raises
        ------
        DataError
            After all is written, where the data must be mended first.
        """
        from agents.diagnosis_page import made_by, render_diagnosis
        from estimators.discrepancy.verdict import extension_of, lines_of, to_dict
        from offroad_env.effects import Extension

        command = " ".join(["offroad", *sys.argv[1:]])
        numbers = to_dict(diagnosis) | ({} if evidence is None else evidence.to_dict(diagnosis))
        numbers |= {"command": command, "made_by": made_by()}
        bad = diagnosis.verdict == "DATA PROBLEM"
        # What is wrong with the data is the error at the end.
        for line in lines_of(diagnosis, evidence)[2 * bad :]:
            say(line)
        if self.check and not bad:
            numbers["gain_on_other_runs"] = self._checked(diagnosis)
        if evidence is not None:
            page = render_diagnosis(diagnosis, evidence, command).encode()
            say(f"report: {write_bytes(self.out / 'diagnosis.html', page)}")
        say(f"numbers: {write_json(self.out / 'diagnosis.json', numbers)}")
        if diagnosis.causes:
            model = "rig" if self.rig else diagnosis.logs[0].config.model
            extension = Extension(model=model, effects=tuple(extension_of(diagnosis)))
            say(f"extended model: {write_json(self.out / 'extended.json', extension.to_dict())}")
        if self.rig and diagnosis.search is not None:
            from agents.figures.rig import rig_figure

            self.save_figure(rig_figure(diagnosis), "rig")
        self.save_numbers(numbers)
        if bad:
            raise DataError(f"{numbers['verdict']}: {numbers['sentence']}")

    def _checked(self, diagnosis: Diagnosis) -> dict:
        """Gains on the logs of ``--check``, said and as numbers."""
        from estimators.discrepancy.other_runs import gains_on
        from estimators.logs import read_logs

        if not diagnosis.causes:
            say("no causes, so nothing to gain on other runs")
            return {}
        found = gains_on(diagnosis, read_logs(self.check))
        for name, gains in found.items():
            parts = (
                f"{g.channel} {100.0 * (1.0 - g.extended / max(g.nominal, 1e-300)):+.0f} %" for g in gains
            )
            say(f"errors less on {name}: {', '.join(parts)}")
        return found

    def _with_bar(self, work):
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description:<14}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, transient=True, disable=not sys.stderr.isatty()) as bar:
            task = bar.add_task("", total=_STAGES)
            return work(lambda stage: bar.update(task, description=stage, advance=1))


def _diagnosed(logs, progress):
    from estimators.discrepancy.diagnosis import diagnose
    from estimators.discrepancy.evidence import gather

    diagnosis = diagnose(logs, progress=progress)
    return diagnosis, gather(diagnosis, progress)
