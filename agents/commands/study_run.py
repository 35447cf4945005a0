"""A study as a subcommand: it runs, and leaves a page of what it has shown."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Protocol

__all__ = ["StudyRun"]


class _Study(Protocol):
    def run(self) -> None:
        """Compute what is missing, print and draw."""


class StudyRun:
    """The parsed arguments of a study.

    Parameters
    ----------
    study
        Its arguments.
    name
    what
        What it shows, in some words.
    """

    def __init__(self, study: _Study, name: str, what: str) -> None:
        self.study, self.name, self.what = study, name, what
        self.seed: int = getattr(study, "seed", 0)

    def run(self) -> None:
        """Run it, then write ``<out>/<name>.html``."""
        from agents.reports.output import recorded, say, write_bytes

        with recorded() as record:
            self.study.run()
        if not record.figures and not record.tables:
            return
        from agents.reports.diagnosis import made_by
        from agents.reports.study import render_study

        command = " ".join(["offroad", *sys.argv[1:]])
        page = render_study(self.name, self.what, record, command=command, footer=made_by())
        out: Path = getattr(self.study, "out", Path("out"))
        say(f"page: {write_bytes(out / f'{self.name}.html', page.encode())}")
