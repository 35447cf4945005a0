"""``offroad demo``: everything once, one page."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.reports.output import console, say, table, write_bytes, write_json

if TYPE_CHECKING:
    from agents.demo.parts import DemoSettings
    from agents.reports.page import PageVerdict, Section

__all__ = ["Demo"]


@dataclass(kw_only=True)
class Demo:
    """Run every part of the project once and write one HTML page with figures and numbers.

    Writes demo.html (self-contained) and demo.json (all numbers) into --out. Takes two to three minutes
    on two cores, of which the first run needs about one to compile the physics.
    """

    out: Path = Path("demo")  #: folder for the page, the numbers and the trained policy
    quick: bool = False  #: fewer episodes and shorter runs: to see that it works
    only: tuple[str, ...] = ()  #: run these sections alone (soil forward exponent drive estimate arms ...)
    seed: int = 0  #: of noise, episodes and learning
    json: Path | None = None  #: write the numbers to this file instead of demo.json

    def run(self) -> None:
        """Run, write, and print the numbers that matter."""
        from agents.demo.parts import DemoSettings

        settings = DemoSettings(out=self.out, seed=self.seed)
        if self.quick:
            settings = settings.quick()
        sections = self._sections(settings)
        page = write_bytes(self.out / "demo.html", self._page(sections).encode())
        numbers = write_json(self.json or self.out / "demo.json", self._numbers(sections))
        console().print(table("results", ("", ""), [row for section in sections for row in section.key]))
        say(f"page: {page}\nnumbers: {numbers}")

    def _sections(self, settings: DemoSettings) -> list[Section]:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        from agents.demo.parts import run_demo

        columns = (BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn())
        done = []
        with Progress(*columns, TextColumn("{task.description}"), console=console(), transient=True) as bar:
            task = bar.add_task("starting", total=1.0)

            def report(label: str, share: float) -> None:
                bar.update(task, description=label, completed=share)

            for section in run_demo(settings, only=self.only, progress=report):
                done.append(section)
                say(f"{section.seconds:6.1f} s  {section.title}", bar.console)
        return done

    def _page(self, sections: Sequence[Section]) -> str:
        from agents.reports.page import render_page

        return render_page(
            sections,
            title="OffroadBekker: one run of everything",
            intro="A vehicle drives on soil whose sinkage exponent n is unknown. This page is one run of "
            "every part of the project: the physics, the environment, an estimator of n, controllers with "
            "and without the estimate, a diagnosis of a simulation's errors, and measured data.",
            footer=_made_by(self.seed, self.quick),
            verdict=_verdict(sections),
        )

    def _numbers(self, sections: Sequence[Section]) -> dict[str, Any]:
        parts = {
            section.name: {
                "title": section.title,
                "sees": section.sees,
                "command": section.command,
                "key": dict(section.key),
                "seconds": section.seconds,
                **section.data,
            }
            for section in sections
        }
        return {"made_by": _made_by(self.seed, self.quick), "seed": self.seed, "sections": parts}


def _verdict(sections: Sequence[Section]) -> PageVerdict:
    """What knowing the soil is worth, where the arms were compared; else the first part's result."""
    from agents.reports.page import PageVerdict

    named = {section.name: section.sees for section in sections}
    return PageVerdict(light="neutral", sentence=named.get("arms", sections[0].sees))


def _made_by(seed: int, quick: bool) -> str:
    from importlib.metadata import version

    from offroad_env import __version__

    extent = "quick, " if quick else ""
    return (
        f"OffroadBekker {__version__}, {extent}seed {seed}; Python {platform.python_version()}, "
        f"NumPy {version('numpy')}, Numba {version('numba')}, {platform.system()} {platform.machine()}"
    )
