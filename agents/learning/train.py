"""Train a policy: one file, one experiment, a dataclass of arguments. Needs the extra ``rl``.

PPO (J. Schulman et al., Proximal policy optimization algorithms, arXiv 1707.06347, 2017) and SAC
(T. Haarnoja et al., Soft actor-critic, ICML 2018) as implemented by stable-baselines3. A policy that
shall find out about the soil by itself gets memory: a recurrent network (RecurrentPPO of sb3-contrib)
or the last observations side by side (``frames``). Noise that is drawn anew at every step averages out
before the vehicle has answered; PPO explores by functions of the state that hold for some seconds (A.
Raffin, J. Kober, F. Stulp, Smooth exploration for robotic reinforcement learning, CoRL 2021).

A run can be interrupted: it goes on from its last checkpoint as if nothing had happened.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents.benchmark.runner import draw_episodes
from agents.controllers.protocol import EpisodeResult
from agents.learning.action_interface import find_interface
from agents.learning.arguments import (
    TrainArgs,
    check_arguments,
    configuration_hash,
    decisive,
    failure_charge,
    noise_bound,
    objective,
    task_of,
    world_of,
)
from agents.learning.checkpoint import (
    CHECKPOINT,
    Environments,
    read_checkpoint,
    restore_model,
    restore_random_state,
    write_checkpoint,
)
from agents.learning.checks import drive_each, merit, scores_together
from agents.learning.continued import continue_policy, learn_values_only
from agents.learning.models import bound_noise, make_model, policy_settings, start_rolling
from agents.learning.policies import (
    CLIP,
    KIND,
    SCALING,
    WEIGHTS,
    ZIP,
    MissingExtraError,
    Network,
    PolicyAgent,
    find_learner,
    load_policy,
    packed_arrays,
    scaling_of,
    without_constants,
)
from agents.reports.output import only_writer, write_bytes
from offroad_env.environment.vector_env import OffroadBekkerVectorEnv, make_vec
from offroad_env.errors import InvalidParameter

__all__ = [
    "BOARD",
    "REPORT",
    "CurvePoint",
    "TrainArgs",
    "TrainResult",
    "configuration_hash",
    "failure_charge",
    "objective",
    "train",
]

#: Files of a run beside those of the policy.
REPORT, BOARD = "training.json", "tensorboard"
#: Fewest steps between two points of a learning curve.
_CURVE_STEPS = 64


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Learning curve after one update."""

    steps: int  #: steps of the policy so far
    wall_time: float  #: since the start [s]
    reward: float | None  #: mean sum of rewards of the last 100 episodes
    length: float | None  #: mean length of the same [steps]
    score: float | None = None  #: mean score of the tuning episodes, driven without noise; where asked for


@dataclass(frozen=True, kw_only=True)
class TrainResult:
    """What a run has made."""

    policy: Path
    configuration: str  #: hash of what decides it
    steps: int  #: of the policy
    periods: int  #: control periods of the environment that they lasted
    wall_time: float  #: of learning with its drives between, without set-up and evaluation [s]
    periods_per_second: float  #: the same in control periods: environment steps per second
    curve: tuple[CurvePoint, ...]
    evaluation: tuple[EpisodeResult, ...] = field(default=())  #: of the reloaded policy


def _shown(args: TrainArgs) -> str:
    """Terrain information of the environments that are learnt in: the truth, where an error is added."""
    return "limits" if args.emulated else args.terrain_info


