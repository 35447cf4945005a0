"""``offroad reproduce online_filters``: the online filters of the environment on the same episodes.

Units are one filter in one scenario with one seed. Stanley's law drives all of them, and its course does not
depend on the estimate.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.commands.options import Jobs
from agents.reports.output import Results, console, say, table
from agents.studies.runner import Key, run_units, stamp_of
from offroad_env.errors import InvalidParameter

if TYPE_CHECKING:
    import gymnasium as gym

__all__ = ["OnlineFilters", "OnlineLine", "lines_of", "run_unit"]

#: Name of the line -> (kind, rate [Hz]).
_CHOICES = {
    "online_parameter_ukf": ("online_parameter_ukf", 100.0),
    "online_joint_ukf": ("online_joint_ukf", 100.0),
    "online_joint_ukf at 50 Hz": ("online_joint_ukf", 50.0),
    "online_ukf_bank": ("online_ukf_bank", 100.0),
}
_SCENARIOS = ("track", "speed")
_RATE = 50  # control periods a second
_FIRST = 1.0  #: coverage counts from here on [s]
#: Steps of the peer beside an episode: the two share the load of the machine.
_PEER_STEPS = 500


@dataclass(frozen=True, kw_only=True)
class OnlineLine:
    """One estimator over the episodes of one scenario."""

    estimator: str
    scenario: str
    episodes: int
    error_median: float  #: of n at the end, relative [-]
    error_worst: float
    sd: float  #: median at the end [-]
    coverage: float  #: of the 95 % interval, over time and episodes
    valid: float  #: share of the time that the flag is up
    microseconds: float  #: processor time of a control period, median
    peer_ratio: float | None  #: rate of the environment over HalfCheetah-v5's, median; None without MuJoCo


@dataclass(kw_only=True)
class OnlineFilters(Results):
    """Error, interval, coverage and cost of the online filters of the environment.

    online_filters.jsonl keeps the result of every episode: one that is there is not repeated.
    """

    quick: bool = False  #: two episodes of 5 s each: to see that it works
    seeds: int = 10  #: episodes of each scenario
    duration: float = 15.0  #: of an episode [s]
    n_jobs: Jobs = 1  #: local processes; more disturb the timing

    def run(self) -> None:
        """Drive what is missing, then print and write."""
        if self.quick:
            self.seeds, self.duration = 2, 5.0
        if self.seeds < 1 or not 2.0 <= self.duration <= 60.0:
            raise InvalidParameter(
                f"seeds must be >= 1 and duration in [2, 60] s, got {self.seeds} and {self.duration:g}"
            )
        stamp = stamp_of("offroad_env.environment.env", "estimators.filters.online")
        units: dict[Key, str] = {
            (name, scenario, seed, float(self.duration)): stamp
            for seed in range(self.seeds)
            for scenario in _SCENARIOS
            for name in _CHOICES
        }
        path = self.out / "online_filters.jsonl"
        lines = lines_of(run_units(path, run_unit, units, label="episodes", n_jobs=self.n_jobs))
        heading = ("estimator", "scenario", "error", "worst", "sd", "coverage", "flag", "us", "x HalfCheetah")
        rows = [
            (
                line.estimator,
                line.scenario,
                f"{line.error_median:.1%}",
                f"{line.error_worst:.1%}",
                f"{line.sd:.3f}",
                f"{line.coverage:.1%}",
                f"{line.valid:.1%}",
                f"{line.microseconds:.0f}",
                "-" if line.peer_ratio is None else f"{line.peer_ratio:.2f}",
            )
            for line in lines
        ]
        title = f"n after {self.duration:g} s, {self.seeds} episodes of each scenario"
        console().print(table(title, heading, rows, texts=2))
        if lines[0].peer_ratio is None:
            say("the last column needs MuJoCo (the extra dev)")
        self.save_numbers({"duration": self.duration, "lines": lines})


def run_unit(name: str, scenario: str, seed: int, duration: float) -> dict[str, Any]:
    """One episode with one estimator, as plain numbers."""
    import gymnasium as gym

    from agents.benchmark.runner import ENV_ID
    from agents.driving.episode import find_agent
    from estimators.filters.online import OnBoard

    kind, rate = _CHOICES[name]
    choice = kind if rate == 100.0 else OnBoard(kind=kind, rate=rate)
    env = gym.make(ENV_ID, scenario=scenario, terrain_info="estimate", estimator=choice)
    agent, _ = find_agent("stanley", scenario, "estimate")
    env.reset(seed=seed)
    env.step(np.zeros(2))  # compiles, where nothing is in the cache yet
    observation, info = env.reset(seed=seed)
    agent.reset(env.get_wrapper_attr("briefing"))
    inside, valid, spent, over = [], [], [], False
    while not over and info["time"] < duration - 1e-9:
        action = agent.act(observation)
        start = time.process_time()
        observation, _, terminated, truncated, info = env.step(action)
        spent.append(time.process_time() - start)
        over = terminated or truncated
        if info["time"] > _FIRST:
            inside.append(abs(info["n_estimate"] - info["n"]) < 1.96 * info["n_estimate_sd"])
            valid.append(float(observation["terrain"][2]))
    period = float(np.mean(spent))
    peer = _peer_step()
    return {
        "error": abs(info["n_estimate"] - info["n"]) / info["n"],
        "sd": float(info["n_estimate_sd"]),
        "coverage": float(np.mean(inside)),
        "valid": float(np.mean(valid)),
        "microseconds": 1e6 * period,
        "peer_ratio": None if peer is None else peer / period,
    }


@cache
def _peer() -> gym.Env[Any, Any] | None:
    """HalfCheetah-v5, or None where MuJoCo is not installed; made once, since MuJoCo warns each time."""
    import gymnasium as gym

    try:
        peer = gym.make("HalfCheetah-v5")
    except gym.error.DependencyNotInstalled:
        return None
    return peer


def _peer_step() -> float | None:
    """Seconds of a step of HalfCheetah-v5, or None where MuJoCo is not installed."""
    peer = _peer()
    if peer is None:
        return None
    peer.reset(seed=0)
    action = np.zeros(peer.action_space.shape or ())
    start = time.process_time()
    for _ in range(_PEER_STEPS):
        peer.step(action)
    return (time.process_time() - start) / _PEER_STEPS


def lines_of(results: dict[Key, dict[str, Any]]) -> list[OnlineLine]:
    """A line for every estimator and scenario."""
    lines = []
    for name in _CHOICES:
        for scenario in _SCENARIOS:
            found = [result for key, result in results.items() if key[:2] == (name, scenario)]
            column = {field: [result[field] for result in found] for field in found[0]}
            ratios = [ratio for ratio in column["peer_ratio"] if ratio is not None]
            lines.append(
                OnlineLine(
                    estimator=name,
                    scenario=scenario,
                    episodes=len(found),
                    error_median=float(np.median(column["error"])),
                    error_worst=float(np.max(column["error"])),
                    sd=float(np.median(column["sd"])),
                    coverage=float(np.mean(column["coverage"])),
                    valid=float(np.mean(column["valid"])),
                    microseconds=float(np.median(column["microseconds"])),
                    peer_ratio=float(np.median(ratios)) if ratios else None,
                )
            )
    return lines
