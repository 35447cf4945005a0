"""``offroad reproduce learning``: does a trained policy drive better with the terrain estimate?

For each task three arms are trained by PPO with the same settings and several seeds: ``ppo_aware`` sees
mean and standard deviation of the filter on board, ``ppo_oblivious`` does not, ``ppo_memory`` sees its last
ten observations (two seconds) instead. All use the interface ``plan`` of `agents.learning.action_interface`.
Learning begins at its zero action, which is shown beside them with and without the estimate.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.benchmark.learned import LearnedArm, learned_verdict, summarise_learned
from agents.benchmark.runner import ENV_ID, Draw, draw_episodes, run_episode
from agents.commands.options import Jobs, Scenarios
from agents.controllers.protocol import Agent
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.learning.action_interface import ZeroAction
from agents.learning.policies import KIND, LEARNED, SCALING, WEIGHTS, load_policy
from agents.learning.train import TrainArgs, configuration_hash, train
from agents.reports.output import Results, console, say, table
from agents.studies.information_in_one_sample.study import one_sample_error
from agents.studies.runner import Key, Result, run_units, stamp_of
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import MEASURES, SCENARIOS
from offroad_env.errors import InvalidParameter

__all__ = ["SOURCES", "Learning", "arguments", "copy_policy", "drive", "run_unit", "train_one"]

_CHECK_STEPS = 5_000  #: between two drives of the tuning episodes
_FRAMES = 10  #: of the arm with memory: two seconds
#: What stands behind a trained policy and its episodes.
SOURCES = (
    "agents.learning.train",
    "agents.learning.sb3_vec_env",
    "agents.benchmark.runner",
    "offroad_env.environment.vector_env",
)
#: Units beside the policies: a tracker, the zero action, and the information on n in one observation.
_PLAIN, _ONE_SAMPLE = "pure_pursuit", "one_sample"
_ZERO = {"zero_aware": "estimate", "zero_oblivious": "none"}
#: Arms, and what each is trained with: the best of three recipes on tuning episodes (`docs/benchmark.md`).
_RECIPES: dict[str, dict[str, Any]] = {
    "ppo_aware": {"log_std": -4.0, "charge": 1.0},
    "ppo_oblivious": {"log_std": -3.2, "charge": 1.0 / 3.0},
    "ppo_memory": {"log_std": -3.2, "charge": 1.0 / 3.0},
}


def arguments(task: str, arm: str, seed: int, steps: int, out: Path) -> TrainArgs:
    """What a policy is trained with."""
    return TrainArgs(
        scenario=task,
        terrain_info=LEARNED[arm],
        frames=_FRAMES if arm == "ppo_memory" else 1,
        seed=seed,
        total_steps=steps,
        threads=1,
        resume=True,
        eval_episodes=0,
        check_steps=_CHECK_STEPS,
        **_RECIPES[arm],
        out=out / "policies" / task / arm / str(seed),
    )


def train_one(args: TrainArgs) -> dict[str, Any]:
    """Train a policy, or take up its training: configuration, learning curve and speed."""
    import torch

    torch.set_num_threads(1)
    result = train(args)
    checks = [point for point in result.curve if point.score is not None]
    return {
        "configuration": result.configuration,
        "curve": [(point.steps, point.wall_time, point.score) for point in checks],
        "periods_per_second": result.periods_per_second,
        "wall_time": result.wall_time,
    }


def drive(agent: Agent, task: str, terrain_info: str, draws: Sequence[Draw]) -> dict[str, Any]:
    """Scores and successes of these episodes."""
    env = gym.make(ENV_ID, scenario=task, terrain_info=terrain_info)
    driven = [run_episode(env, agent, draw.seed, n=draw.n) for draw in draws]
    env.close()
    return {
        "scores": [episode.score for episode in driven],
        "success": [episode.success for episode in driven],
    }


def copy_policy(home: Path, goal: Path) -> None:
    """Copy what `load_policy` needs of a policy."""
    goal.mkdir(parents=True, exist_ok=True)
    for name in (WEIGHTS, SCALING, KIND):
        shutil.copyfile(home / name, goal / name)


def run_unit(
    task: str, arm: str, seed: int, steps: int, episodes: int, test_seed: int, *, out: Path
) -> dict[str, Any]:
    """Train one policy, or take up its training, and drive the test episodes; a unit of `run_units`."""
    if arm == _ONE_SAMPLE:
        return {"errors": one_sample_error(task, episodes)}
    draws = draw_episodes(task, episodes, test_seed)
    if arm == _PLAIN:
        return drive(PurePursuitAgent(), task, "none", draws)
    if arm in _ZERO:
        return drive(ZeroAction(), task, _ZERO[arm], draws)
    args = arguments(task, arm, seed, steps, out)
    found = train_one(args)
    return {**found, **drive(load_policy(args.out), task, args.terrain_info, draws)}


@dataclass(kw_only=True)
class Learning(Results):
    """Policies trained with the estimate, without it, and with memory instead (needs the extra rl).

    Writes the figure learning.png, the policies and their learning curves. A run that was interrupted goes
    on from the last checkpoint of the policy it was at.
    """

    tasks: Scenarios = ("speed", "brake")  #: what is learnt
    arms: tuple[str, ...] = tuple(_RECIPES)  #: ppo_aware, ppo_oblivious, ppo_memory
    seeds: int = 5  #: trainings of each
    steps: int = 16_000  #: of the policy in each training; one lasts 10 control periods
    episodes: int = 20  #: test episodes of each policy
    test_seed: int = 1  #: of these episodes
    ship: Path | None = None  #: also copy weights and settings of the policies into this folder
    n_jobs: Jobs = 2  #: local processes

    def run(self) -> None:
        """Train and drive what is missing, then plot and print."""
        from agents.studies.learning.figure import learning_figure

        self._check()
        done = run_units(
            self.out / "learning.jsonl",
            partial(run_unit, out=self.out),
            self._stamps(),
            label="policies",
            n_jobs=self.n_jobs,
        )
        arms = self._summaries(done)
        units = {task: MEASURES[SCENARIOS[task].measure][1] for task in self.tasks}
        one_sample = {key[0]: done[key]["errors"] for key in done if key[1] == _ONE_SAMPLE}
        rows = []
        for arm in arms:
            each = ", ".join(f"{mean:.3g}" for mean in arm.means)
            score = f"{arm.score:.3g}" if len(arm.seeds) > 1 else f"{arm.score.value:.3g}"
            score = f"{score} {units[arm.task]}"
            rows.append((arm.task, arm.arm, score, each, f"{100.0 * arm.failed:.0f} %"))
        title = f"{self.seeds} training seeds, {self.episodes} episodes each"
        heading = ("task", "arm", "mean over training seeds", "each seed", "failures")
        console().print(table(title, heading, rows, texts=2))
        for task in self.tasks:
            here = [arm for arm in arms if arm.task == task]
            say(learned_verdict(here, units[task]))
            error, prior = one_sample[task]
            say(f"A single observation on {task} gives n to {error:.3f} (prior {prior:.3f}).")
        rates = [unit["periods_per_second"] for unit in done.values() if "periods_per_second" in unit]
        say(f"training: {min(rates):.0f} to {max(rates):.0f} environment steps a second in one process")
        self.save_figure(
            learning_figure(arms, self._curves(done)),
            "learning",
            "Left: score while learning, thin lines single trainings. Right: test score of each "
            "training, diamonds their mean.",
        )
        if self.ship is not None:
            self._copy(self.ship)
        numbers = {
            "arms": [asdict(arm) for arm in arms],
            "curves": self._curves(done),
            "one_sample": one_sample,
        }
        self.save_numbers(numbers)

    def _check(self) -> None:
        for task in self.tasks:
            find_scenario(task)
        unknown = set(self.arms) - set(_RECIPES)
        if unknown:
            raise InvalidParameter(f"arms must be of {', '.join(_RECIPES)}, got {', '.join(sorted(unknown))}")
        for name, least in (("seeds", 1), ("steps", 1), ("episodes", 2)):
            if getattr(self, name) < least:
                raise InvalidParameter(f"{name} must be >= {least}, got {getattr(self, name)}")

    def _keys(self) -> list[Key]:
        """All arms of a seed before the next seed: what is there can be compared at any time."""
        trained = [
            (task, arm, seed, self.steps, self.episodes, self.test_seed)
            for seed in range(self.seeds)
            for task in self.tasks
            for arm in self.arms
        ]
        beside = [
            (task, name, 0, 0, self.episodes, self.test_seed)
            for task in self.tasks
            for name in (_PLAIN, _ONE_SAMPLE, *_ZERO)
        ]
        return beside + trained

    def _stamps(self) -> dict[Key, str]:
        """Sources, and the configuration of the training."""
        sources = stamp_of(*SOURCES)
        stamps = {}
        for key in self._keys():
            task, arm, seed, steps = key[:4]
            trained = (
                configuration_hash(arguments(task, arm, seed, steps, self.out)) if arm in _RECIPES else ""
            )
            stamps[key] = f"{sources}-{trained}"
        return stamps

    def _summaries(self, done: Mapping[Key, Result]) -> list[LearnedArm]:
        return [
            summarise_learned(
                task,
                arm,
                {
                    key[2]: (done[key]["scores"], done[key]["success"])
                    for key in self._keys()
                    if key[:2] == (task, arm)
                },
            )
            for task in self.tasks
            for arm in (*self.arms, *_ZERO, _PLAIN)
        ]

    def _curves(self, done: Mapping[Key, Result]) -> list[dict[str, Any]]:
        """Learning curve of every policy."""
        return [
            {"task": key[0], "arm": key[1], "seed": key[2], "points": done[key]["curve"]}
            for key in self._keys()
            if key[1] in _RECIPES
        ]

    def _copy(self, folder: Path) -> None:
        for task, arm, seed, steps, *_ in self._keys():
            if arm in _RECIPES:
                home = arguments(task, arm, seed, steps, self.out).out
                copy_policy(home, folder / task / arm / str(seed))
        say(f"policies: {folder}")
