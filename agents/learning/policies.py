"""Trained policies as agents: those of `offroad train`, and the ones that are shipped.

A feed-forward policy of PPO is a few thousand numbers. They are kept as such and run by NumPy, so that
whoever wants to see a shipped policy drive needs neither PyTorch nor the extra ``rl``.
"""

from __future__ import annotations

import importlib.resources
import io
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers.protocol import Observation
from agents.learning.action_interface import ActionInterface, find_interface, make_interface
from agents.learning.learners import ALGORITHMS, MissingExtraError, find_learner
from agents.reports.output import write_bytes
from offroad_env.errors import DataError
from offroad_env.world.files import read_arrays, read_json, require_keys
from offroad_env.world.yaml_text import shown

__all__ = [
    "ALGORITHMS",
    "CLIP",
    "DEEPEST",
    "DIRECT",
    "KIND",
    "LEARNED",
    "MOST_FRAMES",
    "SCALING",
    "WEIGHTS",
    "WIDEST",
    "ZIP",
    "MissingExtraError",
    "Network",
    "PolicyAgent",
    "find_learner",
    "learned_folder",
    "load_policy",
    "packed_arrays",
    "policy_kind",
    "policy_layers",
    "read_scaling",
    "scaled",
    "scaling_of",
    "shipped_seeds",
    "without_constants",
]

#: Arm of a learned policy -> terrain information in its observation.
LEARNED = {
    "ppo_aware": "estimate",
    "ppo_oblivious": "none",
    "ppo_memory": "none",
    "ppo_tracker_aware": "estimate",
    "ppo_tracker_oblivious": "none",
    "ppo_direct_aware": "estimate",
}
#: The same of policies that steer and drive themselves in the benchmark's natural forms.
DIRECT = {
    "direct_oblivious": "none",
    "direct_memory": "none",
    "direct_belief": "belief",
    "direct_oracle": "limits",
    "direct_oracle_refined": "limits",
}
#: Files of a policy's folder.
WEIGHTS, ZIP, SCALING, KIND = "weights.npz", "policy.zip", "scaling.npz", "policy.json"
#: Key of the action interface in files of former versions.
_FORMER_KEY = "guide"  # alias
#: The largest networks, and the longest memory, that are read.
WIDEST, DEEPEST, MOST_FRAMES = 4096, 16, 1000
#: Numbers of an action.
_ACTIONS = 2
#: What varied by less in training, as a share of its mean or of 1, taught nothing; what it is divided by.
_CONSTANT, _NO_SCALE = 2e-4, 1e30
#: Scaled observations are clipped to this size [standard deviations].
CLIP = 10.0


