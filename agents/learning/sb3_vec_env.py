"""Episodes as policies learn from them: what an action means, and what is learnt. Needs the extra ``rl``."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.learning.action_interface import make_interface, mirrored
from offroad_env.environment.env import CONTROL_PERIOD
from offroad_env.environment.sb3_vec import Sb3VecEnv
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.errors import InvalidParameter

__all__ = ["OBJECTIVES", "LearningVecEnv"]

#: What is learnt: the environment's reward, or minus the benchmark's score (`_objective`).
OBJECTIVES = ("reward", "score")


class LearningVecEnv(Sb3VecEnv):
    """`Sb3VecEnv` with actions of a policy, each held for a while, and the benchmark's score to learn.

    Parameters
    ----------
    envs
        With ``autoreset_mode="SameStep"``.
    action_interface
        Name in `agents.learning.action_interface.ACTION_INTERFACES`: what the actions mean, each of which is
        held for a while. None: actions and observations are the environment's own.
    objective : {"reward", "score"}
        What is learnt.
    charge
        Cost of a failure there, as a share of the task's time limit. With the whole of it, as in the
        benchmark, failures by exploration noise dominate the learning of speed.
    pace
        Time that a metre of progress counts for where time is measured [s/m]: 0.15 is 7 m/s.

    Notes
    -----
    An episode that begins while an action is held is driven by it for the rest, at most 0.18 s, without
    reward.
    """

    def __init__(
        self,
        envs: OffroadBekkerVectorEnv,
        *,
        action_interface: str | None = None,
        objective: str = "reward",
        charge: float = 1.0,
        pace: float = 0.15,
    ) -> None:
        super().__init__(envs)
        if objective not in OBJECTIVES:
            raise InvalidParameter(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
        self.objective = objective
        self.charge = charge  #: may be changed between two steps
        self._pace = pace
        first = envs.envs[0]
        self._scenario: Scenario = first.scenario
        if objective == "score" and self._scenario.measure == "cross_track":
            raise InvalidParameter('objective must be "reward" where a distance from the path is measured')
        self._interface = (
            None if action_interface is None else make_interface(action_interface, first.briefing)
        )

    def _start(self) -> dict[str, Any]:
        infos = super()._start()
        self._progress = infos["progress"].copy()
        return infos

    def _shown(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the learner sees of them."""
        return observations if self._interface is None else mirrored(observations)

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of all episodes: a control period, or the time for which an action is held."""
        if self._interface is None:
            return (self._seen, *self._gained(self._actions))
        rewards = np.zeros(self.num_envs, np.float32)
        over = np.zeros(self.num_envs, np.bool_)
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self._interface.hold):
            gained, done, ends = self._gained(self._interface.actions(self._seen, self._actions))
            rewards += np.where(over, np.float32(0.0), gained)
            for i in np.flatnonzero(done & ~over):
                listed[i] = ends[i]
            over |= done
        return self._shown(self._seen), rewards, over, listed

    def _gained(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """What a period brings, ends, and infos."""
        rewards, done, listed, infos = self._one_period(actions)
        if self.objective == "score":
            rewards = self._objective(infos["progress"], done, listed)
        return rewards.astype(np.float32), done, listed

    def _objective(self, progress: np.ndarray, done: np.ndarray, ends: list[dict[str, Any]]) -> np.ndarray:
        """Minus the score that a period adds, shaped by progress.

        In tasks that measure time, a period costs its time, and a failure a share of the time limit; a metre
        of progress counts for ``pace`` seconds, a potential (A. Y. Ng, D. Harada, S. Russell, ICML 1999):
        without a discount the sum of an episode that arrives is minus its score but for a constant of the
        course. Where the way is measured, it is the way.
        """
        last = np.array([end["progress"] if done[i] else progress[i] for i, end in enumerate(ends)])
        advance = last - self._progress
        self._progress = progress.copy()
        timed = self._scenario.measure == "time"
        gained = self._pace * advance - CONTROL_PERIOD if timed else advance
        for i in np.flatnonzero(done):
            end = ends[i]
            regular = end["success"] or (self._scenario.stalling and end["failure"] in ("", "immobilised"))
            if regular:
                continue
            gained[i] -= self.charge * self._scenario.time_limit if timed else end["progress"]
        return np.asarray(gained)
