"""``offroad reproduce direct_policies``: policies that steer and drive themselves, on natural soils.

No planner and no tracker is inside: ten times a second a policy gives steering and drive. Four arms learn by
one recipe (`agents/recipes/direct.yaml`) and differ in what they see of the soil: nothing, nothing but the
last second of all observations, the belief (emulated in training, itself in the test), or the true limits.
For comparison a fifth, ``direct_sac``, learns with the true limits by SAC, from the same rewards. And
``direct_oracle_refined`` goes on from the shipped policy that observes the true limits, with dearer failures
and less noise (`agents/recipes/direct_refined.yaml`).

Every policy also drives validation episodes. By these, not by the test, one training of each arm is chosen to
be shipped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from agents.benchmark.learned import (
    LearnedArm,
    improvement_interval,
    improvement_verdict,
    interquartile_interval,
    ratio_interval,
    summarise_learned,
)
from agents.benchmark.runner import Draw, draw_episodes
from agents.benchmark.statistics import wilson_interval
from agents.commands.options import Scenarios
from agents.controllers.protocol import Agent
from agents.driving.episode import find_agent
from agents.driving.world_options import WorldOptions
from agents.learning.arguments import TrainArgs, configuration_hash
from agents.learning.checks import drive_each, merit, scores_together
from agents.learning.policies import DIRECT, PolicyAgent, learned_folder, load_policy, shipped_seeds
from agents.reports.output import Results, console, say, table
from agents.studies.learning.study import SOURCES, copy_policy, train_one
from agents.studies.runner import Key, Result, run_units, stamp_of
from offroad_env.errors import InvalidParameter

__all__ = ["FORM", "DirectPolicies", "arguments", "run_unit", "shipped_seed"]

FORM = "natural"
#: The arm that learns off policy; what else differs in it is in `agents/recipes/direct_sac.yaml`.
_SAC = "direct_sac"
#: The arm that goes on from a shipped policy, and the arm of that.
_REFINED, _UNREFINED = "direct_oracle_refined", "direct_oracle"
#: The arms that are compared.
_ARMS = tuple(arm for arm in DIRECT if arm != _REFINED)
#: Arm -> what it observes of the soil.
_SHOWN = {**DIRECT, _SAC: "limits"}
#: Observations that the arm with memory sees side by side: one second.
_FRAMES = 10
#: Validation episodes by which a training is chosen, and their seed: others than those of its checks.
_VALIDATION_EPISODES, _VALIDATION_SEED = 100, 1
#: Beside the policies, on the same episodes: the benchmark's arms that know nothing of the soil, and all.
_BESIDE = ("nominal", "oracle")


def recipes() -> Mapping[str, dict[str, Any]]:
    """Task -> options of `offroad train`."""
    return _recipe_file("direct.yaml")


def _recipe_file(name: str) -> dict[str, Any]:
    text = (files("agents") / "recipes" / name).read_text(encoding="utf-8")
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def arguments(task: str, arm: str, seed: int, out: Path) -> TrainArgs:
    """What a policy is trained with; the four arms of PPO differ in what they see and in nothing else."""
    recipe = {**recipes()[task], **_departures(task, arm)}
    weights = yaml.safe_dump(recipe.pop("weights"), default_flow_style=True).strip()
    return TrainArgs(
        scenario=task,
        form=FORM,
        objective="reward",
        terrain_info=_SHOWN[arm],
        emulated=_SHOWN[arm] == "belief",
        frames=_FRAMES if arm == "direct_memory" else 1,
        seed=seed,
        threads=1,
        resume=True,
        eval_episodes=0,
        edge=tuple(recipe.pop("edge")),
        world=WorldOptions(weights=weights),
        out=out / "policies" / task / arm / str(seed),
        **recipe,
    )


def _departures(task: str, arm: str) -> dict[str, Any]:
    """What an arm has instead of the common recipe."""
    if arm == _SAC:
        return _recipe_file("direct_sac.yaml")
    if arm != _REFINED:
        return {}
    recipe = _recipe_file("direct_refined.yaml")
    if task not in recipe:
        raise InvalidParameter(f"{_REFINED} has a recipe for {', '.join(recipe)}, not for {task}")
    return {**recipe[task], "start": learned_folder(task, _UNREFINED, shipped_seeds(task, _UNREFINED)[0])}


def run_unit(task: str, arm: str, seed: int, episodes: int, test_seed: int, *, out: Path) -> Result:
    """Train one policy, or take up its training, and drive the test episodes; a unit of `run_units`."""
    draws = draw_episodes(task, episodes, test_seed, form=FORM)
    if arm in _BESIDE:
        agent, shown = find_agent(arm, task, None, form=FORM)
        return _driven(agent, task, draws, shown)
    args = arguments(task, arm, seed, out)
    found = train_one(args)
    agent = load_policy(args.out)
    validation = draw_episodes(task, _VALIDATION_EPISODES, _VALIDATION_SEED, form=FORM, split="validation")
    return {
        **found,
        "validation": _driven_by(agent, args, validation),
        **_driven_by(agent, args, draws),
    }


def _driven_by(agent: PolicyAgent, args: TrainArgs, draws: Sequence[Draw]) -> Result:
    """Scores and successes of a policy, episodes side by side."""
    scores, success = scores_together(
        agent.decide_all,
        args.scenario,
        draws,
        form=args.form,
        interface=args.action_interface,
        terrain_info=args.terrain_info,
        threads=1,
    )
    return {"scores": scores.tolist(), "success": success.tolist()}


def _driven(agent: Agent, task: str, draws: Sequence[Draw], terrain_info: str) -> Result:
    """Scores and successes of these episodes."""
    driven = drive_each(agent, task, draws, form=FORM, terrain_info=terrain_info)
    return {
        "scores": [episode.score for episode in driven],
        "success": [episode.success for episode in driven],
    }


def shipped_seed(done: Mapping[Key, Result], task: str, arm: str) -> int:
    """The training of an arm that does best in validation episodes, by `agents.learning.checks.merit`."""
    most = float(recipes()[task]["most_failures"])
    found = {
        key[2]: merit(np.array(unit["validation"]["scores"]), np.array(unit["validation"]["success"]), most)
        for key, unit in done.items()
        if key[:2] == (task, arm)
    }
    return int(min(found, key=lambda seed: found[seed]))


@dataclass(kw_only=True)
class DirectPolicies(Results):
    """Policies that steer and drive themselves on natural soils, in four arms (needs the extra rl).

    Trains what is missing, one policy after the other, and drives the test episodes. A run that was
    interrupted goes on from the last checkpoint of the policy it was at.
    """

    tasks: Scenarios = ("speed",)  #: of agents/recipes/direct.yaml
    arms: tuple[str, ...] = _ARMS  #: what is seen of the soil; also direct_sac and direct_oracle_refined
    seeds: int = 5  #: trainings of each
    episodes: int = 200  #: test episodes of each policy
    test_seed: int = 11  #: of these episodes
    ship: Path | None = None  #: also copy the best training of each arm of PPO, by validation, to this folder

    def run(self) -> None:
        """Train and drive what is missing, then print."""
        self._check()
        unit = partial(run_unit, out=self.out)
        done = run_units(self.out / "direct.jsonl", unit, self._stamps(), label="policies", n_jobs=1)
        arms = self._summaries(done)
        rows = []
        for arm in arms:
            middle = interquartile_interval(_scores(done, arm.task, arm.arm))
            each = ", ".join(f"{mean:.3g}" for mean in arm.means)
            failed = ", ".join(f"{100.0 * share:.1f}" for share in arm.failures)
            rows.append((arm.task, arm.arm, each, f"{middle:.3g}", f"{failed} %"))
        heading = ("task", "arm", "mean of each training [s]", "interquartile mean [s]", "failures of each")
        console().print(table(f"{self.episodes} test episodes", heading, rows, texts=2))
        for sentence in self._sentences(done):
            say(sentence)
        if self.ship is not None:
            for task, arm in dict.fromkeys(key[:2] for key in done if key[1] in DIRECT):
                seed = shipped_seed(done, task, arm)
                copy_policy(arguments(task, arm, seed, self.out).out, self.ship / task / arm / str(seed))
            say(f"policies: {self.ship}")
        curves = [{"key": key[:3], "points": unit["curve"]} for key, unit in done.items() if "curve" in unit]
        self.save_numbers({"arms": [asdict(arm) for arm in arms], "curves": curves})

    def _check(self) -> None:
        for name, given, known in (
            ("tasks", self.tasks, tuple(recipes())),
            ("arms", self.arms, tuple(_SHOWN)),
        ):
            if unknown := set(given) - set(known):
                wrong = ", ".join(sorted(unknown))
                raise InvalidParameter(f"{name} must be of {', '.join(known)}, got {wrong}")
        for name, least in (("seeds", 1), ("episodes", 2)):
            if getattr(self, name) < least:
                raise InvalidParameter(f"{name} must be >= {least}, got {getattr(self, name)}")

    def _stamps(self) -> dict[Key, str]:
        """Sources, and the configuration of the training; all arms of a seed before the next seed."""
        sources = stamp_of(*SOURCES)
        stamps: dict[Key, str] = {}
        for seed in range(self.seeds):
            for task in self.tasks:
                for arm in self.arms:
                    trained = configuration_hash(arguments(task, arm, seed, self.out))
                    stamps[task, arm, seed, self.episodes, self.test_seed] = f"{sources}-{trained}"
        beside = stamp_of(*SOURCES, "agents.driving.episode")
        for task in self.tasks:
            for name in _BESIDE:
                stamps[task, name, 0, self.episodes, self.test_seed] = beside
        return stamps

    def _sentences(self, done: Mapping[Key, Result]) -> list[str]:
        """Every arm against those of the benchmark, and against the policies that see less."""
        found = []
        for task in self.tasks:
            for arm in self.arms:
                own = _scores(done, task, arm)
                less = [other for other in _SHOWN if other in self.arms]
                for other in (*_BESIDE, *less[: less.index(arm)]):
                    beside = _scores(done, task, other)
                    verdict = improvement_verdict(arm, other, improvement_interval(own, beside))
                    found.append(
                        f"{task}: {verdict} Time: {ratio_interval(own, beside):.2f} x that of {other}."
                    )
                found.append(self._shipped(done, task, arm))
        return found

    def _shipped(self, done: Mapping[Key, Result], task: str, arm: str) -> str:
        """What the training that is shipped does in the test, beside the best arm that is not trained."""
        seed = shipped_seed(done, task, arm)
        unit = done[task, arm, seed, self.episodes, self.test_seed]
        fastest = min(_BESIDE, key=lambda name: float(_scores(done, task, name).mean()))
        own, failed = np.array([unit["scores"]]), self.episodes - sum(unit["success"])
        share = wilson_interval(failed, self.episodes)
        range_ = f"{100.0 * share.low:.1f} to {100.0 * share.high:.1f} %"
        return (
            f"{task}: of {arm} training {seed} is shipped, the best of {self.seeds} on validation soils. "
            f"{failed} of {self.episodes} test episodes fail ({range_}), "
            f"time: {ratio_interval(own, _scores(done, task, fastest)):.2f} x that of {fastest}."
        )

    def _summaries(self, done: Mapping[Key, Result]) -> list[LearnedArm]:
        found = []
        for task, arm in dict.fromkeys(key[:2] for key in done):
            units = {key[2]: unit for key, unit in done.items() if key[:2] == (task, arm)}
            episodes = {seed: (unit["scores"], unit["success"]) for seed, unit in units.items()}
            found.append(summarise_learned(task, arm, episodes))
        return found


def _scores(done: Mapping[Key, Result], task: str, arm: str) -> np.ndarray:
    """Scores (S, E) of an arm, a row for each training."""
    return np.array([unit["scores"] for key, unit in done.items() if key[:2] == (task, arm)])
