"""Trained policies as agents: those of `offroad train`, and the ones that are shipped.

A feed-forward policy of PPO is a few thousand numbers. They are kept as such and run by NumPy, so that
whoever wants to see a shipped policy drive needs neither PyTorch nor the extra ``rl``.
"""

from __future__ import annotations

import importlib.resources
import json
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers.protocol import Observation
from agents.learning.action_interface import ActionInterface, make_interface, mirrored
from offroad_env.errors import InvalidParameter, OffroadError

__all__ = [
    "ALGORITHMS",
    "CLIP",
    "KIND",
    "LEARNED",
    "SCALING",
    "WEIGHTS",
    "ZIP",
    "MissingExtraError",
    "Network",
    "PolicyAgent",
    "find_learner",
    "learned_folder",
    "load_policy",
    "shipped_seeds",
]

ALGORITHMS = ("ppo", "recurrent_ppo", "sac")
#: Arm of a learned policy -> terrain information in its observation.
LEARNED = {
    "ppo_aware": "estimate",
    "ppo_oblivious": "none",
    "ppo_memory": "none",
    "ppo_tracker_aware": "estimate",
    "ppo_tracker_oblivious": "none",
    "ppo_direct_aware": "estimate",
}
#: Files of a policy's folder.
WEIGHTS, ZIP, SCALING, KIND = "weights.npz", "policy.zip", "scaling.npz", "policy.json"
#: Key of the action interface in files of former versions.
_FORMER_KEY = "guide"  # alias
#: Scaled observations are clipped to this size [standard deviations].
CLIP = 10.0


class MissingExtraError(OffroadError, ImportError):
    """Learning needs packages that the base install leaves out."""


def find_learner(algorithm: str) -> Any:
    """The class of stable-baselines3 or sb3-contrib.

    Raises
    ------
    InvalidParameter
        For an unknown algorithm.
    MissingExtraError
        Without these packages.
    """
    if algorithm not in ALGORITHMS:
        raise InvalidParameter(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
    try:
        import sb3_contrib
        import stable_baselines3
    except ImportError as error:
        raise MissingExtraError(
            f"learning needs stable-baselines3, sb3-contrib and torch ({error}): "
            "pip install offroad-bekker[rl]"
        ) from error
    if algorithm == "recurrent_ppo":
        return sb3_contrib.RecurrentPPO
    return stable_baselines3.SAC if algorithm == "sac" else stable_baselines3.PPO


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
        """The most likely action, as ``predict`` of stable-baselines3 gives it."""
        x = np.concatenate([observation[key] for key in sorted(observation)])
        for weight, bias in self.layers[:-1]:
            x = np.tanh(weight @ x + bias)
        weight, bias = self.layers[-1]
        return np.clip(weight @ x + bias, -1.0, 1.0), None

    @classmethod
    def of(cls, model: Any) -> Network:
        """The policy network of a PPO model of stable-baselines3."""
        linear = [part for part in model.policy.mlp_extractor.policy_net if hasattr(part, "weight")]
        return cls(
            [
                (part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy())
                for part in (*linear, model.policy.action_net)
            ]
        )

    def save(self, path: Path) -> None:
        """Write the numbers, layer after layer."""
        parts = {
            f"{name}{i}": part
            for i, layer in enumerate(self.layers)
            for name, part in zip("wb", layer, strict=True)
        }
        np.savez(path, **parts)  # type: ignore[arg-type]  # NumPy names a keyword of its own

    @classmethod
    def read(cls, path: Path) -> Network:
        """A file that `save` has written."""
        with np.load(path) as table:
            return cls([(table[f"w{i}"], table[f"b{i}"]) for i in range(len(table.files) // 2)])


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

    def _decide(self, observation: Observation) -> np.ndarray:
        observation = mirrored(observation)
        for key, (mean, sd) in self._scaling.items():
            scaled = np.clip((observation[key] - mean) / sd, -CLIP, CLIP)
            self._past[key].append(scaled.astype(np.float32))
        seen = {key: np.concatenate(past) for key, past in self._past.items()}
        action, self._memory = self._model.predict(
            seen, state=self._memory, episode_start=self._starts, deterministic=True
        )
        self._starts = np.zeros(1, dtype=bool)
        return np.asarray(action)


def load_policy(folder: Path) -> PolicyAgent:
    """The policy that `agents.learning.train.train` saved in ``folder``.

    Raises
    ------
    MissingExtraError
        For a policy with a recurrent network or of SAC, without stable-baselines3.
    FileNotFoundError
        If ``folder`` holds no policy.
    """
    kind = json.loads((folder / KIND).read_text(encoding="utf-8"))
    if kind["algorithm"] == "ppo":
        model = Network.read(folder / WEIGHTS)
    else:
        model = find_learner(kind["algorithm"]).load(folder / ZIP, device="cpu")
    with np.load(folder / SCALING) as table:
        keys = sorted({name.partition(".")[0] for name in table.files})
        scaling = {key: (table[f"{key}.mean"], table[f"{key}.sd"]) for key in keys}
    interface = kind.get("action_interface") or kind[_FORMER_KEY]
    return PolicyAgent(model, scaling, frames=kind["frames"], action_interface=interface)


def learned_folder(scenario: str, arm: str, seed: int) -> Path:
    """Where the shipped policy of a task, arm and training seed lies."""
    return Path(str(importlib.resources.files("agents"))) / "weights" / scenario / arm / str(seed)


def shipped_seeds(scenario: str, arm: str) -> tuple[int, ...]:
    """Training seeds of the policies that are shipped for a task and arm."""
    home = learned_folder(scenario, arm, 0).parent
    return tuple(sorted(int(file.parent.name) for file in home.glob(f"*/{KIND}")))
