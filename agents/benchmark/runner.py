"""Arms over paired episodes: every arm drives the same courses, soils and sensor noise.

Score of an episode: what the task measures, less is better. Mostly that is the simulated time to the
goal; an episode that fails costs the whole time limit, because the vehicle has not arrived when the
time is over. The mean score is thus the mean crossing time restricted to the time limit, in seconds,
and combines haste and caution without a made-up weight. `track` measures the r.m.s. distance from the
path (a failure costs the half width of the corridor), `climb` the way to the top that is left. Times
of the episodes that every arm finished, and failures by cause, stand beside it.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from joblib import Parallel, delayed

from agents.arms import ARMS, Arm, ArmSettings, make_arm
from agents.benchmark.statistics import (
    Interval,
    headroom,
    interquartile_mean,
    mean_interval,
    paired_difference,
    probability_of_improvement,
    wilson_interval,
)
from agents.protocol import Agent, ArmResult, EpisodeResult
from offroad_env.errors import InvalidParameter
from offroad_env.scenarios import Scenario, find_scenario

__all__ = [
    "ENV_ID",
    "ArmSummary",
    "Benchmark",
    "Draw",
    "draw_episodes",
    "run_arms",
    "run_episode",
    "run_jobs",
    "summarise",
]

ENV_ID = "offroad_env:OffroadBekker-v0"
_CHUNK = 5  # episodes of one job: enough to pay for a process that makes an environment


@dataclass(frozen=True, kw_only=True)
class ArmSummary:
    """What the episodes of one arm say."""

    name: str
    score: Interval  #: mean score, in the unit of the task
    score_iqm: float  #: interquartile mean of the same
    success: Interval  #: share of episodes that reach the goal (Wilson)
    failures: dict[str, int]  #: failed episodes by cause
    paired_time: Interval | None  #: mean time over the episodes that every arm finished [s]
    step_time: float  #: mean wall time of the agent per control step [s]; not repeatable


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Results of all arms on the same episodes, with the comparisons that the project asks for."""

    scenario: str
    seed: int
    arms: tuple[ArmResult, ...]
    summaries: tuple[ArmSummary, ...]
    finished_by_all: int  #: episodes that every arm finished
    headroom: Interval | None  #: better of the uninformed arms minus oracle, mean score
    better_uninformed: str  #: which one that is
    oracle_minus_uninformed: Interval | None  #: oracle minus that arm, mean score; below 0: knowing pays
    oracle_wins: Interval | None  #: share of episodes in which oracle scores better than that arm
    recovered: float | None  #: share of the headroom that aware recovers; None where there may be none [-]

    def arm(self, name: str) -> ArmResult:
        """Result of an arm by name."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise InvalidParameter(f"arm must be one of {', '.join(a.name for a in self.arms)}, got {name!r}")

    def to_dict(self) -> dict[str, Any]:
        """Plain dict for JSON; numbers that are not finite become None."""
        return _plain(asdict(self))

    def save(self, path: str | Path) -> Path:
        """Write the JSON file."""
        path = Path(path)
        path.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class Draw(NamedTuple):
    """One episode to drive: the same for every arm."""

    seed: int  #: of ``env.reset``
    n: float  #: true sinkage exponent, given to ``env.reset`` as an option [-]


def draw_episodes(
    scenario: str,
    episodes: int,
    seed: int,
    *,
    n_range: tuple[float, float] | None = None,
    training: bool = False,
) -> list[Draw]:
    """Episodes with n spread evenly over the prior: one in each of as many equal intervals.

    Stratifying keeps few episodes from missing the soft or the firm end of the prior by chance.
    Training and test episodes come from different streams.

    Parameters
    ----------
    scenario
        Whose prior holds where ``n_range`` is not given.
    episodes, seed
    n_range
        (lowest, highest) n.
    training
        Whether the episodes are for tuning.
    """
    low, high = find_scenario(scenario).n_range if n_range is None else n_range
    stream = np.random.SeedSequence(seed, spawn_key=(1 if training else 0,))
    rng = np.random.default_rng(stream)
    place = (rng.permutation(episodes) + rng.random(episodes)) / episodes
    seeds = rng.integers(0, 2**31, episodes)
    return [Draw(int(s), float(low + p * (high - low))) for s, p in zip(seeds, place, strict=True)]


def run_episode(env: gym.Env, agent: Agent, seed: int, *, n: float | None = None) -> EpisodeResult:
    """Drive one episode to its end.

    Parameters
    ----------
    env
        Made by ``gym.make``; its time limit ends what nothing else does.
    agent
    seed
        Of ``env.reset``.
    n
        True sinkage exponent; without it the environment draws one.
    """
    observation, info = env.reset(seed=seed, options=None if n is None else {"n": n})
    agent.reset(env.unwrapped.briefing)
    done, reward, squares, steps, thinking = False, 0.0, 0.0, 0, 0.0
    while not done:
        start = time.perf_counter()
        action = agent.act(observation)
        thinking += time.perf_counter() - start
        observation, r, terminated, truncated, info = env.step(action)
        done = terminated or truncated
        reward += float(r)
        squares += info["cross_track_error"] ** 2
        steps += 1
    scenario: Scenario = env.unwrapped.scenario
    regular = info["success"] or (scenario.stalling and info["failure"] in ("", "immobilised"))
    failure = "" if regular else (info["failure"] or "time_limit")
    rms = math.sqrt(squares / steps)
    return EpisodeResult(
        seed=seed,
        n=float(info["n"]),
        success=not failure,
        failure=failure,
        time=float(info["time"]),
        progress=float(info["progress"]),
        score=_score(scenario, info, failed=bool(failure), rms=rms),
        reward=reward,
        cross_track_rms=rms,
        step_time=thinking / steps,
    )


def _score(scenario: Scenario, info: Mapping[str, Any], *, failed: bool, rms: float) -> float:
    """What the task measures in an episode that ended with ``info``; less is better."""
    if scenario.measure == "cross_track":
        return scenario.corridor if failed else rms
    if scenario.measure == "shortfall":
        left = info["path_length"] - max(info["progress"], 0.0)
        return float(info["path_length"] if info["failure"] not in ("", "immobilised") else left)
    return scenario.time_limit if failed else float(info["time"])


def _run_chunk(
    key: Any, scenario: str, arm: Arm, draws: Sequence[Draw], env_options: Mapping[str, Any]
) -> tuple[Any, float, list[EpisodeResult]]:
    env = gym.make(ENV_ID, scenario=scenario, terrain_info=arm.terrain_info, **env_options)
    try:
        limit = env.unwrapped.scenario.time_limit
        return key, limit, [run_episode(env, arm.agent, draw.seed, n=draw.n) for draw in draws]
    finally:
        env.close()


def run_jobs(
    scenario: str,
    jobs: Mapping[Any, Arm],
    draws: Sequence[Draw],
    *,
    n_jobs: int = 2,
    progress: Callable[[int, int], None] | None = None,
    env_options: Mapping[str, Any] | None = None,
) -> dict[Any, ArmResult]:
    """Every arm of ``jobs`` (key -> arm) over the same episodes, in local processes.

    Parameters
    ----------
    scenario
    jobs
        Keys name the results; two jobs may hold the same arm with different settings.
    draws
        The episodes, shared by all.
    n_jobs
        Processes; 1 runs in this one. The results do not depend on it.
    progress
        Called with (episodes done, episodes in all) after every chunk.
    env_options
        Further arguments of ``gym.make``.
    """
    chunks = [draws[i : i + _CHUNK] for i in range(0, len(draws), _CHUNK)]
    tasks: Iterable[Any] = [
        delayed(_run_chunk)((key, i), scenario, arm, chunk, dict(env_options or {}))
        for i, chunk in enumerate(chunks)
        for key, arm in jobs.items()
    ]
    done, total = 0, len(draws) * len(jobs)
    parts: dict[Any, tuple[float, list[EpisodeResult]]] = {}
    for part, limit, episodes in Parallel(n_jobs=n_jobs, return_as="generator_unordered")(tasks):
        parts[part] = (limit, episodes)
        done += len(episodes)
        if progress is not None:
            progress(done, total)
    return {
        key: ArmResult(
            name=arm.name,
            time_limit=parts[key, 0][0],
            episodes=tuple(e for i in range(len(chunks)) for e in parts[key, i][1]),
        )
        for key, arm in jobs.items()
    }


def run_arms(
    scenario: str = "speed",
    episodes: int = 30,
    *,
    seed: int = 0,
    n_jobs: int = 2,
    progress: Callable[[int, int], None] | None = None,
    arms: Sequence[str] = tuple(ARMS),
    settings: Mapping[str, ArmSettings] | None = None,
    env_options: Mapping[str, Any] | None = None,
) -> Benchmark:
    """Compare the arms of `agents.arms` on the same episodes.

    Parameters
    ----------
    scenario
        Name of the scenario.
    episodes
        Episodes of each arm, at least 2; use 30 or more for a statement.
    seed
        Of the episodes; never those of the tuning, which come from another stream.
    n_jobs
        Local processes.
    progress
        Called with (episodes done, episodes in all).
    arms
        Names in `ARMS`.
    settings
        Knobs of an arm instead of the tuned ones, by name.
    env_options
        Further arguments of ``gym.make``, for example ``{"n_range": (0.3, 0.6)}``.
    """
    if episodes < 2:
        raise InvalidParameter(f"episodes must be at least 2, got {episodes} - one episode has no interval")
    chosen = {name: make_arm(name, scenario=scenario, settings=(settings or {}).get(name)) for name in arms}
    draws = draw_episodes(scenario, episodes, seed, n_range=(env_options or {}).get("n_range"))
    results = run_jobs(scenario, chosen, draws, n_jobs=n_jobs, progress=progress, env_options=env_options)
    return summarise(scenario, seed, tuple(results.values()))


def summarise(scenario: str, seed: int, arms: tuple[ArmResult, ...]) -> Benchmark:
    """The comparisons of a set of arms that drove the same episodes."""
    finished = np.logical_and.reduce([arm.success for arm in arms])
    by_name = {arm.name: arm for arm in arms}
    blind = [arm for arm in arms if not ARMS[arm.name][1]]
    better = min(blind, key=lambda arm: float(arm.scores.mean())) if blind else None
    oracle = by_name.get("oracle")
    room = minus = wins = recovered = None
    if oracle is not None and better is not None:
        room = headroom(oracle.scores, tuple(arm.scores for arm in blind))
        minus = paired_difference(oracle.scores, better.scores)
        wins = probability_of_improvement(oracle.scores, better.scores)
        if "aware" in by_name and room.low > 0.0:
            gained = float(better.scores.mean() - by_name["aware"].scores.mean())
            recovered = gained / room.value
    return Benchmark(
        scenario=scenario,
        seed=seed,
        arms=arms,
        summaries=tuple(_summary(arm, finished) for arm in arms),
        finished_by_all=int(finished.sum()),
        headroom=room,
        better_uninformed=better.name if better is not None else "",
        oracle_minus_uninformed=minus,
        oracle_wins=wins,
        recovered=recovered,
    )


def _summary(arm: ArmResult, finished: np.ndarray) -> ArmSummary:
    scores = arm.scores
    return ArmSummary(
        name=arm.name,
        score=mean_interval(scores),
        score_iqm=interquartile_mean(scores),
        success=wilson_interval(int(arm.success.sum()), len(arm.episodes)),
        failures=arm.failures,
        paired_time=mean_interval(arm.time[finished]) if finished.sum() >= 2 else None,
        step_time=float(np.mean([episode.step_time for episode in arm.episodes])),
    )
