"""Checkpoints of a training run: everything that it needs to go on as if it had not been interrupted."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.reports.output import write_bytes
from offroad_env.errors import InvalidParameter

__all__ = ["CHECKPOINT", "Environments", "read_checkpoint", "restore_random_state", "write_checkpoint"]

CHECKPOINT = "checkpoint.pkl"
#: Exploration noise that a checkpoint keeps.
_NOISE = ("exploration_mat", "exploration_matrices")


class Environments(NamedTuple):
    """The environments of a run, layer by layer."""

    episodes: Any  #: `LearningVecEnv`
    monitor: Any  #: ``VecMonitor`` around it
    scaler: Any  #: ``VecNormalize`` around that
    seen: Any  #: what the learner sees: that, or its last frames


def write_checkpoint(folder: Path, model: Any, envs: Environments, beside: Mapping[str, Any]) -> None:
    """Write everything that the run needs to go on as if not interrupted, and ``beside``."""
    import torch

    packed = io.BytesIO()
    model.save(packed)
    content = {
        "model": packed.getvalue(),
        "memory": getattr(model, "_last_lstm_states", None),
        "replay": getattr(model, "replay_buffer", None),
        "episodes": envs.episodes,
        "sums": (envs.monitor.episode_returns, envs.monitor.episode_lengths),
        "scaler": envs.scaler,
        "returns": envs.scaler.returns,
        "frames": getattr(envs.seen, "stacked_obs", None),
        "random": (torch.get_rng_state(), np.random.get_state()),  # noqa: NPY002 - what the learner draws from
        "noise": {name: getattr(_noise(model), name, None) for name in _NOISE},
        **beside,
    }
    write_bytes(folder / CHECKPOINT, pickle.dumps(content))


def read_checkpoint(folder: Path, configuration: str) -> dict[str, Any] | None:
    """The checkpoint to go on from; None to begin.

    Raises
    ------
    InvalidParameter
        If it belongs to another configuration.
    """
    path = folder / CHECKPOINT
    if not path.is_file():
        return None
    held: dict[str, Any] = pickle.loads(path.read_bytes())
    if held["configuration"] != configuration:
        raise InvalidParameter(f"{path} belongs to another configuration - another folder, or no --resume?")
    return held


def _noise(model: Any) -> Any:
    """Where the learner keeps the noise that holds for several steps."""
    return getattr(model.policy, "action_dist", None)


def restore_random_state(model: Any, held: dict[str, Any]) -> None:
    """Set generators and noise to a checkpoint's; after the learner has drawn its first numbers."""
    import torch

    torch.set_rng_state(held["random"][0])
    np.random.set_state(held["random"][1])  # noqa: NPY002 - what the learner draws from
    for name, value in held["noise"].items():
        if value is not None:
            setattr(_noise(model), name, value)
