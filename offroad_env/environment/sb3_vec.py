"""The native vector environment with the interface of stable-baselines3. Needs the extra ``rl``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from offroad_env.environment.arguments import require_count, require_seed
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv, make_vec
from offroad_env.errors import InvalidParameter
from offroad_env.world.yaml_text import shown

try:
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor
except ImportError as error:
    raise ImportError(
        f"stable-baselines3 is missing ({error}): pip install 'offroad-bekker[rl]', or stable-baselines3"
    ) from error

__all__ = ["Sb3VecEnv", "make_sb3_vec"]

#: When an episode begins anew: stable-baselines3 knows no other way.
_MODE = AutoresetMode.SAME_STEP


def make_sb3_vec(
    num_envs: int, *, seed: int | None = None, action_repeat: int = 1, **options: Any
) -> VecMonitor:
    """``num_envs`` episodes in one compiled call, as stable-baselines3 takes them.

    Parameters
    ----------
    num_envs
        Episodes at a time.
    seed
        Of the first reset; episode i gets ``seed + i``.
    action_repeat
        Control periods of 0.02 s for which an action is held; 5 are ten decisions a second. Rewards add up.
    options
        Arguments of `make_vec`: those of the environment, and ``version="v1"``.

    Returns
    -------
    VecMonitor
        So that stable-baselines3 logs rewards and lengths of episodes. Actions and observations are the
        environment's own; ``VecNormalize`` and ``VecFrameStack`` go around it as around any other.

    Examples
    --------
    >>> from stable_baselines3 import PPO
    >>> model = PPO("MultiInputPolicy", make_sb3_vec(8, scenario="speed"))  # doctest: +SKIP
    """
    seed = require_seed(seed)
    mode = options.pop("autoreset_mode", _MODE)
    if mode not in (_MODE, _MODE.value):
        raise InvalidParameter(f'stable-baselines3 needs autoreset_mode="SameStep", got {shown(mode)}')
    envs = make_vec(num_envs, autoreset_mode=_MODE, **options)
    assert isinstance(envs, OffroadBekkerVectorEnv)
    episodes = Sb3VecEnv(envs, action_repeat=action_repeat)
    if seed is not None:
        episodes.seed(seed)
    return VecMonitor(episodes)


class Sb3VecEnv(VecEnv):
    """A thin adapter: stable-baselines3's names for what `OffroadBekkerVectorEnv` does.

    Parameters
    ----------
    envs
        With ``autoreset_mode="SameStep"``: stable-baselines3 expects the first observation of the next
        episode with the end of the last one.
    action_repeat
        Control periods for which an action is held. An episode that begins meanwhile is driven by it for the
        rest, without reward.

    Notes
    -----
    The dictionaries of ``infos`` are empty but at the end of an episode, where they hold the last
    ``info``, ``terminal_observation``, ``TimeLimit.truncated`` and ``is_success``: a dictionary per
    episode and step would cost as much as the physics. For rewards and lengths of episodes wrap it in
    ``VecMonitor``.
    """

    def __init__(self, envs: OffroadBekkerVectorEnv, *, action_repeat: int = 1) -> None:
        self._repeat = require_count("action_repeat", action_repeat)
        if envs.autoreset_mode is not _MODE:
            raise InvalidParameter('stable-baselines3 needs make_vec(..., autoreset_mode="SameStep")')
        self.envs = envs
        self.render_mode = envs.render_mode
        self._actions = np.zeros((envs.num_envs, 2), np.float32)
        self._seen: dict[str, np.ndarray] = {}
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> dict[str, np.ndarray]:
        """Start all episodes, with the seeds and options that ``seed()`` and ``set_options()`` have set."""
        self._start()
        return self._shown(self._seen)

    def _start(self) -> dict[str, Any]:
        """Start all episodes; returns the ``infos`` of the vector environment."""
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        options = self._options if any(self._options) else None
        self._seen, infos = self.envs.reset(seed=seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        return infos

    def _shown(self, observations: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the learner sees of them."""
        return observations

    def _shown_last(self, observation: dict[str, np.ndarray], row: int) -> dict[str, np.ndarray]:
        """What the learner sees of the last observation of the episode that has ended in ``row``."""
        return self._shown(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One control period of all episodes, or as many as an action is held."""
        rewards, done, listed, _ = self._one_period(self._actions)
        for _ in range(self._repeat - 1):
            gained, ended, ends, _ = self._one_period(self._actions)
            rewards += np.where(done, 0.0, gained)
            for i in np.flatnonzero(ended & ~done):
                listed[i] = ends[i]
            done = done | ended
        return self._shown(self._seen), rewards.astype(np.float32), done, listed

    def _one_period(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, list[dict[str, Any]], dict[str, Any]]:
        """Rewards, ends, what stable-baselines3 calls infos, and the infos of the vector environment."""
        self._seen, rewards, terminated, truncated, infos = self.envs.step(actions)
        done = terminated | truncated
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            listed[i] = {
                **_row(infos["final_info"], i),
                "terminal_observation": self._shown_last(infos["final_obs"][i], int(i)),
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "is_success": bool(infos["final_info"]["success"][i]),
            }
        return rewards, done, listed, infos

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