def _make_envs(args: TrainArgs, held: dict[str, Any] | None) -> Environments:
    """Fresh environments, or those of a checkpoint."""
    from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

    from agents.learning.sb3_vec_env import LearningVecEnv

    if held is None:
        envs = make_vec(
            args.n_envs,
            autoreset_mode="SameStep",
            threads=args.threads,
            **{**world_of(args), "terrain_info": _shown(args)},
        )
        assert isinstance(envs, OffroadBekkerVectorEnv)
        episodes = LearningVecEnv(
            envs,
            action_interface=args.action_interface,
            objective=objective(args),
            charge=failure_charge(args, 0),
            pace=args.pace,
            edge=args.edge,
            idle=args.idle,
            centre=args.centre,
            belief_seed=args.seed if args.emulated else None,
        )
        episodes.seed(args.seed)
        monitor = VecMonitor(episodes)
        scaler = VecNormalize(monitor, gamma=args.gamma, clip_obs=CLIP, clip_reward=args.clip_reward)
    else:
        episodes = held["episodes"]
        monitor = VecMonitor(episodes)
        monitor.episode_returns, monitor.episode_lengths = held["sums"]
        scaler = held["scaler"]
        scaler.set_venv(monitor)
        scaler.returns = held["returns"]
    seen = VecFrameStack(scaler, args.frames) if args.frames > 1 else scaler
    if held is not None and isinstance(seen, VecFrameStack):
        seen.stacked_obs = held["frames"]
    return Environments(episodes, monitor, scaler, seen)


def _make_model(args: TrainArgs, envs: Environments, held: dict[str, Any] | None) -> Any:
    # The seed of a run that goes on is in its checkpoint.
    seed = args.seed if held is None else None
    model = make_model(args.algorithm, envs.seen, seed=seed, settings=_settings(args))
    if held is not None:
        restore_model(model, held, str(args.out / CHECKPOINT))
    elif args.start is not None:
        continue_policy(model, envs.scaler, args.start)
    elif args.first_drive:
        start_rolling(model, args.first_drive)
    if args.tensorboard:
        model.tensorboard_log = _board(args)
    return model


def _board(args: TrainArgs) -> str:
    """Folder for TensorBoard."""
    try:
        import tensorboard  # noqa: F401 - only whether it is there
    except ImportError as error:
        raise MissingExtraError(f"TensorBoard is missing ({error}): pip install tensorboard") from error
    return str(args.out / BOARD)


def _settings(args: TrainArgs) -> dict[str, Any]:
    """Arguments of the learner."""
    from stable_baselines3.common.utils import LinearSchedule

    common = {
        **policy_settings(args.algorithm, args.hidden, log_std=args.log_std, noise_steps=args.noise_steps),
        "batch_size": args.batch_size,
        "learning_rate": LinearSchedule(args.learning_rate, 0.0, 1.0),
        "gamma": args.gamma,
    }
    if args.algorithm == "sac":
        room = {"buffer_size": args.buffer_size, "learning_starts": 10 * args.batch_size}
        return {**common, **room, "gradient_steps": args.gradient_steps}
    return {**common, "n_steps": args.n_steps, "n_epochs": args.n_epochs, "gae_lambda": args.gae_lambda}


