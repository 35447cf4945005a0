"""Drives of a policy without noise while it learns, and after: many episodes side by side, or one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.natural import options_of
from agents.benchmark.runner import ENV_ID, Draw, run_episode
from agents.controllers.protocol import Agent, EpisodeResult
from agents.learning.action_interface import make_interface
from agents.learning.emulated_belief import EmulatedBelief
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv, make_vec

__all__ = ["drive_each", "merit", "scores_together"]


def merit(scores: np.ndarray, success: np.ndarray, most_failures: float) -> tuple[float, float]:
    """What a policy is chosen by, less is better: share of failures, ``most_failures`` at least; mean score.

    The mean alone, in which a failure counts as the time limit, chooses haste: of two policies that take 40
    and 50 s it takes the one that fails more often, up to one episode in eight.

    Parameters
    ----------
    scores, success : (E,)
        Of validation episodes.
    most_failures
        Share of failures below which the faster policy is the better one [-].
    """
    failures = float(np.mean(np.logical_not(success)))  # not 1 - mean: 2 of 100 are 0.02
    return max(failures, most_failures), float(np.mean(scores))


def drive_each(
    agent: Agent, task: str, draws: Sequence[Draw], *, form: str, **options: Any
) -> tuple[EpisodeResult, ...]:
    """One episode after the other, as the benchmark drives them; ``options`` are of ``gym.make``."""
    env = gym.make(ENV_ID, **{**options_of(task, form), **options})
    try:
        return tuple(run_episode(env, agent, draw.seed, options=draw.options) for draw in draws)
    finally:
        env.close()


def scores_together(
    predict: Any,
    task: str,
    draws: Sequence[Draw],
    *,
    form: str,
    interface: str,
    belief: EmulatedBelief | None = None,
    **options: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Scores (E,) and successes (E,) of a policy without memory, all episodes stepped together.

    Parameters
    ----------
    predict
        Observations (E, ...) of each key -> actions (E, 2).
    task, draws, form
    interface
        Name of the action interface.
    belief
        Emulates what the policy sees of the soil, where the environments show the true limits.
    options
        Further arguments of the environment.
    """
    count = len(draws)
    envs = make_vec(count, autoreset_mode="Disabled", **{**options_of(task, form), **options})
    assert isinstance(envs, OffroadBekkerVectorEnv)
    first = envs.envs[0]
    scenario: Scenario = first.scenario
    seen, infos = envs.reset(seed=[draw.seed for draw in draws], options=_reset_options(draws))
    acting = make_interface(interface, first.briefing)
    scores = np.full(count, scenario.time_limit)
    success, driving = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    step = 0
    while driving.any():
        if step % acting.hold == 0:
            known = {} if belief is None else {"terrain": belief.shown(seen)}
            actions = predict(acting.seen({**seen, **known}))
        step += 1
        seen, _, terminated, truncated, infos = envs.step(acting.actions(seen, actions))
        over = terminated | truncated
        for i in np.flatnonzero(over & driving):
            success[i], scores[i] = _result(scenario, infos, i)
        driving &= ~over
        if over.any():  # what has ended rolls on from a new start, unobserved
            seen, _ = envs.reset(options={"reset_mask": over})
    envs.close()
    return scores, success


def _reset_options(draws: Sequence[Draw]) -> dict[str, Any]:
    given = [draw.n for draw in draws]
    return {} if given[0] is None else {"n": given}


def _result(
    scenario: Scenario, infos: Mapping[str, Any], i: int | np.signedinteger[Any]
) -> tuple[bool, float]:
    """Whether the episode counts as driven to its end, and its score where time or the way is measured."""
    failure = infos["failure"][i]
    success = bool(infos["success"][i]) or (scenario.stalling and failure in ("", "immobilised"))
    if scenario.measure == "shortfall":
        length = float(infos["path_length"][i])
        return success, length - (max(float(infos["progress"][i]), 0.0) if success else 0.0)
    return success, float(infos["time"][i]) if success else scenario.time_limit
