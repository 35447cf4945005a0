"""How long a decision of model-predictive control takes."""

from __future__ import annotations

import time
from dataclasses import dataclass

import gymnasium as gym
import numpy as np

from agents.controllers.nmpc import NmpcAgent
from agents.controllers.nmpc_arms import make_nmpc
from agents.driving.unwrapped import bekker_env
from agents.learning.learners import MissingExtraError

__all__ = ["MOST_SOLVE_MS", "SolveTime", "measure_solves"]

#: Time that a decision may take in the median [ms]: half of the time between two decisions.
MOST_SOLVE_MS = 40.0
_TASK, _SEED, _N = "speed", 0, 0.5


@dataclass(frozen=True, kw_only=True)
class SolveTime:
    """CPU time of the control steps in which a plan is made, its state estimate included."""

    median_ms: float
    high_ms: float  #: 95 % take no longer
    decisions: int

    @property
    def met(self) -> bool:
        """Whether the promise is kept."""
        return self.median_ms <= MOST_SOLVE_MS


def measure_solves(decisions: int) -> SolveTime | None:
    """Decisions of `nmpc_truth` on the course of `speed`; None where its solver is not installed.

    Parameters
    ----------
    decisions
        How many, beside the first, which also makes the functions; fewer if the episode ends before.
    """
    arm = make_nmpc("nmpc_truth", scenario=_TASK)
    agent = arm.agent
    assert isinstance(agent, NmpcAgent)
    env = gym.make("offroad_env:OffroadBekker-v0", scenario=_TASK, terrain_info=arm.terrain_info)
    try:
        observation, _ = env.reset(seed=_SEED, options={"n": _N})
        try:
            agent.reset(bekker_env(env).briefing)
        except MissingExtraError:
            return None
        times, step, done = list[float](), 0, False
        while len(times) <= decisions and not done:
            start = time.process_time()
            action = agent.act(observation)
            if step % agent.settings.replan == 0:
                times.append(time.process_time() - start)
            observation, _, terminated, truncated, _ = env.step(action)
            done, step = terminated or truncated, step + 1
    finally:
        env.close()
    median, high = 1e3 * np.quantile(times[1:], [0.5, 0.95])
    return SolveTime(median_ms=float(median), high_ms=float(high), decisions=len(times) - 1)
