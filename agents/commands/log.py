"""``offroad log``: a description to begin with, all findings about a log at once, and its picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from agents.reports.output import Results, say, write_bytes

if TYPE_CHECKING:
    from collections.abc import Iterable

    from estimators.logs.checking.check import CheckReport
    from estimators.logs.checking.mends import Remark

__all__ = ["Check", "Draw", "LogTools", "Template"]


@dataclass(kw_only=True)
class Template:
    """Write a commented YAML for the log of a vehicle.

    Put it beside the data under the same name (run.yaml for run.csv), change what differs, and let
    offroad log check find the rest.
    """

    vehicle: Positional[str]  #: name of a vehicle, or a YAML file of one
    soil: str = "dry_sand"  #: name of a soil that is believed before the drive, or a YAML file of one
    out: Path | None = None  #: file to write; default: print it

    def run(self) -> None:
        """Write or print."""
        from estimators.logs.template import log_template
        from offroad_env.errors import DataError

        text = log_template(self.vehicle, self.soil)
        if self.out is None:
            say(text.rstrip())
            return
        if self.out.exists():
            raise DataError(f"{self.out}: is there already: delete it, or name another file")
        say(f"description: {write_bytes(self.out, text.encode())}")


@dataclass(kw_only=True)
class Check(Results):
    """List everything that is missing or wrong in a log, each with the line of its YAML that mends it.

    Checks the file, the names of its columns, the description, and the data: stamps, units, signs, mounting
    of the IMU, stuck sensors. The lines are to be added at the end of the YAML; a dotted line replaces what
    stands
    above it. Draws the channels as they are read with these lines, and states which commands take the log.
    A YAML file is checked without data. Ends in exit status 1 where something is left that no line mends.
    """

    log: Positional[Path]  #: log (.csv, .parquet, .bag, .mcap), or a .yaml
    append: bool = False  #: add the lines to the YAML

    def run(self) -> None:
        """Check, print, draw."""
        from estimators.logs.checking.check import check_description, check_log

        if self.log.suffix.lower() in (".yaml", ".yml"):
            report = check_description(self.log)
        else:
            report = check_log(self.log)
        _print_remarks(report.remarks)
        self._show_data(report)
        _print_lines(report)
        if self.append and report.lines:
            _add(report)
        self.save_numbers(_numbers(report))
        _refuse(self.log, report.remarks)
        if report.description == self.log and not any(r.severity == "problem" for r in report.remarks):
            say(f"{self.log}: no problem in the description")

    def _show_data(self, report: CheckReport) -> None:
        from agents.reports.figures.log_channels import log_channels_figure
        from agents.reports.output import console, table

        if report.log is None or report.quality is None:
            return
        heading, rows = report.quality.table()
        title = f"{report.name}: {len(report.log)} rows, {report.log.duration:.1f} s, as read with the lines"
        console().print(table(title, heading, rows, texts=2))
        self.save_figure(log_channels_figure(report.log), f"log_{report.name}")
        for command, reason in report.commands.items():
            say(f"offroad {command}: {'takes it' if not reason else f'does not take it: {reason}'}")


def _print_remarks(remarks: Iterable[Remark]) -> None:
    """Every finding with its lines."""
    for remark in remarks:
        say(f"{remark.severity}: {remark.sentence}")
        for line in remark.lines:
            say(f"    {line}")


def _print_lines(report: CheckReport) -> None:
    """The block to be added."""
    if report.lines:
        once = ", once it is there and can be read" if report.obstacle else ""
        say(f"\nadd to {report.description}{once}:\n")
        for line in report.lines:
            say(str(line))
        say("")


def _add(report: CheckReport) -> None:
    """Add the lines to a YAML that there is; to make one, somebody must say which vehicle it was."""
    from estimators.logs.checking.check import with_lines
    from offroad_env.world.files import read_text

    path = report.description
    if report.obstacle:
        say(f"nothing was added: {report.obstacle}")
        return
    say(f"added: {write_bytes(path, with_lines(read_text(path), report.lines).encode())}")


def _refuse(path: Path, remarks: Iterable[Remark]) -> None:
    """End in an error where a problem has no line."""
    from offroad_env.errors import DataError

    left = [remark for remark in remarks if remark.severity == "problem" and not remark.lines]
    if left:
        count = f"{len(left)} problems that no line mends, the first"
        if len(left) == 1:
            count = "one problem that no line mends"
        raise DataError(f"{path}: {count}: {left[0].sentence}")


def _numbers(report: CheckReport) -> dict[str, object]:
    return {
        "log": report.name,
        "remarks": [
            {"severity": r.severity, "sentence": r.sentence, "lines": [str(line) for line in r.lines]}
            for r in report.remarks
        ],
        "lines": [str(line) for line in report.lines],
        "commands": report.commands,
        "quality": None if report.quality is None else report.quality.to_dict(),
    }


@dataclass(kw_only=True)
class Draw(Results):
    """Draw all channels of a log as they are read: in SI units, in the axes of the vehicle."""

    log: Positional[Path]  #: log with its YAML

    def run(self) -> None:
        """Read and draw."""
        from agents.reports.figures.log_channels import log_channels_figure
        from estimators.logs import read_log

        log = read_log(self.log)
        self.save_figure(log_channels_figure(log), f"log_{log.name}")


#: What tyro parses for ``offroad log``.
LogTools = (
    Annotated[Template, tyro.conf.subcommand("template", prefix_name=False)]
    | Annotated[Check, tyro.conf.subcommand("check", prefix_name=False)]
    | Annotated[Draw, tyro.conf.subcommand("draw", prefix_name=False)]
)
