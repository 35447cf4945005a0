"""The benchmark as a long study: every episode of every agent is a unit that is kept.

A unit is (task, form, agent, number of the episode). Units are appended to a file as they come, so an
interrupted run goes on where it stopped, and `offroad compare` finds the arms' episodes already driven.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.benchmark.learned import LearnedArm, summarise_learned
from agents.benchmark.natural import NATURAL_TASKS, is_natural, options_of
from agents.benchmark.runner import ENV_ID, FORMS, OVER_N, draw_episodes, run_episode
from agents.benchmark.summary import Benchmark, summarise
from agents.controllers.arms import ARMS, COMMON_KNOBS
from agents.controllers.natural_tuned import SETTINGS as NATURAL_SETTINGS
from agents.controllers.nmpc_arms import PREDICTIVE, natural_knobs
from agents.controllers.protocol import ArmResult, EpisodeResult
from agents.controllers.tuned import COMMON_PLACES, SETTINGS
from agents.driving.episode import (
    AGENTS,
    OWN_KNOBS,
    agent_list,
    find_agent,
    is_agent,
    trained_name,
)
from agents.driving.own_agents import course_content, own_content
from agents.learning.policies import LEARNED, WEIGHTS, learned_folder, shipped_seeds
from agents.studies.runner import Key, run_units, stamp_of
from offroad_env.environment.scenario_descriptions import find_scenario, scenario_mapping
from offroad_env.environment.scenarios import BUILT_IN
from offroad_env.errors import InvalidParameter

__all__ = ["EPISODES", "BenchmarkArgs", "drive_unit", "run_learned", "run_study", "usual_knobs"]

#: What is driven: everything that decides a result. A change of any of it makes its units anew.
_SOURCES = ("agents.benchmark.runner", "agents.driving.episode", "offroad_env.environment.env")
#: File of the units in the folder of the results.
EPISODES = "episodes.jsonl"


def usual_knobs(form: str) -> str:
    """Knobs with which the arms drive a form where none are asked for."""
    return "common" if is_natural(form) else "own"


@dataclass(frozen=True, kw_only=True)
class BenchmarkArgs:
    """What is compared on what."""

    tasks: tuple[str, ...] = BUILT_IN
    agents: tuple[str, ...] = ("pure_pursuit", *ARMS)
    forms: tuple[str, ...] = OVER_N
    episodes: int = 100  #: paired episodes of each agent, in each task and form
    seed: int = 0  #: of the episodes; never those of the tuning
    n_jobs: int = 2  #: local processes; the results do not depend on it
    world: str = ""  #: further arguments of ``gym.make`` for all, as JSON
    knobs: str | None = None  #: of the arms, "common" or "own"; None: common in natural forms, else own

    @property
    def cells(self) -> list[tuple[str, str]]:
        """(task, form) of all that is driven: not every task has natural forms."""
        return [
            (task, form)
            for task in self.tasks
            for form in self.forms
            if not is_natural(form) or find_scenario(task).task in NATURAL_TASKS
        ]

    def driver(self, agent: str, form: str) -> str:
        """The name of an agent among the units: other knobs than the form's usual ones make another one."""
        other = OWN_KNOBS if is_natural(form) else COMMON_KNOBS
        return f"{agent}{other}" if agent in ARMS and self.knobs not in (None, usual_knobs(form)) else agent

    def check(self) -> None:
        """Refuse what cannot be run, by name.

        Raises
        ------
        InvalidParameter
            For an unknown task, agent or form, or fewer than two episodes.
        """
        if not self.agents:
            raise InvalidParameter("agents must name at least one, got none")
        if self.n_jobs == 0:
            raise InvalidParameter("n_jobs must be 1 or more, or -1 for all processors, got 0")
        for task in self.tasks:
            find_scenario(task)
        for agent in self.agents:
            if not is_agent(agent):
                known = agent_list(self.tasks[0]) if len(self.tasks) == 1 else ", ".join(AGENTS)
                raise InvalidParameter(f"agent must be one of {known}, or module:Class, got {agent!r}")
        for form in self.forms:
            if form not in FORMS:
                raise InvalidParameter(f"form must be one of {', '.join(FORMS)}, got {form!r}")
        if not self.cells:
            raise InvalidParameter(
                f"natural forms have {', '.join(NATURAL_TASKS)}, got {', '.join(self.tasks)} - in patches n "
                "alone changes, which no soils side by side do"
            )
        if self.episodes < 2:
            raise InvalidParameter(f"episodes must be at least 2, got {self.episodes} - no interval from one")


def drive_unit(
    task: str,
    form: str,
    agent: str,
    episode: int,
    episodes: int,
    seed: int,
    terrain_info: str | None = None,
    world: str = "",
) -> dict[str, Any]:
    """Drive episode number ``episode`` of ``episodes``; a unit of `run_units`."""
    own = json.loads(world) if world else {}
    draw = draw_episodes(task, episodes, seed, form=form, world=own)[episode]
    driver, terrain_info = find_agent(agent, task, terrain_info, form=form)
    env = gym.make(ENV_ID, terrain_info=terrain_info, **options_of(task, form, own))
    try:
        return asdict(run_episode(env, driver, draw.seed, options=draw.options))
    finally:
        env.close()


