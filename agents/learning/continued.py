"""A policy that has learnt goes on learning. Needs the extra ``rl``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from agents.learning.policies import SCALING, WEIGHTS, Network, policy_layers, read_scaling
from offroad_env.errors import DataError

__all__ = ["continue_policy", "learn_values_only"]

#: Observations that a policy's scaling counts for when it learns on: what it knows hardly moves any more.
_KNOWN = 3e7


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
