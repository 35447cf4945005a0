"""Train a policy: one file, one experiment, a dataclass of arguments. Needs the extra ``rl``.

PPO (J. Schulman et al., Proximal policy optimization algorithms, arXiv 1707.06347, 2017) and SAC
(T. Haarnoja et al., Soft actor-critic, ICML 2018) as implemented by stable-baselines3. A policy that
shall find out about the soil by itself gets memory: a recurrent network (RecurrentPPO of sb3-contrib)
or the last observations side by side (``frames``).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.protocol import EpisodeResult, Observation
from offroad_env.errors import InvalidParameter, OffroadError
from offroad_env.vector_env import make_vec

__all__ = [
    "ALGORITHMS",
    "CurvePoint",
    "MissingExtraError",
    "PolicyAgent",
    "TrainArgs",
    "TrainResult",
    "configuration_hash",
    "load_policy",
    "train",
]

ALGORITHMS = ("ppo", "recurrent_ppo", "sac")

_POLICY, _SCALING, _KIND, _REPORT = "policy.zip", "scaling.npz", "policy.json", "training.json"
_CLIP = 10.0
#: Fewest environment steps between two points of a learning curve.
_CURVE_STEPS = 64


class MissingExtraError(OffroadError, ImportError):
    """Learning needs packages that the base install leaves out."""


@dataclass(frozen=True, kw_only=True)
class TrainArgs:
    """Arguments of one training run."""

    scenario: str = "speed"  #: what to learn
    algorithm: str = "ppo"  #: ppo, recurrent_ppo (memory) or sac
    terrain_info: str = "estimate"  #: what the policy is told about the soil
    seed: int = 0  #: of network, actions and episodes
    total_steps: int = 1_000_000  #: environment steps at most
    time_budget: float | None = None  #: wall time after which training stops [s]
    out: Path = Path("out/train")  #: folder for policy, scaling and learning curve
    frames: int = 1  #: last observations that the policy sees side by side: memory without recurrence
    n_envs: int = 8  #: environments stepped together
    n_steps: int = 512  #: steps of each environment between two updates (not SAC)
    batch_size: int = 512  #: samples of one gradient step
    n_epochs: int = 5  #: passes over the samples of an update (not SAC)
    learning_rate: float = 3e-4  #: of Adam
    gamma: float = 0.99  #: discount per step; 1/(1 - gamma) steps are 2 s
    gae_lambda: float = 0.95  #: bias against variance of the advantage (not SAC)
    log_std: float = -1.0  #: first log standard deviation of the actions (not SAC)
    buffer_size: int = 300_000  #: steps that SAC remembers
    hidden: tuple[int, ...] = (64, 64)  #: layers of policy and value network
    eval_episodes: int = 3  #: episodes that the reloaded policy drives at the end


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Learning curve after one update."""

    steps: int  #: environment steps so far
    wall_time: float  #: since the start [s]
    reward: float | None  #: mean sum of rewards of the last 100 episodes
    length: float | None  #: mean length of the same [steps]


@dataclass(frozen=True, kw_only=True)
class TrainResult:
    """What a run has made."""

    policy: Path
    steps: int  #: environment steps
    wall_time: float  #: of learning, without set-up and evaluation [s]
    steps_per_second: float  #: environment steps per second while learning
    curve: tuple[CurvePoint, ...]
    evaluation: tuple[EpisodeResult, ...] = field(default=())  #: of the reloaded policy


