"""Models of stable-baselines3 from settings, and from a policy's folder. Needs the extra ``rl``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from agents.learning.learners import find_learner
from agents.learning.parameters import load_parameters

__all__ = ["bound_noise", "make_model", "policy_settings", "start_rolling", "trained_model"]


def make_model(algorithm: str, env: Any, *, seed: int | None, settings: Mapping[str, Any]) -> Any:
    """A model that has learnt nothing yet."""
    policy = "MultiInputLstmPolicy" if algorithm == "recurrent_ppo" else "MultiInputPolicy"
    return find_learner(algorithm)(policy, env, seed=seed, device="cpu", **settings)


def start_rolling(model: Any, drive: float) -> None:
    """Let an untrained policy ask for this drive on average: one that stands learns nothing of bends."""
    import torch

    with torch.no_grad():
        model.policy.action_net.bias[1] = drive


def bound_noise(model: Any, log_std: float) -> None:
    """Keep the log standard deviations of a policy's noise below a bound."""
    import torch

    if math.isfinite(log_std):
        with torch.no_grad():
            model.policy.log_std.clamp_(max=log_std)


def policy_settings(
    algorithm: str, hidden: Sequence[int], *, log_std: float, noise_steps: int
) -> dict[str, Any]:
    """The settings that decide the shape of the networks."""
    network: dict[str, Any] = {"net_arch": list(hidden)}
    if algorithm == "sac":
        return {"policy_kwargs": network}
    network["log_std_init"] = log_std
    found: dict[str, Any] = {"policy_kwargs": network}
    if noise_steps > 1:
        found |= {"use_sde": True, "sde_sample_freq": noise_steps}
    return found


class _Spaces(gym.Env[Any, np.ndarray]):
    """An environment that only states its spaces."""

    def __init__(self, widths: Mapping[str, int]) -> None:
        self.observation_space: spaces.Dict = spaces.Dict(
            {key: spaces.Box(-np.inf, np.inf, (width,), np.float32) for key, width in widths.items()}
        )
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)


def trained_model(kind: Mapping[str, Any], widths: Mapping[str, int], path: Path) -> Any:
    """The model of which ``path`` holds the weights.

    Parameters
    ----------
    kind
        Settings of its training, checked.
    widths
        Key of the observation -> its length.
    path
        Zip file of stable-baselines3; nothing in it is run.

    Raises
    ------
    DataError
        If it holds no such weights.
    """
    algorithm = kind["algorithm"]
    settings = policy_settings(
        algorithm, kind["hidden"], log_std=float(kind["log_std"]), noise_steps=int(kind["noise_steps"])
    )
    # No experience is collected: the least room for it.
    room = {"buffer_size": 1} if algorithm == "sac" else {"n_steps": 2, "batch_size": 2}
    model = make_model(algorithm, _Spaces(widths), seed=None, settings={**settings, **room})
    load_parameters(model, path, str(path))
    return model
