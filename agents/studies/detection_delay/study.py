"""``offroad reproduce detection_delay``: what it is worth to detect a change of the soil soon.

On `patches` an arm with the exact n, delayed, drives the same test episodes with one delay after another:
with the controller of the arms there, and with the speed control of the other tasks, whose integral learns
the drive of a bend in place of the feed-forward. Beside it: the arms of the benchmark, and the delay of the
online filter with and without the option that the soil changes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.benchmark.statistics import mean_interval
from agents.commands.options import Jobs
from agents.controllers.arms import make_arm
from agents.controllers.protocol import Agent, Observation
from agents.controllers.speed_control import SpeedGains
from agents.controllers.speed_planner import BeliefSource, PlannerGains, SoilTracker
from agents.controllers.tuned import SETTINGS
from agents.driving.unwrapped import bekker_env
from agents.reports.output import Results, console, table
from agents.studies.detection_delay.results import DrivenLine, FilterLine
from agents.studies.runner import Key, Result, run_units, stamp_of
from estimators.filters.online import OnBoard
from offroad_env.environment.episode_records import CONTROL_PERIOD
from offroad_env.errors import InvalidParameter

__all__ = [
    "DetectionDelay",
    "Late",
    "delays_of",
    "driven_lines",
    "filter_lines",
    "run_unit",
]

TASK = "patches"
DELAYS = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2)  # [s]
ARMS = ("nominal", "conservative", "aware")
#: Kinds of units: delayed n with the controller of the arms here, or with the speed control of other tasks.
_PLAIN, _INTEGRAL = "late", "late, integral instead of foresight"
#: Online filters: name -> whether they expect changes of the soil.
FILTERS = {"constant n": False, "changing n": True}
#: An answer is as near as this to the new n; smaller changes are not looked at [-].
NEAR, _LEAST = 0.1, 0.15
#: Steps of n with less than this between them are one change [s].
_TOGETHER = 0.1
#: Changes with less time than this before the next one, or the goal, ask for no answer [s].
_ROOM = 1.0
#: The first search is over from here [s].
_SEARCHED = 3.0
_QUICK = 10
_SOURCES = (
    "agents.benchmark.runner",
    "agents.controllers.arms",
    "offroad_env.environment.env",
    "estimators.filters.online",
)


class Late:
    """An agent with the true n of a while ago; before that, with the middle of the prior.

    Parameters
    ----------
    agent
        Reads ``observation["terrain"]``.
    delay
        [s]
    """

    def __init__(self, agent: Agent, delay: float) -> None:
        self.agent, self.steps = agent, round(delay / CONTROL_PERIOD)

    def reset(self, briefing: Any) -> None:
        """Forget the values under way."""
        self.agent.reset(briefing)
        self._under_way = deque([0.5 * sum(briefing.n_range)] * self.steps)

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        self._under_way.append(float(observation["terrain"][0]))
        terrain = np.array([self._under_way.popleft(), 0.0, 1.0])
        return self.agent.act({**observation, "terrain": terrain})


def delays_of(n: np.ndarray, mean: np.ndarray) -> list[float]:
    """Time [s] from every change of ``n`` (T,) to a ``mean`` (T,) near the new value; inf where none is."""
    moves = np.flatnonzero(np.abs(np.diff(n)) > 1e-3)
    if moves.size == 0:
        return []
    groups = np.split(moves, np.flatnonzero(np.diff(moves) * CONTROL_PERIOD > _TOGETHER) + 1)
    untils = [int(group[0]) + 1 for group in groups[1:]] + [len(n)]
    found = []
    for group, until in zip(groups, untils, strict=True):
        begin, end = int(group[0]) + 1, int(group[-1]) + 1
        if abs(n[end] - n[begin - 1]) > _LEAST and (until - end) * CONTROL_PERIOD >= _ROOM:
            near = np.flatnonzero(np.abs(mean[end:until] - n[end]) < NEAR)
            found.append((end - begin + near[0]) * CONTROL_PERIOD if near.size else math.inf)
    return found


def run_unit(kind: str, which: Any, index: int, episodes: int, seed: int) -> dict[str, Any]:
    """One test episode: of an arm, of the oracle with n late by ``which`` seconds, or of a filter."""
    draw = draw_episodes(TASK, episodes, seed)[index]
    if kind == "filter":
        return _filter_unit(FILTERS[which], draw)
    tracker = _with_integral if kind == _INTEGRAL else None
    arm = make_arm(which if kind == "arm" else "oracle", scenario=TASK, tracker=tracker)
    agent = arm.agent if kind == "arm" else Late(arm.agent, which)
    env = gym.make(ENV_ID, scenario=TASK, terrain_info=arm.terrain_info)
    result = run_episode(env, agent, draw.seed, options=draw.options)
    env.close()
    return {"score": result.score, "success": result.success}


def _with_integral(believe: BeliefSource, gains: PlannerGains) -> Agent:
    return SoilTracker(believe, replace(gains, turning=False, speed=SpeedGains()))


def _filter_unit(changing: bool, draw: Any) -> dict[str, Any]:
    online = OnBoard(kind="parameter", changing=changing)
    env = gym.make(ENV_ID, scenario=TASK, terrain_info="truth", estimator=online)
    agent = Late(make_arm("oracle", scenario=TASK).agent, 0.0)
    observation, info = env.reset(seed=draw.seed, options=draw.options)
    agent.reset(bekker_env(env).briefing)
    rows, over = [], False
    while not over:
        observation, _, terminated, truncated, info = env.step(agent.act(observation))
        estimate = bekker_env(env).snapshot().estimate
        assert estimate is not None  # the environment was made with an estimator
        rows.append((info["n_front"], estimate.mean, estimate.sd, float(estimate.valid)))
        over = terminated or truncated
    env.close()
    n, mean, sd, valid = np.array(rows).T
    late = slice(round(_SEARCHED / CONTROL_PERIOD), None)
    error = np.abs(mean - n)[late]
    return {
        "delays": delays_of(n, mean),
        "square": float(np.mean(error**2)),
        "inside": float(np.mean(error <= 2.0 * sd[late])),
        "valid": float(np.mean(valid[late])),
    }


def driven_lines(results: Mapping[Key, Result]) -> list[DrivenLine]:
    """A line for every delay and arm from the results by (kind, which, ...)."""
    lines = []
    for kind, which in dict.fromkeys(key[:2] for key in results if key[0] != "filter"):
        units = [result for key, result in results.items() if key[:2] == (kind, which)]
        lines.append(
            DrivenLine(
                name=which if kind == "arm" else kind,
                delay=math.nan if kind == "arm" else float(which),
                score=mean_interval(np.array([unit["score"] for unit in units])),
                failures=sum(not unit["success"] for unit in units),
                episodes=len(units),
            )
        )
    return lines


def filter_lines(results: Mapping[Key, Result]) -> list[FilterLine]:
    """A line for every filter from the results by (kind, which, ...)."""
    lines = []
    for name in dict.fromkeys(key[1] for key in results if key[0] == "filter"):
        units = [result for key, result in results.items() if key[:2] == ("filter", name)]
        delays = np.array([delay for unit in units for delay in unit["delays"]])
        lines.append(
            FilterLine(
                name=name,
                delay=float(np.percentile(delays, 50.0, method="higher")),
                answered=float(np.mean(np.isfinite(delays))),
                edges=delays.size,
                rmse=math.sqrt(np.mean([unit["square"] for unit in units])),
                coverage=float(np.mean([unit["inside"] for unit in units])),
                valid=float(np.mean([unit["valid"] for unit in units])),
            )
        )
    return lines


@dataclass(kw_only=True)
class DetectionDelay(Results):
    """What it is worth on `patches` to learn soon that the soil has changed.

    The oracle with a delayed n, with one delay after another; the arms of the benchmark; and the delay of
    the online filter. Writes detection_delay.png, and detection_delay.jsonl with every episode: one that is
    there is not driven again.
    """

    quick: bool = False  #: 10 episodes
    episodes: int = 100  #: test episodes of each way of knowing n
    seed: int = 0  #: of the episodes
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Drive what is missing, then print, draw and write."""
        from agents.studies.detection_delay.figure import delay_figure

        episodes = _QUICK if self.quick else self.episodes
        if episodes < 2:
            raise InvalidParameter(f"episodes must be at least 2, got {episodes} - one has no interval")
        stamp = f"{stamp_of(*_SOURCES)}-{[SETTINGS[TASK, arm] for arm in ('oracle', *ARMS)]}"
        kinds: list[tuple[str, Any]] = [(kind, delay) for kind in (_PLAIN, _INTEGRAL) for delay in DELAYS]
        kinds += [("arm", arm) for arm in ARMS]
        kinds += [("filter", name) for name in FILTERS]
        units = {(*kind, index, episodes, self.seed): stamp for kind in kinds for index in range(episodes)}
        path = self.out / "detection_delay.jsonl"
        results = run_units(path, run_unit, units, label="detection delay", n_jobs=self.n_jobs)
        driven, filters = driven_lines(results), filter_lines(results)
        _show(driven, filters)
        self.save_figure(
            delay_figure(driven, filters),
            "detection_delay",
            "Numbers: failed episodes. Where the lines leave the level on the left, n is known too late.",
        )
        self.save_numbers({"driven": driven, "filters": filters, "seed": self.seed})


def _show(driven: list[DrivenLine], filters: list[FilterLine]) -> None:
    body = [
        (
            line.name,
            "-" if math.isnan(line.delay) else f"{line.delay:g}",
            f"{line.score:.1f}",
            f"{line.failures} of {line.episodes}",
        )
        for line in driven
    ]
    heading = ("who drives", "n is late by [s]", "time [s]", "failures")
    console().print(table("patches by what is known of n", heading, body))
    rows = [
        (
            line.name,
            f"{line.delay:.2f}",
            f"{line.answered:.0%}",
            f"{line.edges}",
            f"{line.rmse:.3f}",
            f"{line.coverage:.0%}",
            f"{line.valid:.0%}",
        )
        for line in filters
    ]
    columns = ("filter", "delay [s]", "answered", "edges", "RMSE [-]", "within 2 sd", "flag up")
    console().print(table(f"the filter on board: from an edge to n within {NEAR:g}", columns, rows))