def _scaling(scaler: Any, args: TrainArgs) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of the observations as they are now; what an emulated belief never varies is left out."""
    found = scaling_of(scaler)
    return without_constants(found) if args.emulated else found


def _save(model: Any, scaler: Any, args: TrainArgs) -> None:
    """Write the policy so that `load_policy` finds it."""
    folder = args.out
    packed = io.BytesIO()
    model.save(packed)
    write_bytes(folder / ZIP, packed.getvalue())
    if args.algorithm == "ppo":
        Network.of(model).save(folder / WEIGHTS)
    kind = {"configuration": configuration_hash(args), **decisive(args)}
    write_bytes(folder / KIND, f"{json.dumps(kind, indent=1)}\n".encode())
    table = {}
    for key, (mean, sd) in _scaling(scaler, args).items():
        table[f"{key}.mean"], table[f"{key}.sd"] = mean, sd
    write_bytes(folder / SCALING, packed_arrays(table))


class _Watch:
    """Learning curve, drives between, checkpoints, and the end when the time is over."""

    def __init__(
        self,
        args: TrainArgs,
        envs: Environments,
        held: dict[str, Any] | None,
        progress: Callable[[int, float], None] | None,
    ) -> None:
        self._args, self._envs, self._held, self._progress = args, envs, held, progress
        self.curve: list[CurvePoint] = []
        self.best: float | tuple[float, float] | None = None
        self.last = {"checkpoint": 0, "check": 0}
        self.before = 0.0
        self._start = time.perf_counter()
        if held is not None:
            vars(self).update(held["watch"])

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps of it."""
        found = {"curve": self.curve, "best": self.best, "last": self.last}
        return {**found, "before": self.wall_time()}

    def wall_time(self) -> float:
        """Time of learning and of the drives between [s]."""
        return self.before + time.perf_counter() - self._start

    def start(self) -> None:
        """Learning begins: what came before is set-up."""
        self._start = time.perf_counter()

    def in_time(self) -> bool:
        """Whether there is time left."""
        return self._args.time_budget is None or self.wall_time() < self._args.time_budget

    def before_batch(self, model: Any) -> None:
        """Before a batch of experience: the network has learnt from all that was driven."""
        args, steps = self._args, model.num_timesteps
        if self._held is not None:
            restore_random_state(model, self._held)
            self._held = None
        self._envs.episodes.charge = failure_charge(args, steps)
        if args.held_noise < 1.0 and steps >= args.held_noise * args.total_steps:
            model.sde_sample_freq = 1
        bound_noise(model, noise_bound(args, steps))
        if args.critic_steps:
            learn_values_only(model, steps < args.critic_steps)
        checked = args.check_episodes > 0 and steps >= args.check_from
        if checked and (steps == 0 or self._due("check", steps, args.check_steps)):
            self.check(model)
        if self._due("checkpoint", steps, args.checkpoint_steps):
            watch = {"configuration": configuration_hash(args), "watch": self.state()}
            write_checkpoint(args.out, model, self._envs, watch)

    def after_batch(self, model: Any) -> None:
        """After a batch of experience: a point of the learning curve."""
        if self.curve and model.num_timesteps - self.curve[-1].steps < _CURVE_STEPS:
            return  # SAC learns after every step
        self._add(model, None)
        if self._progress is not None:
            self._progress(model.num_timesteps, self.wall_time())

    def check(self, model: Any) -> None:
        """Drive the tuning episodes; keep the policy if it is the best so far."""
        scores, success = _check(model, self._envs.scaler, self._args)
        score, most = float(scores.mean()), self._args.most_failures
        model.logger.record("check/score", score)
        model.logger.record("check/failures", 1.0 - float(success.mean()))
        self._add(model, score)
        found = score if most is None else merit(scores, success, most)
        if self.best is None or found < self.best:  # type: ignore[operator]  # of one kind in a run
            self.best = found
            _save(model, self._envs.scaler, self._args)

    def _due(self, name: str, steps: int, every: int) -> bool:
        due = every > 0 and steps - self.last[name] >= every
        if due:
            self.last[name] = steps
        return due

    def _add(self, model: Any, score: float | None) -> None:
        episodes = model.ep_info_buffer or ()
        self.curve.append(
            CurvePoint(
                steps=model.num_timesteps,
                wall_time=self.wall_time(),
                reward=float(np.mean([e["r"] for e in episodes])) if episodes else None,
                length=float(np.mean([e["l"] for e in episodes])) if episodes else None,
                score=score,
            )
        )


