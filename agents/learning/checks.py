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
from offroad_env.environment.env import CONTROL_PERIOD
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv, make_vec

__all__ = ["drive_each", "merit", "scores_together"]

#: Episodes that are stepped side by side.
_LANES = 32


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
    env = gym.make(ENV_ID, **options_of(task, form, options))
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
    belief_seed: int | None = None,
    **options: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Scores (E,) and successes (E,) of a policy, episodes stepped side by side.

    Parameters
    ----------
    predict
        Observations (N, ...) of each key, and which of the N episodes (N,) have just begun -> actions (N, 2).
    task, draws, form
    interface
        Name of the action interface.
    belief_seed
        Of the errors of an emulated belief, which the policy sees where the environments show the true
        limits; None: what they show is seen.
    options
        Further arguments of the environment.
    """
    count = len(draws)
    lanes = min(count, _LANES)
    envs = make_vec(lanes, autoreset_mode="Disabled", **options_of(task, form, options))
    assert isinstance(envs, OffroadBekkerVectorEnv)
    first = envs.envs[0]
    scenario: Scenario = first.scenario
    acting = make_interface(interface, first.briefing)
    scores, success = np.full(count, scenario.time_limit), np.zeros(count, np.bool_)
    seen, infos = envs.reset(
        seed=[draw.seed for draw in draws[:lanes]], options=_reset_options(draws[:lanes])
    )
    belief = None
    if belief_seed is not None:
        belief = EmulatedBelief(lanes, acting.hold * CONTROL_PERIOD, belief_seed)
    at, begun = np.arange(lanes), lanes  # the episode of each lane, -1 where it is over
    step, fresh = 0, np.ones(lanes, np.bool_)
    while (at >= 0).any() or begun < count:
        if step % acting.hold == 0:
            free = np.flatnonzero(at < 0)[: count - begun]
            if len(free):
                at[free] = np.arange(begun, begun + len(free))
                begun, fresh[free] = begun + len(free), True
                seen = _begin(envs, draws, at, free)
            known = {} if belief is None else {"terrain": _shown(belief, seen, fresh)}
            actions = predict(acting.seen({**seen, **known}), fresh)
            fresh = np.zeros(lanes, np.bool_)
        step += 1
        seen, _, terminated, truncated, infos = envs.step(acting.actions(seen, actions))
        over = terminated | truncated
        for i in np.flatnonzero(over & (at >= 0)):
            success[at[i]], scores[at[i]] = _result(scenario, infos, i)
        at[over] = -1
        if over.any():  # what has ended rolls on from a new start, unobserved, until the next action is due
            seen, _ = envs.reset(options={"reset_mask": over})
    envs.close()
    return scores, success


def _shown(belief: EmulatedBelief, seen: Mapping[str, np.ndarray], fresh: np.ndarray) -> np.ndarray:
    """The emulated beliefs of all lanes, ``fresh`` episodes having just begun."""
    if fresh.any():
        belief.restart(fresh)
    return belief.shown(seen)


def _begin(
    envs: OffroadBekkerVectorEnv, draws: Sequence[Draw], at: np.ndarray, free: np.ndarray
) -> dict[str, np.ndarray]:
    """Begin the episodes ``at`` in the lanes ``free``; what all lanes observe."""
    beginning = np.isin(np.arange(len(at)), free)
    given = [draws[max(i, 0)] for i in at.tolist()]
    seen, _ = envs.reset(
        seed=[draw.seed for draw in given], options={**_reset_options(given), "reset_mask": beginning}
    )
    return seen


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
