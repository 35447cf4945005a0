"""Train a policy by PPO: one file, one experiment, a dataclass of arguments.

J. Schulman et al., Proximal policy optimization algorithms, arXiv 1707.06347, 2017, as implemented
by stable-baselines3. Needs the extra ``rl``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID, draw_episodes, run_episode
from agents.protocol import EpisodeResult, Observation
from offroad_env.errors import OffroadError
from offroad_env.vector_env import make_vec

__all__ = [
    "CurvePoint",
    "MissingExtraError",
    "PolicyAgent",
    "TrainArgs",
    "TrainResult",
    "load_policy",
    "train",
]

_POLICY, _SCALING, _REPORT = "policy.zip", "scaling.npz", "training.json"
_CLIP = 10.0


class MissingExtraError(OffroadError, ImportError):
    """Learning needs packages that the base install leaves out."""


@dataclass(frozen=True, kw_only=True)
class TrainArgs:
    """Arguments of one training run."""

    scenario: str = "speed"  #: what to learn
    terrain_info: str = "estimate"  #: what the policy is told about the soil
    seed: int = 0  #: of network, actions and episodes
    total_steps: int = 1_000_000  #: environment steps at most
    time_budget: float | None = None  #: wall time after which training stops [s]
    out: Path = Path("out/train")  #: folder for policy, scaling and learning curve
    n_envs: int = 8  #: environments stepped together
    n_steps: int = 512  #: steps of each environment between two updates
    batch_size: int = 512  #: samples of one gradient step
    n_epochs: int = 5  #: passes over the samples of an update
    learning_rate: float = 3e-4  #: of Adam
    gamma: float = 0.99  #: discount per step; 1/(1 - gamma) steps are 2 s
    gae_lambda: float = 0.95  #: bias against variance of the advantage
    log_std: float = -1.0  #: first log standard deviation of the actions
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


def _sb3() -> ModuleType:
    try:
        import stable_baselines3
    except ImportError as error:
        raise MissingExtraError(
            f"learning needs stable-baselines3 and torch ({error}): pip install offroad-bekker[rl]"
        ) from error
    return stable_baselines3


class PolicyAgent:
    """A trained policy as an agent: scaled observation in, most likely action out."""

    def __init__(self, model: Any, scaling: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
        self._model = model
        self._scaling = scaling

    def reset(self, briefing: Any) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        scaled = {
            key: np.clip((observation[key] - mean) / sd, -_CLIP, _CLIP).astype(np.float32)
            for key, (mean, sd) in self._scaling.items()
        }
        action, _ = self._model.predict(scaled, deterministic=True)
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
    model = _sb3().PPO.load(folder / _POLICY, device="cpu")
    with np.load(folder / _SCALING) as table:
        keys = sorted({name.partition(".")[0] for name in table.files})
        scaling = {key: (table[f"{key}.mean"], table[f"{key}.sd"]) for key in keys}
    return PolicyAgent(model, scaling)


def _save(model: Any, scaler: Any, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / _POLICY)
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
    sb3 = _sb3()
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from agents.learning_env import LearningVecEnv

    kinds = {"scenario": args.scenario, "terrain_info": args.terrain_info}
    episodes = LearningVecEnv(make_vec(args.n_envs, autoreset_mode="SameStep", **kinds))
    episodes.seed(args.seed)
    envs = VecNormalize(VecMonitor(episodes), gamma=args.gamma, clip_obs=_CLIP)
    model = sb3.PPO(
        "MultiInputPolicy",
        envs,
        n_steps=args.n_steps,
        batch_size=args.batch_size,
        n_epochs=args.n_epochs,
        learning_rate=args.learning_rate,
        gamma=args.gamma,
        gae_lambda=args.gae_lambda,
        policy_kwargs={"net_arch": list(args.hidden), "log_std_init": args.log_std},
        seed=args.seed,
        device="cpu",
    )
    watch = _watch(args, progress)
    model.learn(args.total_steps, callback=watch)
    wall_time = watch.wall_time()
    policy = _save(model, envs, args.out)
    envs.close()
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
