"""``offroad speed``: how fast and how large everything is, beside other environments."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from agents.reports.output import Results, console, say, table

if TYPE_CHECKING:
    from agents.studies.speed.fresh import Fresh
    from agents.studies.speed.predictive import SolveTime
    from agents.studies.speed.study import Ratio, Speed
    from agents.studies.speed.verdicts import VerdictTime

__all__ = ["SpeedCommand"]


@dataclass(kw_only=True)
class SpeedCommand(Results):
    """Speed as ratios in one run: physics, environment, filters, vector environment, memory.

    All sides take turns, so a busy machine slows all of them. Peers that are not installed are left out
    (mujoco and highway-env are never required). Writes the figure speed.png.
    """

    quick: bool = False  #: a tenth of the steps but for the belief, and no compilation from scratch
    rounds: int = 7  #: turns that each side takes

    def run(self) -> None:
        """Measure, print, draw."""
        from rich.progress import Progress

        from agents.studies.speed.figure import speed_figure
        from agents.studies.speed.study import measure_speed
        from offroad_env.errors import InvalidParameter

        if self.rounds < 1:
            raise InvalidParameter(f"rounds must be at least 1, got {self.rounds}")
        with Progress(console=console(), transient=True) as bars:
            task = bars.add_task("turns", total=None)
            speed = measure_speed(
                rounds=self.rounds,
                quick=self.quick,
                progress=lambda done, total: bars.update(task, completed=done, total=total),
            )
        self._show(speed)
        self.save_figure(speed_figure(speed), "speed")
        self.save_numbers(speed)

    def _show(self, speed: Speed) -> None:
        heading = ("ours / peer", "of", "ratio", "lowest", "highest", "promised", "ours [us]", "peer [us]")
        title = f"{speed.rounds} turns each, {speed.processors} processors"
        console().print(table(title, heading, map(_row, speed.ratios), texts=2))
        for name in speed.missing:
            say(f"left out: {name} is not installed")
        if speed.diagnosis_s is not None:
            say(f"diagnosis of a log of 60 s: {speed.diagnosis_s:.1f} s of CPU time")
        if speed.verdicts:
            columns = ("what is wrong", "median [s]", "largest [s]", "promised")
            title = "CPU time of a verdict, natural drives of 60 s"
            console().print(table(title, columns, map(_verdict_row, speed.verdicts)))
        if speed.solves is None:
            say("left out: decisions of nmpc_truth, casadi is not installed")
        else:
            say(_solves(speed.solves))
        if speed.fresh is not None:
            console().print(table("new interpreters", ("what", "measured"), _fresh_rows(speed.fresh)))


def _row(ratio: Ratio) -> tuple[str, ...]:
    promise = ""
    if ratio.bar is not None:
        word = "at least" if ratio.kind == "rate" else "at most"
        promise = f"{word} {ratio.bar:g}{'' if ratio.met else ' - MISSED'}"
    numbers = (f"{value:.3f}" for value in (ratio.value, ratio.low, ratio.high))
    kind = f"{ratio.kind}, {'clock' if ratio.clock else 'CPU'}"
    times = (f"{ratio.ours_us:.2f}", f"{ratio.peer_us:.2f}")
    return f"{ratio.ours} / {ratio.peer}", kind, *numbers, promise, *times


def _verdict_row(verdict: VerdictTime) -> tuple[str, ...]:
    promise = f"at most {verdict.bar:g}{'' if verdict.met else ' - MISSED'}"
    return verdict.what, f"{verdict.seconds:.1f}", f"{verdict.most:.1f}", promise


def _solves(solves: SolveTime) -> str:
    from agents.studies.speed.predictive import MOST_SOLVE_MS

    return (
        f"a decision of nmpc_truth: {solves.median_ms:.1f} ms of CPU time in the median of "
        f"{solves.decisions}, 95 % within {solves.high_ms:.1f} ms; promised at most {MOST_SOLVE_MS:g} ms "
        f"in the median"
        f"{'' if solves.met else ' - MISSED'}"
    )


def _fresh_rows(fresh: Fresh) -> Iterator[tuple[str, str]]:
    yield "import offroad_env", f"{fresh.import_s:.2f} s"
    yield "import gymnasium, numba, scipy", f"{fresh.import_others_s:.2f} s"
    yield "make, reset and first step, compiled before", f"{fresh.first_step_s:.2f} s"
    for name, times in (("", fresh.compile_s), (", with the parameter UKF", fresh.compile_filter_s)):
        if times is not None:
            cpu, clock = times
            yield (
                f"the same with nothing compiled{name}",
                f"{cpu:.1f} s of CPU time, {clock:.1f} s by the clock",
            )
    yield "peak memory of one environment", f"{fresh.peak_mb:.0f} MB"
    yield "one environment more in a vector", f"{fresh.per_environment_kb:.0f} kB"
    yield "of it the record of its episode", f"{fresh.state_kb:.1f} kB"
