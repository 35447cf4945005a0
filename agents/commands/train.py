"""``offroad train``: a policy by PPO, with or without memory, or by SAC."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agents.learning.arguments import check_arguments
from agents.learning.train import BOARD, REPORT, TrainArgs, TrainResult, configuration_hash, train
from agents.reports.output import console, say, table, write_json
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import MEASURES
from offroad_env.errors import DataError
from offroad_env.world.files import read_json

__all__ = ["Train"]


@dataclass(frozen=True, kw_only=True)
class Train(TrainArgs):
    """Train a policy by PPO, RecurrentPPO or SAC of stable-baselines3 (needs the extra rl).

    Writes the policy, the scaling of its observations, checkpoints and the learning curve to --out, and
    drives test episodes with the policy as it was saved. With --resume an interrupted run goes on from its
    last checkpoint and ends as if it had not been interrupted.
    """

    json: Path | None = None  #: also write the result to this file

    def run(self) -> None:
        """Train with a progress bar, then print what the saved policy does."""
        from rich.progress import Progress

        check_arguments(self)
        if self.resume and self._is_finished():
            say(f"finished already: {self.total_steps} steps, policy: {self.out} - another --out, or --seed?")
            return
        if self.tensorboard:
            say(f"watch: tensorboard --logdir {self.out / BOARD}")
        with Progress(console=console()) as bar:
            task = bar.add_task("training", total=self.total_steps if self.time_budget is None else 1.0)

            def report(steps: int, seconds: float) -> None:
                done = steps if self.time_budget is None else min(seconds / self.time_budget, 1.0)
                bar.update(task, completed=done, description=f"training, {steps} steps")

            try:
                result = train(self, progress=report)
            except KeyboardInterrupt:
                say("stopped: the same command with --resume goes on from the last checkpoint")
                raise
        rate = f"{result.periods_per_second:.0f} environment steps/s"
        self._show_curve(result)
        say(f"{result.steps} steps in {result.wall_time:.0f} s ({rate})")
        if result.evaluation:
            arrived = sum(episode.success for episode in result.evaluation)
            say(f"{arrived} of {len(result.evaluation)} test episodes reached the goal")
        say(f"policy: {result.policy}")
        if self.json is not None:
            write_json(self.json, result)

    def _is_finished(self) -> bool:
        """Whether the folder holds the end of this very run."""
        try:
            found = read_json(self.out / REPORT).get("result")
        except DataError:  # not there, or cut off
            return False
        return isinstance(found, dict) and found.get("configuration") == configuration_hash(self)

    def _show_curve(self, result: TrainResult) -> None:
        """The learning curve where the tuning episodes were driven."""
        unit = MEASURES[find_scenario(self.scenario).measure][1]
        rows = [
            (f"{point.steps}", f"{point.wall_time:.0f}", f"{point.score:.3g}")
            for point in result.curve
            if point.score is not None
        ]
        if rows:
            title = f"{self.check_episodes} tuning episodes, driven without noise"
            console().print(table(title, ("steps", "time [s]", f"mean score [{unit}]"), rows, texts=0))
