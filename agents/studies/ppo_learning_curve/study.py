"""``offroad reproduce ppo_learning_curve``: training time until PPO outdoes pure pursuit.

The policies of `offroad reproduce learning` outdo it before their first update, since their action
interface plans the speed. Here none is planned. ``tracker``: geometry steers, the policy gives the speed,
from standing to 15 m/s; untrained it drives into every bend at 7.5 m/s and leaves the corridor on soft
soil. ``direct``: the policy steers and drives, ten times a second; untrained it rolls to a stand. Both have
to learn the speed that a bend allows on each soil, with the estimate or without it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.benchmark.learned import LearnedArm, learned_verdict, summarise_learned
from agents.benchmark.runner import draw_episodes
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.learning.action_interface import ZeroAction
from agents.learning.policies import LEARNED, load_policy
from agents.learning.train import TrainArgs, configuration_hash
from agents.reports.output import Results, console, say, table
from agents.studies.learning.study import SOURCES, copy_policy, drive, train_one
from agents.studies.ppo_learning_curve.results import ARMS, Curve
from agents.studies.runner import Key, Result, run_units, stamp_of
from offroad_env.errors import InvalidParameter

__all__ = ["TASK", "PPOLearningCurve", "arguments", "run_unit"]

TASK = "speed"
#: Recipes of both action interfaces; chosen on tuning episodes with a training seed outside the study.
_RECIPES: dict[str, dict[str, Any]] = {
    "tracker": {
        "total_steps": 40_000,
        "log_std": -2.0,
        "first_charge": 0.1,
        "charge": 0.8,
        "pace": 0.4,
        "gamma": 0.98,
        "batch_size": 512,
        "check_steps": 4_000,
    },
    "direct": {
        "total_steps": 450_000,
        "log_std": -1.0,
        "charge": 0.05,
        "pace": 0.4,
        "gamma": 0.99,
        "n_steps": 128,
        "batch_size": 1024,
        "learning_rate": 1e-3,
        "noise_steps": 10,
        "check_steps": 25_000,
    },
}
#: Units beside the trainings: a tracker on tuning and on test episodes, and the zero actions.
_PLAIN, _TUNING = "pure_pursuit", "pure_pursuit, tuning"
_UNTRAINED = {"tracker_untrained": "tracker", "direct_untrained": "direct"}


def arguments(arm: str, seed: int, out: Path) -> TrainArgs:
    """What a policy is trained with."""
    interface = ARMS[arm]
    return TrainArgs(
        scenario=TASK,
        action_interface=interface,
        terrain_info=LEARNED[arm],
        seed=seed,
        resume=True,
        eval_episodes=0,
        **_RECIPES[interface],
        out=out / "policies" / TASK / arm / str(seed),
    )


def run_unit(arm: str, seed: int, episodes: int, test_seed: int, *, out: Path) -> dict[str, Any]:
    """Train one policy, or take up its training, and drive the test episodes; a unit of `run_units`."""
    draws = draw_episodes(TASK, episodes, test_seed)
    if arm == _PLAIN:
        return drive(PurePursuitAgent(), TASK, "none", draws)
    if arm == _TUNING:
        tuning = draw_episodes(TASK, TrainArgs().check_episodes, 0, training=True)
        return drive(PurePursuitAgent(), TASK, "none", tuning)
    if arm in _UNTRAINED:
        return drive(ZeroAction(_UNTRAINED[arm]), TASK, "none", draws)
    args = arguments(arm, seed, out)
    found = train_one(args)
    return {**found, **drive(load_policy(args.out), TASK, args.terrain_info, draws)}


@dataclass(kw_only=True)
class PPOLearningCurve(Results):
    """Policies that start behind pure pursuit and learn their way past it (needs the extra rl).

    Trains one policy after another, each on all processors, prints when each is past pure pursuit, and
    writes the figure ppo_learning_curve.png, the policies and their learning curves. A run that was
    interrupted goes on from the last checkpoint of the policy it was at.
    """

    arms: tuple[str, ...] = ("ppo_tracker_aware", "ppo_tracker_oblivious")  #: or ppo_direct_aware
    seeds: int = 5  #: trainings of each
    episodes: int = 50  #: test episodes of each policy
    test_seed: int = 7  #: of these episodes
    ship: Path | None = None  #: also copy weights and settings of the policies into this folder

    def run(self) -> None:
        """Train and drive what is missing, then plot and print."""
        from agents.studies.ppo_learning_curve.figure import learning_curve_figure

        self._check()
        done = run_units(
            self.out / "passing.jsonl",
            partial(run_unit, out=self.out),
            self._stamps(),
            label="policies",
            n_jobs=1,
        )
        reference = float(np.mean(done[self._key(_TUNING)]["scores"]))
        trained = [key for key in done if key[0] in ARMS]
        curves = [Curve.of(key[0], key[1], done[key]["curve"], reference) for key in trained]
        rates = {key[:2]: done[key]["periods_per_second"] for key in trained}
        arms = self._summaries(done)
        self._print_curves(curves, rates)
        self._print_scores(arms)
        say(learned_verdict(arms, "s"))
        self.save_figure(
            learning_curve_figure(curves, reference),
            "ppo_learning_curve",
            "A line is one training; a ring shows from where on it stays below pure pursuit (dashed).",
        )
        if self.ship is not None:
            for arm, seed, *_ in trained:
                copy_policy(arguments(arm, seed, self.out).out, self.ship / TASK / arm / str(seed))
            say(f"policies: {self.ship}")
        numbers = {"arms": [asdict(arm) for arm in arms], "curves": [asdict(curve) for curve in curves]}
        self.save_numbers({**numbers, "pure_pursuit_tuning": reference, "rates": list(rates.values())})

    def _check(self) -> None:
        unknown = set(self.arms) - set(ARMS)
        if unknown:
            raise InvalidParameter(f"arms must be of {', '.join(ARMS)}, got {', '.join(sorted(unknown))}")
        for name, least in (("seeds", 1), ("episodes", 2)):
            if getattr(self, name) < least:
                raise InvalidParameter(f"{name} must be >= {least}, got {getattr(self, name)}")

    def _key(self, arm: str, seed: int = 0) -> Key:
        return (arm, seed, self.episodes, self.test_seed)

    def _untrained(self) -> list[str]:
        """Units of the zero action of these arms' interfaces."""
        used = {ARMS[arm] for arm in self.arms}
        return [name for name, interface in _UNTRAINED.items() if interface in used]

    def _stamps(self) -> dict[Key, str]:
        """Sources, and the configuration of the training; all arms of a seed before the next seed."""
        sources = stamp_of(*SOURCES)
        beside = {self._key(arm): sources for arm in (_PLAIN, _TUNING, *self._untrained())}
        trained = {
            self._key(arm, seed): f"{sources}-{configuration_hash(arguments(arm, seed, self.out))}"
            for seed in range(self.seeds)
            for arm in self.arms
        }
        return beside | trained

    def _summaries(self, done: Mapping[Key, Result]) -> list[LearnedArm]:
        """On test episodes, pure pursuit first."""
        return [
            summarise_learned(
                TASK,
                arm,
                {key[1]: (unit["scores"], unit["success"]) for key, unit in done.items() if key[0] == arm},
            )
            for arm in (_PLAIN, *self._untrained(), *self.arms)
        ]

    def _print_curves(self, curves: Sequence[Curve], rates: Mapping[tuple[str, int], float]) -> None:
        rows = [
            (
                curve.arm,
                f"{curve.seed}",
                f"{curve.scores[0]:.3g}",
                _moment(curve, curve.passed),
                _moment(curve, curve.ahead),
                f"{min(curve.scores):.3g}",
                f"{curve.wall_times[-1]:.0f}",
                f"{rates[curve.arm, curve.seed]:.0f}",
            )
            for curve in curves
        ]
        heading = ("arm", "seed", "untrained [s]", "first past", "past for good", "best [s]", "in all [s]")
        title = "Tuning episodes: wall time (steps of the policy) until a policy is past pure pursuit"
        console().print(table(title, (*heading, "env steps/s"), rows, texts=1))

    def _print_scores(self, arms: Sequence[LearnedArm]) -> None:
        rows = [
            (
                arm.arm,
                f"{arm.score:.3g} s" if len(arm.seeds) > 1 else f"{arm.score.value:.3g} s",
                ", ".join(f"{mean:.3g}" for mean in arm.means),
                f"{100.0 * arm.failed:.0f} %",
            )
            for arm in arms
        ]
        title = f"{self.episodes} test episodes each"
        heading = ("arm", "mean over training seeds", "each seed", "failures")
        console().print(table(title, heading, rows, texts=1))


def _moment(curve: Curve, index: int | None) -> str:
    """Wall time and steps of a drive of the tuning episodes."""
    if index is None:
        return "never"
    return f"{curve.wall_times[index]:.0f} s ({curve.steps[index]})"
