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
from agents.learning.policies import SCALING, WEIGHTS, Network, policy_layers, read_scaling
from offroad_env.errors import DataError

__all__ = [
    "bound_noise",
    "continue_policy",
    "learn_values_only",
    "make_model",
    "policy_settings",
    "start_rolling",
    "trained_model",
]

#: Observations that a policy's scaling counts for when it learns on: what it knows hardly moves any more.
_KNOWN = 3e7


def make_model(algorithm: str, env: Any, *, seed: int | None, settings: Mapping[str, Any]) -> Any:
    """A model that has learnt nothing yet."""
    policy = "MultiInputLstmPolicy" if algorithm == "recurrent_ppo" else "MultiInputPolicy"
    return find_learner(algorithm)(policy, env, seed=seed, device="cpu", **settings)


def start_rolling(model: Any, drive: float) -> None:
    """Let an untrained policy ask for this drive on average: one that stands learns nothing of bends."""
    import torch

    with torch.no_grad():
        model.policy.action_net.bias[1] = drive


def continue_policy(model: Any, scaler: Any, folder: Path) -> None:
    """Give an untrained PPO model the policy of a folder, and its ``VecNormalize`` that policy's scaling.

    The value network stays untrained: it is not part of a policy.

    Raises
    ------
    DataError
        If the folder holds no policy of PPO, or one with other layers or observations.
    """
    import torch

    network, scaling = Network.read(folder / WEIGHTS), read_scaling(folder / SCALING)
    parts = policy_layers(model)
    have = {key: len(mean) for key, (mean, _) in scaling.items()}
    need = {key: len(statistics.mean) for key, statistics in scaler.obs_rms.items()}
    if have != need:
        raise DataError(f"{folder}: the policy observes {have}, here {need} are observed")
    shapes = [tuple(weight.shape) for weight, _ in network.layers]
    if shapes != [tuple(part.weight.shape) for part in parts]:
        raise DataError(f"{folder}: the policy has layers of other sizes or sees other frames: {shapes}")
    with torch.no_grad():
        for part, (weight, bias) in zip(parts, network.layers, strict=True):
            part.weight.copy_(torch.as_tensor(weight))
            part.bias.copy_(torch.as_tensor(bias))
    for key, (mean, sd) in scaling.items():
        statistics = scaler.obs_rms[key]
        statistics.mean, statistics.var = mean.astype(np.float64), sd.astype(np.float64) ** 2
        statistics.count = _KNOWN


def learn_values_only(model: Any, only: bool) -> None:
    """Whether the next updates of a PPO model leave its policy as it is.

    The first values of a policy that drives well are those of an untrained network; advantages over them
    would spoil it.
    """
    for part in policy_layers(model):
        part.requires_grad_(not only)
    model.policy.log_std.requires_grad_(not only)


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
