"""Everything once: which parts the demo has, and how they run one after the other.

Sentences and tables are written from the results, so they say what came out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from agents.demo.context import DemoSettings, Run
from agents.demo.control import arms_section, learning_section
from agents.demo.diagnosis import diagnosis_section
from agents.demo.driving import drive_section, estimate_section
from agents.demo.measured import wheel_section
from agents.demo.physics import exponent_section, forward_section, soil_section
from agents.reports.page import Section
from offroad_env.errors import InvalidParameter

__all__ = ["SECTIONS", "DemoSettings", "run_demo"]

#: Name -> (what the progress bar shows, rough share of the run time, maker).
SECTIONS: dict[str, tuple[str, float, Callable[[Run], Section]]] = {
    "soil": ("one wheel on soil", 4.0, soil_section),
    "forward": ("half-car against bicycle", 12.0, forward_section),
    "exponent": ("paths over n", 2.0, exponent_section),
    "drive": ("one episode", 15.0, drive_section),
    "estimate": ("estimating n", 8.0, estimate_section),
    "arms": ("comparing arms", 45.0, arms_section),
    "learning": ("learning to drive", 40.0, learning_section),
    "diagnose": ("what the simulation gets wrong", 25.0, diagnosis_section),
    "wheel-data": ("measured wheel data", 4.0, wheel_section),
}


def run_demo(
    settings: DemoSettings,
    *,
    only: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Section]:
    """Run the parts of the demo, in order.

    Parameters
    ----------
    settings
    only
        Names in `SECTIONS`; default all.
    progress
        Called with (what runs, share of the whole that is done).

    Raises
    ------
    InvalidParameter
        For a name that is no section.
    """
    unknown = ", ".join(name for name in only if name not in SECTIONS)
    if unknown:
        raise InvalidParameter(f"only must name sections among {', '.join(SECTIONS)}, got {unknown}")
    names = [name for name in SECTIONS if not only or name in only]
    total = sum(SECTIONS[name][1] for name in names)
    run, done = Run(settings), 0.0
    for name in names:
        label, weight, make = SECTIONS[name]
        run.tick = _ticker(progress, label, done / total, weight / total)
        run.tick(0.0)
        start = time.perf_counter()
        section = make(run)
        done += weight
        yield replace(section, seconds=time.perf_counter() - start)


def _ticker(
    progress: Callable[[str, float], None] | None, label: str, start: float, extent: float
) -> Callable[[float], None]:
    """Turn the share of a section into the share of the whole."""

    def tick(share: float) -> None:
        if progress is not None:
            progress(label, start + extent * min(max(share, 0.0), 1.0))

    return tick
