"""Checkpoints of a training run: everything that it needs to go on as if it had not been interrupted.

The first line is JSON: format, configuration, length and hash of the rest. It is checked before anything else
is read; the rest is a pickle that can hold nothing but the state of such a run (`restricted_pickle`).
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.learning.parameters import load_parameters
from agents.learning.restricted_pickle import pack, unpack
from agents.reports.output import write_bytes
from offroad_env.environment.scenarios import Scenario
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.files import parse_json, read_file

__all__ = [
    "CHECKPOINT",
    "Environments",
    "read_checkpoint",
    "restore_model",
    "restore_random_state",
    "write_checkpoint",
]

CHECKPOINT = "checkpoint.bin"
_FORMAT = "offroad-checkpoint-2"
#: Longest file [bytes]: the replay buffer of SAC takes some hundred.
_LONGEST = 4_000_000_000
#: What a model counts and has seen last, besides its weights.
_COUNTERS = (
    "num_timesteps",
    "_total_timesteps",
    "_num_timesteps_at_start",
    "_episode_num",
    "_current_progress_remaining",
    "_n_updates",
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "ep_info_buffer",
    "ep_success_buffer",
)
#: What a checkpoint must hold.
_PARTS: Mapping[str, type] = {
    "model": bytes,
    "counters": dict,
    "episodes": object,
    "sums": tuple,
    "random": tuple,
    "noise": dict,
    "watch": dict,
}
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
    noise = {name: getattr(_noise(model), name, None) for name in _NOISE}
    content = {
        "model": packed.getvalue(),
        "counters": {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)},
        "memory": _numbers(getattr(model, "_last_lstm_states", None)),
        "replay": getattr(model, "replay_buffer", None),
        "episodes": envs.episodes,
        "sums": (envs.monitor.episode_returns, envs.monitor.episode_lengths),
        "scaler": envs.scaler,
        "returns": envs.scaler.returns,
        "frames": getattr(envs.seen, "stacked_obs", None),
        "random": (torch.get_rng_state().numpy(), np.random.get_state()),  # noqa: NPY002 - what the learner draws from
        "noise": {name: _numbers(value) for name, value in noise.items()},
        **beside,
    }
    rest = pack(content)
    head = {
        "format": _FORMAT,
        "configuration": beside["configuration"],
        "length": len(rest),
        "sha256": hashlib.sha256(rest).hexdigest(),
    }
    write_bytes(folder / CHECKPOINT, f"{json.dumps(head)}\n".encode() + rest)


def _numbers(value: Any) -> Any:
    """Tensors, and tuples of them, as arrays."""
    if isinstance(value, tuple):
        return tuple(map(_numbers, value))
    return value.detach().cpu().numpy() if hasattr(value, "detach") else value


def _tensors(value: Any) -> Any:
    """Arrays, and tuples of them, as tensors."""
    import torch

    if isinstance(value, tuple):
        return tuple(map(_tensors, value))
    return torch.from_numpy(value.copy()) if isinstance(value, np.ndarray) else value


def read_checkpoint(folder: Path, configuration: str, scenario: Scenario) -> dict[str, Any] | None:
    """The checkpoint to go on from; None to begin. ``scenario`` is that of the run.

    Raises
    ------
    InvalidParameter
        If it belongs to another configuration.
    DataError
        If it is damaged, or no checkpoint.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        return None
    line, _, rest = read_file(path, most=_LONGEST).partition(b"\n")
    again = f"delete it to begin anew: {path}"
    if not line.startswith(b"{") or len(line) > 1000:
        raise DataError(f"{path}: is no checkpoint of this version; {again}")
    head = parse_json(line.decode("utf-8", "replace"), str(path))
    if head.get("format") != _FORMAT:
        raise DataError(f"{path}: is a checkpoint of another version; {again}")
    if head.get("configuration") != configuration:
        raise InvalidParameter(f"{path} belongs to another configuration - another folder, or no --resume?")
    if head.get("length") != len(rest) or head.get("sha256") != hashlib.sha256(rest).hexdigest():
        raise DataError(f"{path}: is damaged ({len(rest)} bytes of {head.get('length')}); {again}")
    held = unpack(rest, str(path), scenario)
    kinds = {name: kind for name, kind in _PARTS.items() if not isinstance(held.get(name), kind)}
    if kinds:
        raise DataError(f"{path}: lacks {', '.join(kinds)}; {again}")
    return held


def restore_model(model: Any, held: dict[str, Any], file: str) -> None:
    """Weights, counters and memory of a model that was made anew from the same settings.

    Raises
    ------
    DataError
        If they are those of another model.
    """
    load_parameters(model, held["model"], file)
    for name, value in held["counters"].items():
        if name in _COUNTERS:
            setattr(model, name, value)
    if held["memory"] is not None:
        from sb3_contrib.common.recurrent.type_aliases import RNNStates

        model._last_lstm_states = RNNStates(*_tensors(held["memory"]))
    if held["replay"] is not None:
        model.replay_buffer = held["replay"]


def _noise(model: Any) -> Any:
    """Where the learner keeps the noise that holds for several steps."""
    return getattr(model.policy, "action_dist", None)


def restore_random_state(model: Any, held: dict[str, Any]) -> None:
    """Set generators and noise to a checkpoint's; after the learner has drawn its first numbers."""
    import torch

    torch.set_rng_state(torch.from_numpy(held["random"][0].copy()))
    np.random.set_state(held["random"][1])  # noqa: NPY002 - what the learner draws from
    for name, value in held["noise"].items():
        if value is not None:
            setattr(_noise(model), name, _tensors(value))