def _learner(algorithm: str) -> Any:
    """The class of stable-baselines3 or sb3-contrib."""
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
    """

    def __init__(
        self, model: Any, scaling: dict[str, tuple[np.ndarray, np.ndarray]], *, frames: int = 1
    ) -> None:
        self._model = model
        self._scaling = scaling
        self._frames = frames
        self.reset(None)

    def reset(self, briefing: Any) -> None:
        """Forget what the policy remembers."""
        self._past = {
            key: deque([np.zeros_like(mean, np.float32)] * self._frames, maxlen=self._frames)
            for key, (mean, _) in self._scaling.items()
        }
        self._memory, self._starts = None, np.ones(1, dtype=bool)

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        for key, (mean, sd) in self._scaling.items():
            scaled = np.clip((observation[key] - mean) / sd, -_CLIP, _CLIP)
            self._past[key].append(scaled.astype(np.float32))
        seen = {key: np.concatenate(past) for key, past in self._past.items()}
        action, self._memory = self._model.predict(
            seen, state=self._memory, episode_start=self._starts, deterministic=True
        )
        self._starts = np.zeros(1, dtype=bool)
        return action


def load_policy(folder: Path) -> PolicyAgent:
    """The policy that `train` saved in ``folder``.

    Raises
    ------
    MissingExtraError
        Without stable-baselines3.
    FileNotFoundError
        If ``folder`` holds no policy.
    """
    kind = json.loads((folder / _KIND).read_text(encoding="utf-8"))
    model = _learner(kind["algorithm"]).load(folder / _POLICY, device="cpu")
    with np.load(folder / _SCALING) as table:
        keys = sorted({name.partition(".")[0] for name in table.files})
        scaling = {key: (table[f"{key}.mean"], table[f"{key}.sd"]) for key in keys}
    return PolicyAgent(model, scaling, frames=kind["frames"])


def configuration_hash(args: TrainArgs) -> str:
    """Digest of everything that decides what is learnt, but for the folder."""
    decisive = {key: value for key, value in asdict(args).items() if key != "out"}
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:16]


def _save(model: Any, scaler: Any, args: TrainArgs) -> Path:
    folder = args.out
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / _POLICY)
    kind = {
        "algorithm": args.algorithm,
        "frames": args.frames,
        "scenario": args.scenario,
        "terrain_info": args.terrain_info,
        "configuration": configuration_hash(args),
    }
    (folder / _KIND).write_text(json.dumps(kind, indent=1) + "\n", encoding="utf-8")
    table = {}
    for key, statistics in scaler.obs_rms.items():
        table[f"{key}.mean"] = statistics.mean
        table[f"{key}.sd"] = np.sqrt(statistics.var + scaler.epsilon)
    np.savez(folder / _SCALING, **table)
    return folder / _POLICY


def _watch(args: TrainArgs, progress: Callable[[int, float], None] | None) -> Any:
    """Callback that keeps the learning curve and stops when the time is over."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Watch(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.curve: list[CurvePoint] = []
            self._start = time.perf_counter()

        def wall_time(self) -> float:
            return time.perf_counter() - self._start

        def _on_training_start(self) -> None:
            self._start = time.perf_counter()

        def _on_step(self) -> bool:
            return args.time_budget is None or self.wall_time() < args.time_budget

        def _on_rollout_end(self) -> None:
            if self.curve and self.num_timesteps - self.curve[-1].steps < _CURVE_STEPS:
                return  # SAC learns after every step
            episodes = self.model.ep_info_buffer or ()
            self.curve.append(
                CurvePoint(
                    steps=self.num_timesteps,
                    wall_time=self.wall_time(),
                    reward=float(np.mean([e["r"] for e in episodes])) if episodes else None,
                    length=float(np.mean([e["l"] for e in episodes])) if episodes else None,
                )
            )
            if progress is not None:
                progress(self.num_timesteps, self.wall_time())

    return Watch()


def train(args: TrainArgs, *, progress: Callable[[int, float], None] | None = None) -> TrainResult:
    """Learn, save, reload and evaluate.

    Parameters
    ----------
    args
    progress
        Called after every batch of experience with (environment steps, wall time [s]).

    Returns
    -------
    TrainResult
        Also written to ``args.out``: the policy, the scaling of its observations, and the learning
        curve with the evaluation as JSON.

    Raises
    ------
    MissingExtraError
        Without stable-baselines3.
    """
    learner = _learner(args.algorithm)
    from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

    from agents.learning_env import LearningVecEnv

    kinds = {"scenario": args.scenario, "terrain_info": args.terrain_info}
    episodes = LearningVecEnv(make_vec(args.n_envs, autoreset_mode="SameStep", **kinds))
    episodes.seed(args.seed)
    envs = VecNormalize(VecMonitor(episodes), gamma=args.gamma, clip_obs=_CLIP)
    seen = VecFrameStack(envs, args.frames) if args.frames > 1 else envs
    policy = "MultiInputLstmPolicy" if args.algorithm == "recurrent_ppo" else "MultiInputPolicy"
    model = learner(policy, seen, seed=args.seed, device="cpu", **_settings(args))
    watch = _watch(args, progress)
    model.learn(args.total_steps, callback=watch)
    wall_time = watch.wall_time()
    policy = _save(model, envs, args)
    seen.close()
    result = TrainResult(
        policy=policy,
        steps=model.num_timesteps,
        wall_time=wall_time,
        steps_per_second=model.num_timesteps / wall_time,
        curve=tuple(watch.curve),
        evaluation=_evaluate(args, kinds),
    )
    _write_report(args, result)
    return result


def _settings(args: TrainArgs) -> dict[str, Any]:
    """Arguments of the learner."""
    network: dict[str, Any] = {"net_arch": list(args.hidden)}
    common = {
        "batch_size": args.batch_size,
        "learning_rate": args.learning_rate,
        "gamma": args.gamma,
        "policy_kwargs": network,
    }
    if args.algorithm == "sac":
        return {**common, "buffer_size": args.buffer_size, "learning_starts": 10 * args.batch_size}
    network["log_std_init"] = args.log_std
    return {**common, "n_steps": args.n_steps, "n_epochs": args.n_epochs, "gae_lambda": args.gae_lambda}


def _evaluate(args: TrainArgs, kinds: dict[str, str]) -> tuple[EpisodeResult, ...]:
    """Episodes of the policy as it was saved."""
    agent = load_policy(args.out)
    env = gym.make(ENV_ID, **kinds)
    draws = draw_episodes(args.scenario, args.eval_episodes, args.seed)
    episodes = tuple(run_episode(env, agent, draw.seed, n=draw.n) for draw in draws)
    env.close()
    return episodes


def _write_report(args: TrainArgs, result: TrainResult) -> None:
    report = {"arguments": asdict(args), "result": asdict(result)}
    text = json.dumps(report, indent=1, default=str)
    (args.out / _REPORT).write_text(text + "\n", encoding="utf-8")


def main() -> None:
    """Train with arguments from the command line."""
    import tyro

    train(tyro.cli(TrainArgs, description=__doc__))


if __name__ == "__main__":
    main()
