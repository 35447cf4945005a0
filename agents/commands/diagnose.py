"""``offroad diagnose``: what the simulation gets wrong in measured runs."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from agents.commands.output import Results, say, write_json
from offroad_env.errors import DataError

__all__ = ["Diagnose"]

#: Stages of a diagnosis, for the progress bar.
_STAGES = 6


@dataclass(kw_only=True)
class Diagnose(Results):
    """Say what the simulation gets wrong in measured runs, name the cause, and measure the gain.

    Writes diagnosis.json, and extended.json where causes were found: the environment takes it as
    model="extended.json". Several logs are runs of one vehicle on one soil. With --rig they are steady
    trials of one wheel, and rig.png shows them.
    """

    logs: Positional[tuple[Path, ...]]  #: logs: CSV or Parquet with a YAML of the same name, or ROS bags
    rig: bool = False  #: the logs are trials of a wheel rig
    check: tuple[Path, ...] = ()  #: other runs of the vehicle: what the causes gain there, nothing is fitted

    def run(self) -> None:
        """Read, diagnose, write, and say the verdict."""
        from estimators.discrepancy.diagnosis import diagnose
        from estimators.discrepancy.rig import diagnose_rig
        from estimators.discrepancy.verdict import extension_of, lines_of, to_dict
        from estimators.logs import read_logs
        from offroad_env.effects import Extension

        if not self.logs:
            raise DataError("name at least one log")
        logs = read_logs(self.logs)
        if logs[0].rig != self.rig:
            kind = "trials of a wheel rig: add --rig" if logs[0].rig else "a drive, not trials of a wheel rig"
            raise DataError(f"{logs[0].name}: holds {kind}")
        find = diagnose_rig if self.rig else diagnose
        diagnosis = self._with_bar(lambda progress: find(logs, progress=progress))
        numbers = to_dict(diagnosis)
        numbers["command"] = " ".join(["offroad", *sys.argv[1:]])
        for line in lines_of(diagnosis):
            say(line)
        if self.check:
            numbers["gain_on_other_runs"] = self._checked(diagnosis)
        say(f"numbers: {write_json(self.out / 'diagnosis.json', numbers)}")
        if diagnosis.causes:
            model = "rig" if self.rig else logs[0].config.model
            extension = Extension(model=model, effects=tuple(extension_of(diagnosis)))
            say(f"extended model: {write_json(self.out / 'extended.json', extension.to_dict())}")
        if self.rig and diagnosis.search is not None:
            from agents.figures.rig import rig_figure

            self.save_figure(rig_figure(diagnosis), "rig")
        self.save_numbers(numbers)

    def _checked(self, diagnosis) -> dict:
        """Gains on the logs of ``--check``, said and as numbers."""
        from estimators.discrepancy.other_runs import gains_on
        from estimators.logs import read_logs

        if self.rig:
            raise DataError("--check takes runs of a vehicle: trials of a rig are split by condition")
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
