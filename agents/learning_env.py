"""The native vector environment as stable-baselines3 wants it. Needs the extra ``rl``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from offroad_env.errors import InvalidParameter
from offroad_env.vector_env import OffroadBekkerVectorEnv

__all__ = ["LearningVecEnv"]


class LearningVecEnv(VecEnv):
    """A thin adapter: stable-baselines3's names for what `OffroadBekkerVectorEnv` does.

    Parameters
    ----------
    envs
        With ``autoreset_mode="SameStep"``: stable-baselines3 expects the first observation of the next
        episode with the end of the last one.

    Notes
    -----
    The dictionaries of ``infos`` are empty but at the end of an episode, where they hold the last
    ``info``, ``terminal_observation``, ``TimeLimit.truncated`` and ``is_success``: a dictionary per
    episode and step would cost as much as the physics. For rewards and lengths of episodes wrap it in
    ``VecMonitor``.
    """

    def __init__(self, envs: OffroadBekkerVectorEnv) -> None:
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise InvalidParameter('stable-baselines3 needs make_vec(..., autoreset_mode="SameStep")')
        self.envs = envs
        self.render_mode = envs.render_mode
        self._actions: np.ndarray | None = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> dict[str, np.ndarray]:
        """Start all episodes, with the seeds that ``seed()`` has set."""
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        observations, _ = self.envs.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One step of all episodes."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        done = terminated | truncated
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            listed[i] = {
                **_row(infos["final_info"], i),
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(infos["final_info"]["success"][i]),
            }
        return observations, rewards.astype(np.float32), done, listed

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


def _row(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """The ``info`` of one episode."""
    named = {key: value for key, value in infos.items() if not key.startswith("_")}
    return {key: _row(value, i) if isinstance(value, dict) else value[i] for key, value in named.items()}
