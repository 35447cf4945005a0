"""Everything once: which parts the demo has, and how they run: one after the other, the longest beside them.

Sentences and tables are written from the results, so they say what came out.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace

from joblib import Parallel, delayed

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
    "soil": ("one wheel on soil", 6.0, soil_section),
    "forward": ("half-car against bicycle", 6.0, forward_section),
    "exponent": ("paths over n", 2.0, exponent_section),
    "drive": ("one episode", 25.0, drive_section),
    "estimate": ("estimating n", 6.0, estimate_section),
    "arms": ("comparing arms", 35.0, arms_section),
    "learning": ("learning to drive", 24.0, learning_section),
    "diagnose": ("what the simulation gets wrong", 10.0, diagnosis_section),
    "wheel-data": ("measured wheel data", 4.0, wheel_section),
}
#: The longest part runs in a process of its own, from the end of the part that compiles what both need.
_BESIDE, _AFTER = "diagnose", "drive"


def run_demo(
    settings: DemoSettings,
    *,
    only: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Section]:
    """Run the parts of the demo, in order; with two processes the diagnosis runs beside those before it.

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
    begin, beside = _begin_beside(names) if settings.n_jobs > 1 else None, None
    try:
        for name in names:
            label, weight, _ = SECTIONS[name]
            run.tick = _ticker(progress, label, done / total, weight / total)
            run.tick(0.0)
            if name == begin:
                beside = Parallel(n_jobs=settings.n_jobs, return_as="generator")(
                    [delayed(_part)(_BESIDE, Run(settings))]
                )
            if beside is not None and name == _BESIDE:
                (section,) = beside
            else:
                section = _part(name, run)
            yield section
            done += weight
    finally:
        _stop(beside)


def _begin_beside(names: Sequence[str]) -> str | None:
    """Part with which `_BESIDE` begins in its own process; None where it has nothing to run beside."""
    order = list(SECTIONS)
    between = [name for name in names if order.index(_AFTER) < order.index(name) < order.index(_BESIDE)]
    return between[0] if between and _BESIDE in names else None


def _part(name: str, run: Run) -> Section:
    """One part, with the time that it took."""
    start = time.perf_counter()
    section = SECTIONS[name][2](run)
    return replace(section, seconds=time.perf_counter() - start)


def _stop(beside: Generator[Section, None, None] | None) -> None:
    """End the process that runs beside, where the demo is left before its result was taken."""
    if beside is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib warns of the result that nobody takes
            beside.close()


def _ticker(
    progress: Callable[[str, float], None] | None, label: str, start: float, extent: float
) -> Callable[[float], None]:
    """Turn the share of a section into the share of the whole."""

    def tick(share: float) -> None:
        if progress is not None:
            progress(label, start + extent * min(max(share, 0.0), 1.0))

    return tick
