"""``offroad compare``: an agent of your own against the arms, on the same episodes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from agents.commands.benchmark import Form, known_forms, write_results
from agents.commands.options import Jobs, Scenarios, TerrainInfo
from agents.driving.world_options import WorldOptions, known_scenarios
from agents.reports.output import say

if TYPE_CHECKING:
    from agents.benchmark.summary import Benchmark

__all__ = ["Compare"]


def paired_lines(result: Benchmark, name: str) -> list[str]:
    """One's own agent against each other one, paired over the episodes; less is better."""
    from agents.benchmark.statistics import paired_difference

    own = result.arm(name)
    lines = [f"{name} against the others, {result.scenario} ({result.form}), {result.measure}:"]
    for arm in result.arms:
        if arm is not own:
            found = paired_difference(own.scores, arm.scores)
            sign = "worse" if found.low > 0.0 else "better" if found.high < 0.0 else "no difference shown"
            interval = f"[{found.low:+.3g}, {found.high:+.3g}]"
            lines.append(f"  {arm.name}: {found.value:+.3g} {result.unit} {interval} - {sign}")
    return lines


@dataclass(kw_only=True)
class Compare:
    """Compare an agent of your own with the arms of the benchmark, on the same episodes.

    The agent is a class with reset(briefing) and act(observation), called without arguments, in a module
    that Python finds from here. Episodes that --out already holds are driven again only if the agent's
    modules, or files that it reads while it is made, have changed since.
    """

    agent: Positional[str]  #: module:Class
    terrain_info: TerrainInfo = "none"  #: terrain information in its observation
    tasks: Scenarios = ("speed",)  #: what is driven: names, or files of your own
    against: tuple[str, ...] = ("nominal", "conservative", "aware", "oracle")  #: whom it is compared with
    forms: tuple[Form, ...] = ("matched",)  #: vehicle as modelled, or unlike it
    episodes: int = 20  #: paired episodes of each agent
    seed: int = 0  #: of the episodes
    n_jobs: Jobs = 2  #: local processes; the results do not depend on it
    out: Path = Path("out/benchmark")  #: folder for the page, the numbers and the episodes
    json: Path | None = None  #: write the numbers to this file instead of benchmark.json
    world: WorldOptions = field(default_factory=WorldOptions)  #: what is driven on and with

    def run(self) -> None:
        """Drive what is missing, compare, write and print."""
        from agents.benchmark.leaderboard import board_names, find_board, standing
        from agents.benchmark.study import BenchmarkArgs, run_study

        start = time.perf_counter()
        args = BenchmarkArgs(
            tasks=known_scenarios(self.tasks),
            agents=(self.agent, *self.against),
            forms=known_forms(self.forms),
            episodes=self.episodes,
            seed=self.seed,
            n_jobs=self.n_jobs,
            world=self.world.digest(),
        )
        results = run_study(args, self.out, terrain_info=self.terrain_info)
        command = f"offroad compare {self.agent} --terrain-info {self.terrain_info}"
        command += f" --against {' '.join(self.against)}{self.world.words()}"
        seconds = time.perf_counter() - start
        for result in results.values():
            for line in paired_lines(result, self.agent):
                say(line)
            board = find_board(result.scenario, result.form)
            if board is None:
                boards = "; ".join(board_names())
                say(f"no leaderboard of {result.scenario}, {result.form} (there are: {boards})")
            elif not args.world:
                own = result.arm(self.agent)
                say(standing(board, self.agent, float(own.scores.mean()), len(own.episodes)))
        write_results(
            results,
            args,
            self.out,
            self.json,
            command=command,
            seconds=seconds,
            terrain_info=self.terrain_info,
        )
