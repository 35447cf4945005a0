"""Agents over paired episodes: every one drives the same courses, soils and sensor noise.

Score of an episode: what the task measures, less is better. Mostly that is the simulated time to the
goal; an episode that fails costs the whole time limit, because the vehicle has not arrived when the
time is over. The mean score is thus the mean crossing time restricted to the time limit, in seconds,
and combines haste and caution without a made-up weight. `track` measures the r.m.s. distance from the
path (a failure costs the half width of the corridor), `climb` the way to the top that is left. Times
of the episodes that every arm finished, and failures by cause, stand beside it.

Forms: ``matched``, the vehicle is that of the controllers' model; ``mismatch``, mass, lag and the
soil's k_phi differ from episode to episode (`MISMATCH`), unknown to controllers and estimators; and those of
`agents.benchmark.natural`, where whole soils, vehicles and sensors differ.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from joblib import Parallel, delayed

from agents.benchmark.natural import NATURAL_FORMS
from agents.benchmark.summary import Benchmark, summarise
from agents.controllers.arms import ARMS, Arm, ArmSettings, make_arm
from agents.controllers.protocol import Agent, ArmResult, EpisodeResult
from agents.driving.unwrapped import bekker_env
from offroad_env.environment.control_period import announce_compilation
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import Scenario
from offroad_env.errors import InvalidParameter
from offroad_env.world.soils import SOILS

__all__ = [
    "ENV_ID",
    "FORMS",
    "FORM_TITLES",
    "MISMATCH",
    "OVER_N",
    "SPLITS",
    "Draw",
    "draw_episodes",
    "run_arms",
    "run_episode",
    "run_jobs",
]

ENV_ID = "offroad_env:OffroadBekker-v0"
#: Forms in which n is what differs.
OVER_N = ("matched", "mismatch")
FORMS = (*OVER_N, *NATURAL_FORMS)
#: Form -> its name in text.
FORM_TITLES = {"matched": "matched model", "mismatch": "model mismatch", **NATURAL_FORMS}
#: Streams of episodes that have none in common, by what they are for.
SPLITS = {"test": 0, "training": 1, "validation": 2}

#: Factors on the true mass (an unknown load), k_phi (the spread of one soil's plate tests)
#: and torque lag (a worn drive), drawn evenly on a logarithmic scale.
MISMATCH = {"mass": (0.9, 1.15), "k_phi": (0.7, 1.4), "lag": (0.7, 1.5)}

_CHUNK = 5  # episodes of one job: enough to pay for a process that makes an environment


class Draw(NamedTuple):
    """One episode to drive: the same for every arm."""

    seed: int  #: of ``env.reset``
    n: float | None  #: true sinkage exponent, for ``env.reset`` [-]; None: the environment decides it
    mismatch: tuple[float, float, float] | None = None  #: factors on mass, k_phi and lag, likewise

    @property
    def options(self) -> dict[str, Any]:
        """For ``env.reset``."""
        options: dict[str, Any] = {} if self.n is None else {"n": self.n}
        if self.mismatch is not None:
            options["mismatch"] = self.mismatch
        return options


def draw_episodes(
    scenario: str,
    episodes: int,
    seed: int,
    *,
    n_range: tuple[float, float] | None = None,
    training: bool = False,
    form: str = "matched",
    split: str = "test",
    world: Mapping[str, Any] | None = None,
) -> list[Draw]:
    """Episodes with n spread evenly over the prior: one in each of as many equal intervals.

    Stratifying keeps few episodes from missing the soft or the firm end of the prior.
    Training, validation and test episodes come from different streams. Matched and mismatch differ in
    nothing but the factors of the latter. In natural forms the seed decides soil, vehicle and sensors.

    Parameters
    ----------
    scenario
        Whose prior holds where ``n_range`` is not given.
    episodes, seed
    n_range
        (lowest, highest) n.
    training
        Whether the episodes are for tuning: short for ``split="training"``.
    form
        In `FORMS`.
    split : {"test", "training", "validation"}
    world
        Further arguments of ``gym.make``. Where they decide n, the episodes leave it to the environment.
    """
    if split not in SPLITS:
        raise InvalidParameter(f"split must be one of {', '.join(SPLITS)}, got {split!r}")
    if form not in FORMS:
        raise InvalidParameter(f"form must be one of {', '.join(FORMS)}, got {form!r}")
    low, high = find_scenario(scenario).n_range if n_range is None else n_range
    stream = np.random.SeedSequence(seed, spawn_key=(SPLITS["training" if training else split],))
    rng = np.random.default_rng(stream)
    place = (rng.permutation(episodes) + rng.random(episodes)) / episodes
    seeds = rng.integers(0, 2**31, episodes)
    if form not in OVER_N:
        return [Draw(int(s), None) for s in seeds]
    draws = [Draw(int(s), float(low + p * (high - low))) for s, p in zip(seeds, place, strict=True)]
    if not _draws_n(world or {}):
        draws = [draw._replace(n=None) for draw in draws]
    if form == "matched":
        return draws
    ends = np.log(np.array(list(MISMATCH.values())))
    factors = np.exp(rng.uniform(ends[:, 0], ends[:, 1], (episodes, len(ends))))
    return [
        draw._replace(mismatch=(float(row[0]), float(row[1]), float(row[2])))
        for draw, row in zip(draws, factors, strict=True)
    ]


def _draws_n(world: Mapping[str, Any]) -> bool:
    """Whether episodes have an n of the scenario's prior: a soil of one's own has its n, others are drawn."""
    soil = world.get("soil")
    known = soil is None or (isinstance(soil, str) and soil in SOILS)
    return known and not {"n", "soil", "soil.n"} & set(world.get("randomise") or ())


def run_episode(
    env: gym.Env, agent: Agent, seed: int, *, n: float | None = None, options: dict[str, Any] | None = None
) -> EpisodeResult:
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
    options
        Further options of ``env.reset``.
    """
    observation, info = env.reset(seed=seed, options={**(options or {}), **({} if n is None else {"n": n})})
    agent.reset(bekker_env(env).briefing)
    done, reward, squares, steps, thinking, driving = False, 0.0, 0.0, 0, 0.0, 0.0
    while not done:
        start = time.perf_counter()
        action = agent.act(observation)
        acted = time.perf_counter()
        observation, r, terminated, truncated, info = env.step(action)
        thinking += acted - start
        driving += time.perf_counter() - acted
        done = terminated or truncated
        reward += float(r)
        squares += info["cross_track_error"] ** 2
        steps += 1
    scenario: Scenario = bekker_env(env).scenario
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
        env_time=driving / steps,
    )