def _callback(watch: _Watch) -> Any:
    """The watch as stable-baselines3 calls it."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Callback(BaseCallback):
        def _on_training_start(self) -> None:
            watch.start()

        def _on_rollout_start(self) -> None:
            watch.before_batch(self.model)

        def _on_step(self) -> bool:
            return watch.in_time()

        def _on_rollout_end(self) -> None:
            watch.after_batch(self.model)

    return Callback()


def _check(model: Any, scaler: Any, args: TrainArgs) -> tuple[np.ndarray, np.ndarray]:
    """Scores (E,) and successes (E,) of tuning or validation episodes, driven without noise."""
    split = "training" if args.most_failures is None else "validation"
    world = args.world.env_options()
    draws = draw_episodes(args.scenario, args.check_episodes, 0, split=split, form=args.form, world=world)
    options = {"terrain_info": args.terrain_info, **world}
    network = Network.of(model) if args.algorithm == "ppo" else model
    agent = PolicyAgent(
        network, _scaling(scaler, args), frames=args.frames, action_interface=args.action_interface
    )
    if args.algorithm == "recurrent_ppo" or task_of(args).measure == "cross_track":
        driven = drive_each(agent, args.scenario, draws, form=args.form, **options)
        return np.array([e.score for e in driven]), np.array([e.success for e in driven])
    options |= {"threads": args.threads, "terrain_info": _shown(args)}
    return scores_together(
        agent.decide_all,
        args.scenario,
        draws,
        form=args.form,
        interface=args.action_interface,
        belief_seed=0 if args.emulated else None,
        **options,
    )


def train(args: TrainArgs, *, progress: Callable[[int, float], None] | None = None) -> TrainResult:
    """Learn, save, reload and evaluate.

    Parameters
    ----------
    args
    progress
        Called after every batch of experience with (steps, wall time [s]).

    Returns
    -------
    TrainResult
        Also written to ``args.out``: the policy, the scaling of its observations, and the learning
        curve with the evaluation as JSON.

    Raises
    ------
    MissingExtraError
        Without stable-baselines3.
    InvalidParameter
        For an emulated belief where none is to be observed, or an algorithm that cannot go on from a policy.
    DataError
        For a policy to go on from that is damaged or does not fit.
    """
    check_arguments(args)
    find_learner(args.algorithm)
    if args.algorithm != "ppo" and (args.start is not None or args.critic_steps):
        raise InvalidParameter(f'start and critic_steps need algorithm="ppo", got {args.algorithm!r}')
    if args.emulated and args.terrain_info != "belief":
        raise InvalidParameter(f'emulated needs terrain_info="belief", got {args.terrain_info!r}')
    with only_writer(args.out / CHECKPOINT):
        return _train(args, progress)


def _train(args: TrainArgs, progress: Callable[[int, float], None] | None) -> TrainResult:
    """As the only process that writes to the folder."""
    held = None
    if args.resume:
        held = read_checkpoint(args.out, configuration_hash(args), task_of(args))
    envs = _make_envs(args, held)
    model = _make_model(args, envs, held)
    watch = _Watch(args, envs, held, progress)
    left = args.total_steps - model.num_timesteps
    model.learn(left, callback=_callback(watch), reset_num_timesteps=held is None)
    if args.check_episodes > 0:
        watch.check(model)
    else:
        _save(model, envs.scaler, args)
    wall_time = watch.wall_time()
    envs.seen.close()
    result = _result(args, model.num_timesteps, wall_time, tuple(watch.curve))
    _write_report(args, result)
    return result


def _result(args: TrainArgs, steps: int, wall_time: float, curve: tuple[CurvePoint, ...]) -> TrainResult:
    periods = steps * find_interface(args.action_interface).hold
    return TrainResult(
        policy=args.out,
        configuration=configuration_hash(args),
        steps=steps,
        periods=periods,
        wall_time=wall_time,
        periods_per_second=periods / wall_time,
        curve=curve,
        evaluation=_evaluate(args),
    )


def _evaluate(args: TrainArgs) -> tuple[EpisodeResult, ...]:
    """Episodes of the policy as it was saved."""
    world = args.world.env_options()
    draws = draw_episodes(args.scenario, args.eval_episodes, args.seed, form=args.form, world=world)
    options = {"terrain_info": args.terrain_info, **world}
    return drive_each(load_policy(args.out), args.scenario, draws, form=args.form, **options)


def _write_report(args: TrainArgs, result: TrainResult) -> None:
    report = {"arguments": asdict(args), "result": asdict(result)}
    text = json.dumps(report, indent=1, default=str)
    write_bytes(args.out / REPORT, f"{text}\n".encode())


def main() -> None:
    """Train with arguments from the command line."""
    import tyro

    train(tyro.cli(TrainArgs, description=__doc__))


if __name__ == "__main__":
    main()