def _stamp(task: str, agent: str, form: str) -> str:
    """Stamp of what stands behind an agent's episodes: sources, and its settings, weights or own file."""
    if is_natural(form) and agent.removesuffix(OWN_KNOBS) in ARMS:
        knobs = "own" if agent.endswith(OWN_KNOBS) else "common"
        place = (find_scenario(task).task, agent.removesuffix(OWN_KNOBS), knobs)
        own = repr(NATURAL_SETTINGS.get(place)).encode()
    elif is_natural(form) and agent in PREDICTIVE:
        own = repr(natural_knobs(find_scenario(task).task, agent)).encode()
    elif ":" in agent:
        own = own_content(agent)
    elif (trained := trained_name(agent)) is not None:
        own = (learned_folder(find_scenario(task).task, *trained) / WEIGHTS).read_bytes()
    elif agent.endswith(COMMON_KNOBS):
        shared = find_scenario(task).task
        own = repr((SETTINGS.get((shared, "oracle")), COMMON_PLACES.get(shared))).encode()
    else:
        own = repr(SETTINGS.get((find_scenario(task).task, agent.removeprefix("lqr_")))).encode()
    if task not in BUILT_IN:
        mapping = scenario_mapping(find_scenario(task)) or {}
        own += repr(mapping).encode()
        if isinstance(course := mapping.get("course"), str):
            own += course_content(course)
    return f"{stamp_of(*_SOURCES)}-{hashlib.sha256(own).hexdigest()[:10]}"


def _stamps(keys: Sequence[Key]) -> dict[Key, str]:
    """Key -> stamp; what stands behind an agent is looked at once for all its episodes."""
    agents = {key: (key[0], key[2], key[1]) for key in keys}
    found = {agent: _stamp(*agent) for agent in dict.fromkeys(agents.values())}
    return {key: found[agent] for key, agent in agents.items()}


def _key(args: BenchmarkArgs, unit: tuple[str, str, str, int], terrain_info: str | None) -> Key:
    """Key of a unit: what is not given is left out, so that what was driven before is found."""
    given = () if terrain_info is None and not args.world else (terrain_info,)
    return (*unit, args.episodes, args.seed, *given, *((args.world,) if args.world else ()))


def run_study(
    args: BenchmarkArgs, out: Path, *, terrain_info: str | None = None
) -> dict[tuple[str, str], Benchmark]:
    """Drive what is missing in ``out`` and compare: (task, form) -> `Benchmark`.

    Parameters
    ----------
    args
    out
        Folder of the units.
    terrain_info
        Terrain information for agents that are given as ``module:Class``; default "none".
    """
    args.check()
    for task, form in args.cells:
        options_of(task, form, json.loads(args.world) if args.world else {})  # refuses what does not fit

    def key(task: str, form: str, agent: str, episode: int) -> Key:
        unit = (task, form, args.driver(agent, form), episode)
        return _key(args, unit, terrain_info or "none" if ":" in agent else None)

    keys = [
        key(task, form, agent, episode)
        for task, form in args.cells
        for agent in args.agents
        for episode in range(args.episodes)
    ]
    done = run_units(out / EPISODES, drive_unit, _stamps(keys), label="episodes", n_jobs=args.n_jobs)
    results = {}
    for task, form in args.cells:
        arms = tuple(
            _result(task, agent, [done[key(task, form, agent, i)] for i in range(args.episodes)])
            for agent in args.agents
        )
        results[task, form] = summarise(task, args.seed, arms, form=form)
    return results


def run_learned(args: BenchmarkArgs, out: Path) -> dict[tuple[str, str], list[LearnedArm]]:
    """Drive the shipped policies on the same episodes: (task, form) -> arms, where there are any."""
    keys = [
        _key(args, (task, form, f"{arm}_{seed}", episode), None)
        for task, form in args.cells
        if form in OVER_N
        for arm in LEARNED
        for seed in shipped_seeds(find_scenario(task).task, arm)
        for episode in range(args.episodes)
    ]
    if not keys:
        return {}
    done = run_units(out / EPISODES, drive_unit, _stamps(keys), label="policies", n_jobs=args.n_jobs)
    found: dict[tuple[str, str], list[LearnedArm]] = {}
    for task, form, arm in dict.fromkeys((key[0], key[1], key[2].rpartition("_")[0]) for key in keys):
        episodes = {}
        for seed in shipped_seeds(find_scenario(task).task, arm):
            units = [done[key] for key in keys if key[:3] == (task, form, f"{arm}_{seed}")]
            episodes[seed] = [unit["score"] for unit in units], [unit["success"] for unit in units]
        found.setdefault((task, form), []).append(summarise_learned(task, arm, episodes))
    return found


def _result(task: str, agent: str, units: Sequence[dict[str, Any]]) -> ArmResult:
    return ArmResult(
        name=agent,
        time_limit=find_scenario(task).time_limit,
        episodes=tuple(EpisodeResult(**unit) for unit in units),
    )