def _score(scenario: Scenario, info: Mapping[str, Any], *, failed: bool, rms: float) -> float:
    """What the task measures in an episode that ended with ``info``; less is better."""
    if scenario.measure == "cross_track":
        return scenario.corridor if failed else rms
    if scenario.measure == "shortfall":
        length = float(info["path_length"])
        return length if failed else length - max(float(info["progress"]), 0.0)
    return scenario.time_limit if failed else float(info["time"])


def _run_chunk(
    key: Any, scenario: str, arm: Arm, draws: Sequence[Draw], env_options: Mapping[str, Any]
) -> tuple[Any, float, list[EpisodeResult]]:
    env = gym.make(ENV_ID, **{"scenario": scenario, "terrain_info": arm.terrain_info, **env_options})
    try:
        limit = bekker_env(env).scenario.time_limit
        return key, limit, [run_episode(env, arm.agent, draw.seed, options=draw.options) for draw in draws]
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
    announce_compilation()
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
    """Compare the arms of `agents.controllers.arms` on the same episodes.

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
    n_range = (env_options or {}).get("n_range")
    draws = draw_episodes(scenario, episodes, seed, n_range=n_range, world=env_options)
    results = run_jobs(scenario, chosen, draws, n_jobs=n_jobs, progress=progress, env_options=env_options)
    return summarise(scenario, seed, tuple(results.values()))
