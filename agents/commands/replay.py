"""``offroad replay``: logs predicted open loop by several models, side by side."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from agents.reports.output import Results, console, say, table, write_bytes
from offroad_env.errors import InvalidParameter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from estimators.replay.replay import Replay
    from estimators.replay.structures import Case

__all__ = ["ReplayCommand"]

#: Columns of the tables: channel, heading.
_COLUMNS = {
    "v_x": "v_x\nm/s", "v_y": "v_y\nm/s", "yaw_rate": "yaw rate\nrad/s", "omega_f": "ω front\nrad/s",
    "omega_r": "ω rear\nrad/s", "a_y": "a_y\nm/s²", "position": "position\nm",
}  # fmt: skip
_CAPTION = (
    "Above: the error of each model by channel, the shorter the bar the better. Below: how it grows within a "
    "window, root mean square over all windows."
)
#: Time between the numbers of the growth in the JSON [s].
_GROWTH_STEP = 0.1


@dataclass(kw_only=True)
class ReplayCommand(Results):
    """Predict logs in windows from the logged steering and torques, and compare with what happened.

    A structure is a choice of laws of wheel and soil: paper, full, grid, field, or one of them with changes,
    as grid,ruts=none. Groups: all, ladder (from full to grid one law at a time), leave_one_out (grid less one
    law). Vehicle, soil and ground are those of the log's description; nothing is fitted. Each window starts
    from a smoother of the logged sensors after a lead-in of 1 s. Columns ref_* enter the errors only, where
    a log has them. Prints root mean square errors over all logs and of each log, and writes replay.png and
    replay.html, a page that plays the first log back with the errors of each model.
    """

    logs: Positional[tuple[Path, ...]]  #: logs: CSV or Parquet with a YAML of the same name, or ROS bags
    structure: tuple[str, ...] = ("full", "grid")  #: laws, "grid,ruts=none", all, ladder, leave_one_out
    vehicle_model: tuple[str, ...] = ("half_car",)  #: half_car, four_wheel, bicycle
    window: float = 4.0  #: length of a window [s]
    hold: Literal["stated", "zoh", "linear"] = "stated"  #: how inputs go on between their rows
    jobs: int = 2  #: local processes; the results do not depend on it

    def run(self) -> None:
        """Predict, print both tables, draw and write."""
        from agents.reports.figures.replay import replay_figure
        from estimators.replay.replay import LEAD_IN, pooled
        from estimators.replay.structures import cases_of

        if not self.logs:
            raise InvalidParameter("logs must name at least one file")
        if self.jobs < 1:
            raise InvalidParameter(f"jobs must be >= 1, got {self.jobs}")
        cases = cases_of(self.structure, self.vehicle_model)
        replays = self._replayed(cases)
        groups = [pooled([replay for replay in replays if _case(replay) == case]) for case in cases]
        # Files first: a reader of a pipe may leave before the tables end.
        figure = replay_figure(groups)
        self.save_figure(figure, "replay")
        say(f"page: {write_bytes(self.out / 'replay.html', self._page(groups, cases, figure).encode())}")
        self.save_numbers(
            {
                "command": " ".join(["offroad", *sys.argv[1:]]),
                "window_s": self.window,
                "lead_in_s": LEAD_IN,
                "hold": self.hold,
                "runs": [_numbers(replay) for replay in replays],
                "pooled": [_numbers(group) | {"growth": _growth(group)} for group in groups],
            }
        )
        title = f"{len(self.logs)} logs, windows of {self.window:g} s, root mean square errors"
        if len(self.logs) > 1:
            rows = [(replay.log, *_row(replay)) for replay in replays]
            console().print(table("each log", ("log", *_heading()), rows, texts=3))
        console().print(table(title, _heading(), [_row(group) for group in groups], texts=2))
        compared = groups[0].references
        say(f"compared with reference columns: {', '.join(compared) or 'none'}; else with smoothed sensors")

    def _page(self, groups: Sequence[Replay], cases: Sequence[Case], figure: Figure) -> str:
        """The page, which plays the first log back."""
        from agents.reports.diagnosis import made_by
        from agents.reports.page import Table, figure_picture
        from agents.reports.replay import drive_section, render_replay
        from estimators.logs import read_log

        heading = tuple(name.replace("\n", " [", 1) + "]" * ("\n" in name) for name in _heading())
        drive = drive_section(
            read_log(self.logs[0]),
            cases,
            window=self.window,
            hold=None if self.hold == "stated" else self.hold,
            command=" ".join(["offroad", *sys.argv[1:]]),
        )
        return render_replay(
            groups,
            drive,
            Table(heading=heading, rows=tuple(map(_row, groups)), texts=2),
            figure_picture(figure, _CAPTION),
            window=self.window,
            footer=made_by(),
        )

    def _replayed(self, cases: Sequence[Case]) -> list[Replay]:
        """All logs, in the order given, with a progress bar."""
        from joblib import Parallel, delayed
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        hold = None if self.hold == "stated" else self.hold
        tasks = (delayed(_one)(path, cases, self.window, hold) for path in self.logs)
        found: list[Replay] = []
        findings: list[str] = []
        with Progress(*columns, transient=True, disable=not sys.stderr.isatty()) as bar:
            task = bar.add_task("logs", total=len(self.logs))
            for replays, remarks in Parallel(n_jobs=min(self.jobs, len(self.logs)), return_as="generator")(
                tasks
            ):
                found.extend(replays)
                findings.extend(remarks)
                bar.advance(task)
        for finding in findings:
            say(finding)
        return found


def _one(
    path: Path, cases: Sequence[Case], window: float, hold: str | None
) -> tuple[tuple[Replay, ...], list[str]]:
    """One log, and what is wrong with its data; a function of the module, so that other processes find it."""
    from estimators.logs import quality, read_log
    from estimators.replay.replay import replay_log

    log = read_log(path)
    found = [one for one in quality(log).findings if one.severity != "note"]
    # The comparison goes on: the reader decides what an error of such data means.
    remarks = [f"{log.name}: {one.severity}: {one.sentence}" for one in found]
    return replay_log(log, cases, window=window, hold=hold), remarks


def _case(replay: Replay) -> tuple[str, str]:
    return replay.structure, replay.vehicle_model


def _heading() -> tuple[str, ...]:
    return ("structure", "vehicle", *_COLUMNS.values(), "windows")


def _row(replay: Replay) -> tuple[str, ...]:
    from estimators.replay.structures import title_of

    errors = (f"{replay.rms[name]:.3g}" for name in _COLUMNS)
    failed = f" ({replay.failed} failed)" if replay.failed else ""
    return (title_of(replay.structure), replay.vehicle_model, *errors, f"{replay.windows}{failed}")


def _growth(group: Replay) -> dict[str, Any]:
    """Errors over the time in a window, ten times a second."""
    every = max(round(_GROWTH_STEP / float(group.t[1])), 1)
    return {name: rows[::every] for name, rows in {"t": group.t, **group.growth}.items()}


def _numbers(replay: Replay) -> dict[str, Any]:
    return {
        "log": replay.log,
        "structure": replay.structure,
        "vehicle_model": replay.vehicle_model,
        "window_s": replay.window_s,
        "rms": replay.rms,
        "windows": replay.windows,
        "failed": replay.failed,
        "references": replay.references,
    }
