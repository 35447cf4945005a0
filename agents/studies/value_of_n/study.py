"""``offroad reproduce headroom``: what knowing n is worth, over soils and widths of the prior.

For each task, soil and width the oracle, the worst-case arm and five fixed beliefs drive the same test
episodes. All have the oracle's tuned knobs, so only what they believe differs; the fixed belief that
stands for "nominal" is the one that scores best on training episodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.benchmark.statistics import headroom
from agents.commands.options import Jobs, Scenarios
from agents.controllers.arms import ArmSettings, make_arm
from agents.controllers.tuned import SETTINGS
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, Result, run_units, stamp_of
from agents.studies.value_of_n.results import Cell
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import BUILT_IN, MEASURES, SCENARIOS
from offroad_env.errors import InvalidParameter, SolverFailure

__all__ = ["ValueOfN", "cell_range", "run_unit"]

#: Places of the fixed beliefs in the prior.
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
_SOURCES = ("agents.benchmark.runner", "agents.controllers.arms", "offroad_env.environment.env")


def cell_range(task: str, width: float) -> tuple[float, float]:
    """A prior of that width around the middle of the task's own."""
    low, high = find_scenario(task).n_range
    middle = 0.5 * (low + high)
    return middle - 0.5 * width, middle + 0.5 * width


def run_unit(
    task: str, soil: str, width: float, arm: str, place: float, training: bool, index: int, episodes: int
) -> Result:
    """One episode of one belief; a unit of `run_units`. ``score`` is None where the soil drowns it."""
    n_range = cell_range(task, width)
    draw = draw_episodes(task, episodes, 0, n_range=n_range, training=training)[index]
    settings = ArmSettings(**SETTINGS[task, "oracle"])
    made = make_arm(arm, scenario=task, settings=replace(settings, n=place))
    try:
        env = gym.make(ENV_ID, scenario=task, terrain_info=made.terrain_info, soil=soil, n_range=n_range)
    except InvalidParameter:
        return {"score": None}
    try:
        return {"score": run_episode(env, made.agent, draw.seed, n=draw.n).score}
    except SolverFailure:
        return {"score": None}
    finally:
        env.close()


@dataclass(kw_only=True)
class ValueOfN(Results):
    """What knowing n is worth in each task, over soils and widths of the prior.

    Writes the figure headroom.png and the episodes, which an interrupted run goes on from.
    """

    tasks: Scenarios = BUILT_IN  #: what is driven
    soils: tuple[str, ...] = ("dry_sand", "sandy_loam", "lete_sand")  #: names of the catalogue
    widths: tuple[float, ...] = (0.2, 0.4, 0.8)  #: of the prior of n [-]
    episodes: int = 30  #: test episodes of each belief
    training: int = 10  #: training episodes of each fixed belief
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Drive what is missing, then plot and print."""
        from agents.studies.value_of_n.figure import value_figure

        if min(self.episodes, self.training) < 2:
            raise InvalidParameter("episodes and training must be at least 2: one episode has no interval")
        stamps = {task: f"{stamp_of(*_SOURCES)}-{SETTINGS[task, 'oracle']}" for task in self.tasks}
        keys = [key for cell in self._cells() for key in self._keys(*cell)]
        path = self.out / "headroom.jsonl"
        done = run_units(
            path, run_unit, {key: stamps[key[0]] for key in keys}, label="episodes", n_jobs=self.n_jobs
        )
        cells = [cell for place in self._cells() if (cell := self._cell(*place, done)) is not None]
        heading = ("task", "soil", "width", "headroom", "share", "nominal at")
        rows = [
            (
                c.task,
                c.soil,
                f"{c.width:g}",
                f"{c.room:.3g} {c.unit}",
                f"{100 * c.share:.0f} %",
                f"{c.place:g}",
            )
            for c in cells
        ]
        console().print(table("what knowing n is worth", heading, rows, texts=2))
        if cells:
            say(_verdict(cells))
        missing = len(list(self._cells())) - len(cells)
        if missing:
            say(f"{missing} combinations left out: the soil drowns the vehicle somewhere in the prior")
        self.save_figure(
            value_figure(cells),
            "headroom",
            "Full circles: the 95 % interval lies above zero, so the episodes show that knowing n pays.",
        )
        self.save_numbers({"cells": [asdict(cell) for cell in cells]})

    def _cells(self) -> list[tuple[str, str, float]]:
        return [(task, soil, width) for task in self.tasks for soil in self.soils for width in self.widths]

    def _keys(self, task: str, soil: str, width: float) -> list[Key]:
        """Units of a cell: fixed beliefs in training and test, the two other arms in the test."""
        beliefs = [("nominal", place) for place in PLACES]
        keys: list[Key] = [
            (task, soil, width, arm, place, True, i, self.training)
            for arm, place in beliefs
            for i in range(self.training)
        ]
        keys += [
            (task, soil, width, arm, place, False, i, self.episodes)
            for arm, place in (*beliefs, ("conservative", 0.0), ("oracle", 0.0))
            for i in range(self.episodes)
        ]
        return keys

    def _cell(self, task: str, soil: str, width: float, done: Mapping[Key, Result]) -> Cell | None:
        """The headroom of a cell; None where the soil drowns the vehicle."""

        def scores(arm: str, place: float, *, training: bool) -> np.ndarray:
            count = self.training if training else self.episodes
            keys: Sequence[Key] = [(task, soil, width, arm, place, training, i, count) for i in range(count)]
            return np.array([done[key]["score"] for key in keys], dtype=np.float64)

        trained = [scores("nominal", place, training=True).mean() for place in PLACES]
        oracle = scores("oracle", 0.0, training=False)
        if not np.isfinite(trained).all() or not np.isfinite(oracle).all():
            return None
        place = PLACES[int(np.argmin(trained))]
        blind = (scores("nominal", place, training=False), scores("conservative", 0.0, training=False))
        return Cell(
            task=task,
            soil=soil,
            width=width,
            room=headroom(oracle, blind),
            base=float(min(arm.mean() for arm in blind)),
            oracle=float(oracle.mean()),
            place=place,
            unit=MEASURES[SCENARIOS[task].measure][1],
        )


def _verdict(cells: Sequence[Cell]) -> str:
    """Where knowing n pays, in a sentence."""
    pays = [cell for cell in cells if cell.room.low > 0.0]
    counted = f"knowing n pays (95 % interval above zero) in {len(pays)} of {len(cells)} combinations"
    if not pays:
        return counted
    best = max(pays, key=lambda cell: cell.share)
    place = f"{best.task} on {best.soil} with a prior {best.width:g} wide"
    return f"{counted}, most on {place}: {100.0 * best.share:.0f} % of the score"
