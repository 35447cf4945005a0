"""The native vector environment with the interface of stable-baselines3. Needs the extra ``rl``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from agents.learning.action_interface import make_interface, mirrored
from offroad_env.environment.env import CONTROL_PERIOD
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv
from offroad_env.errors import InvalidParameter

__all__ = ["OBJECTIVES", "LearningVecEnv"]

#: What is learnt: the environment's reward, or minus the benchmark's score (`_objective`).
OBJECTIVES = ("reward", "score")


class LearningVecEnv(VecEnv):
    """A thin adapter: stable-baselines3's names for what `OffroadBekkerVectorEnv` does.

    Parameters
    ----------
    envs
        With ``autoreset_mode="SameStep"``: stable-baselines3 expects the first observation of the next
        episode with the end of the last one.
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
    The dictionaries of ``infos`` are empty but at the end of an episode, where they hold the last
    ``info``, ``terminal_observation``, ``TimeLimit.truncated`` and ``is_success``: a dictionary per
    episode and step would cost as much as the physics. For rewards and lengths of episodes wrap it in
    ``VecMonitor``.
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
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise InvalidParameter('stable-baselines3 needs make_vec(..., autoreset_mode="SameStep")')
        if objective not in OBJECTIVES:
            raise InvalidParameter(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
        self.envs = envs
        self.render_mode = envs.render_mode
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
        self._actions = np.zeros((envs.num_envs, 2), np.float32)
        self._seen: dict[str, np.ndarray] = {}
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> dict[str, np.ndarray]:
        """Start all episodes, with the seeds that ``seed()`` has set."""
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        self._seen, infos = self.envs.reset(seed=seeds)
        self._progress = infos["progress"].copy()
        self._reset_seeds()
        self._reset_options()
        return self._shown(self._seen)

    def _shown(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the learner sees of them."""
        return observations if self._interface is None else mirrored(observations)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of all episodes: a control period, or the time for which an action is held."""
        if self._interface is None:
            return self._one_period(self._actions)
        rewards = np.zeros(self.num_envs, np.float32)
        over = np.zeros(self.num_envs, np.bool_)
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for _ in range(self._interface.hold):
            _, gained, done, ends = self._one_period(self._interface.actions(self._seen, self._actions))
            rewards += np.where(over, np.float32(0.0), gained)
            for i in np.flatnonzero(done & ~over):
                listed[i] = ends[i]
            over |= done
        return self._shown(self._seen), rewards, over, listed

    def _one_period(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        self._seen, rewards, terminated, truncated, infos = self.envs.step(actions)
        done = terminated | truncated
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            listed[i] = {
                **_row(infos["final_info"], i),
                "terminal_observation": self._shown(infos["final_obs"][i]),
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(infos["final_info"]["success"][i]),
            }
        if self.objective == "score":
            rewards = self._objective(infos["progress"], done, listed)
        return self._seen, rewards.astype(np.float32), done, listed

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

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """What every environment draws."""
        return self.envs.render()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of every environment."""
        return [getattr(self.envs.envs[i], attr_name) for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of every environment."""
        for i in self._get_indices(indices):
            setattr(self.envs.envs[i], attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of every environment."""
        chosen = [self.envs.envs[i] for i in self._get_indices(indices)]
        return [getattr(env, method_name)(*args, **kwargs) for env in chosen]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """No environment is wrapped."""
        return [False for _ in self._get_indices(indices)]


def _row(infos: dict[str, Any], i: int | np.signedinteger[Any]) -> dict[str, Any]:
    """The ``info`` of one episode."""
    named = {key: value for key, value in infos.items() if not key.startswith("_")}
    return {key: _row(value, i) if isinstance(value, dict) else value[i] for key, value in named.items()}