class Network:
    """A feed-forward policy: layers with tanh between them, the last one linear and clipped to [-1, 1].

    Parameters
    ----------
    layers
        (weight (out, in), bias (out,)) of every layer.
    """

    def __init__(self, layers: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        self.layers = tuple(layers)

    def predict(self, observation: Mapping[str, np.ndarray], **_: Any) -> tuple[np.ndarray, None]:
        """The most likely action, as ``predict`` of stable-baselines3 gives it; of one row or of many."""
        x = np.concatenate([observation[key] for key in sorted(observation)], axis=-1)
        for weight, bias in self.layers[:-1]:
            x = np.tanh((weight @ x if x.ndim == 1 else x @ weight.T) + bias)
        weight, bias = self.layers[-1]
        return np.clip((weight @ x if x.ndim == 1 else x @ weight.T) + bias, -1.0, 1.0), None

    @classmethod
    def of(cls, model: Any) -> Network:
        """The policy network of a PPO model of stable-baselines3."""
        return cls(
            [
                (part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy())
                for part in policy_layers(model)
            ]
        )

    def save(self, path: Path) -> None:
        """Write the numbers, layer after layer."""
        parts = {
            f"{name}{i}": part
            for i, layer in enumerate(self.layers)
            for name, part in zip("wb", layer, strict=True)
        }
        write_bytes(path, packed_arrays(parts))

    @classmethod
    def read(cls, path: Path) -> Network:
        """A file that `save` has written.

        Raises
        ------
        DataError
            If it is damaged, or the layers do not fit each other.
        """
        table = read_arrays(path)
        count = len(table) // 2
        try:
            layers = [(table[f"w{i}"], table[f"b{i}"]) for i in range(count)]
        except KeyError as error:
            raise DataError(f"{path}: lacks the array {error}") from None
        width = layers[0][0].shape[-1] if layers and layers[0][0].ndim == 2 else -1
        for weight, bias in layers:
            numbers = weight.dtype.kind == bias.dtype.kind == "f" and np.isfinite(weight).all()
            if not numbers or weight.shape != (*bias.shape, width) or not np.isfinite(bias).all():
                raise DataError(f"{path}: its layers are no numbers, or do not fit each other")
            width = len(bias)
        if width != _ACTIONS:
            raise DataError(f"{path}: the network has {max(width, 0)} outputs; an action has {_ACTIONS}")
        return cls(layers)


def policy_layers(model: Any) -> list[Any]:
    """The linear layers of a PPO model of stable-baselines3 that lead from its observation to its action."""
    linear = [part for part in model.policy.mlp_extractor.policy_net if hasattr(part, "weight")]
    return [*linear, model.policy.action_net]


class PolicyAgent:
    """A trained policy as an agent: scaled observation in, most likely action out.

    Parameters
    ----------
    model
        With ``predict`` of stable-baselines3.
    scaling
        Key of the observation -> (mean, standard deviation).
    frames
        Last observations that the policy sees side by side, the newest last; zeros before the first.
    action_interface
        Name in `agents.learning.action_interface.ACTION_INTERFACES`: what its actions mean.
    """

    def __init__(
        self,
        model: Any,
        scaling: Mapping[str, tuple[np.ndarray, np.ndarray]],
        *,
        frames: int = 1,
        action_interface: str,
    ) -> None:
        self._model = model
        self._scaling = scaling
        self._frames = frames
        self._name = action_interface
        self._forget()

    def reset(self, briefing: Any) -> None:
        """Forget what the policy remembers."""
        self._interface: ActionInterface = make_interface(self._name, briefing)
        self._forget()

    def _forget(self) -> None:
        self._past = {
            key: deque([np.zeros_like(mean, np.float32)] * self._frames, maxlen=self._frames)
            for key, (mean, _) in self._scaling.items()
        }
        self._rows: dict[str, np.ndarray] = {}
        self._memory, self._starts = None, np.ones(1, dtype=bool)
        self._step = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        if self._step % self._interface.hold == 0:
            self._action = self._decide(observation)
        self._step += 1
        row = {key: np.asarray(value)[None] for key, value in observation.items()}
        action: np.ndarray = self._interface.actions(row, self._action[None])[0]
        return action

    def decide_all(self, seen: Mapping[str, np.ndarray], fresh: np.ndarray) -> np.ndarray:
        """Actions (N, 2) for observations of N episodes as the action interface shows them.

        Those of the mask ``fresh`` (N,) have just begun. For networks without recurrence.
        """
        rows = scaled(seen, self._scaling)
        if self._frames > 1:
            for key, row in rows.items():
                past = self._rows.get(key)
                if past is None or len(past) != len(row):
                    past = np.zeros((len(row), self._frames * row.shape[-1]), np.float32)
                past = np.where(fresh[:, None], np.float32(0.0), past)
                self._rows[key] = np.concatenate([past[:, row.shape[-1] :], row], axis=-1)
            rows = self._rows
        actions: np.ndarray = self._model.predict(rows, deterministic=True)[0]
        return actions

    def _decide(self, observation: Observation) -> np.ndarray:
        observation = self._interface.seen(observation)
        for key, row in scaled(observation, self._scaling).items():
            self._past[key].append(row)
        seen = {key: np.concatenate(past) for key, past in self._past.items()}
        action, self._memory = self._model.predict(
            seen, state=self._memory, episode_start=self._starts, deterministic=True
        )
        self._starts = np.zeros(1, dtype=bool)
        return np.asarray(action)


def scaled(
    observation: Mapping[str, np.ndarray], scaling: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> dict[str, np.ndarray]:
    """An observation, or many, as a network takes it."""
    return {
        key: np.clip((observation[key] - mean) / sd, -CLIP, CLIP).astype(np.float32)
        for key, (mean, sd) in scaling.items()
    }


def scaling_of(scaler: Any) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Mean and standard deviation of each key of the observations, as a ``VecNormalize`` has them now."""
    return {
        key: (statistics.mean.copy(), np.sqrt(statistics.var + scaler.epsilon))
        for key, statistics in scaler.obs_rms.items()
    }


def without_constants(
    scaling: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """A scaling by which a policy sees what hardly varied in training as its mean, whatever it is.

    For policies that are driven with other observations than they learnt from. Divided by a standard
    deviation of almost nothing, 0.03 instead of a constant 0 would be clipped at ten standard deviations.
    """
    return {
        key: (mean, np.where(sd < _CONSTANT * np.maximum(np.abs(mean), 1.0), _NO_SCALE, sd))
        for key, (mean, sd) in scaling.items()
    }


def packed_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Content of an ``.npz`` file."""
    sink = io.BytesIO()
    np.savez(sink, **arrays)  # type: ignore[arg-type]  # NumPy names a keyword of its own
    return sink.getvalue()


def load_policy(folder: Path) -> PolicyAgent:
    """The policy that `agents.learning.train.train` saved in ``folder``; nothing in its files is run.

    Raises
    ------
    MissingExtraError
        For a policy with a recurrent network or of SAC, without stable-baselines3.
    DataError
        If ``folder`` holds no policy, or its files are damaged or do not fit each other.
    """
    kind = policy_kind(folder)
    scaling = read_scaling(folder / SCALING)
    widths = {key: kind["frames"] * len(mean) for key, (mean, _) in scaling.items()}
    if kind["algorithm"] == "ppo":
        model: Any = Network.read(folder / WEIGHTS)
        if model.layers[0][0].shape[1] != sum(widths.values()):
            raise DataError(f"{folder}: {WEIGHTS} and {SCALING} are of different observations")
    else:
        find_learner(kind["algorithm"])  # names what to install
        from agents.learning.models import trained_model

        model = trained_model(kind, widths, folder / ZIP)
    return PolicyAgent(model, scaling, frames=kind["frames"], action_interface=kind["action_interface"])


def policy_kind(folder: Path) -> dict[str, Any]:
    """What a policy is, by its folder: settings of its training.

    Raises
    ------
    DataError
        If it is missing, damaged or of another version.
    """
    file = str(folder / KIND)
    kind = read_json(folder / KIND)
    kind["action_interface"] = kind.get("action_interface") or kind.get(_FORMER_KEY)
    texts = dict.fromkeys(("algorithm", "terrain_info", "scenario", "action_interface"), str)
    require_keys(kind, {**texts, "frames": int, "hidden": list}, file)
    find_interface(kind["action_interface"])
    sizes = kind["hidden"]
    plain = all(isinstance(size, int) and 1 <= size <= WIDEST for size in sizes)
    if kind["algorithm"] not in ALGORITHMS or not plain or len(sizes) > DEEPEST:
        raise DataError(f"{file}: algorithm or hidden layers are none that offroad train makes")
    if not 1 <= kind["frames"] <= MOST_FRAMES:
        raise DataError(f"{file}: frames must be in [1, {MOST_FRAMES}], is {shown(kind['frames'])}")
    if kind["algorithm"] != "ppo":
        require_keys(kind, {"log_std": (int, float), "noise_steps": int}, file)
    return kind


def read_scaling(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Key of the observation -> (mean, standard deviation), each (W,).

    Raises
    ------
    DataError
        If the file holds no scaling, or a damaged one.
    """
    table = read_arrays(path)
    scaling = {}
    for key in sorted({name.partition(".")[0] for name in table}):
        mean, sd = table.get(f"{key}.mean"), table.get(f"{key}.sd")
        if mean is None or sd is None or mean.ndim != 1 or mean.shape != sd.shape:
            raise DataError(f"{path}: the scaling of {key!r} is missing or of another shape")
        numbers = mean.dtype.kind == sd.dtype.kind == "f" and np.isfinite(mean).all()
        if not numbers or not (np.isfinite(sd) & (sd > 0.0)).all():
            raise DataError(f"{path}: the scaling of {key!r} is no mean and standard deviation")
        scaling[key] = (mean, sd)
    if not scaling:
        raise DataError(f"{path}: holds no scaling")
    return scaling


def learned_folder(scenario: str, arm: str, seed: int) -> Path:
    """Where the shipped policy of a task, arm and training seed lies."""
    return Path(str(importlib.resources.files("agents"))) / "weights" / scenario / arm / str(seed)


def shipped_seeds(scenario: str, arm: str) -> tuple[int, ...]:
    """Training seeds of the policies that are shipped for a task and arm."""
    home = learned_folder(scenario, arm, 0).parent
    return tuple(sorted(int(file.parent.name) for file in home.glob(f"*/{KIND}")))
