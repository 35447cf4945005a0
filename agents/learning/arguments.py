"""Arguments of a training run, and what follows from them."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.benchmark.natural import NATURAL_TASKS, is_natural, natural_scenario, options_of
from agents.benchmark.runner import FORMS
from agents.driving.world_options import WorldOptions
from agents.learning.action_interface import find_interface
from agents.learning.policies import ALGORITHMS, DEEPEST, MOST_FRAMES, SCALING, WEIGHTS, WIDEST
from offroad_env.environment.scenario_descriptions import find_scenario, scenario_mapping
from offroad_env.environment.scenarios import BUILT_IN, Scenario
from offroad_env.errors import InvalidParameter
from offroad_env.world.files import MOST_ARRAYS, read_file

__all__ = [
    "TrainArgs",
    "check_arguments",
    "configuration_hash",
    "decisive",
    "failure_charge",
    "noise_bound",
    "objective",
    "task_of",
    "world_of",
]

#: Arguments that do not decide what is learnt.
_INDIFFERENT = {"out", "resume", "checkpoint_steps", "tensorboard", "threads", "world", "start"}


#: Arguments that are younger than shipped policies, with what holds where they are not named.
_ADDED: dict[str, Any] = {
    "form": "matched",
    "edge": None,
    "idle": None,
    "clip_reward": 10.0,
    "first_drive": 0.0,
    "emulated": False,
    "most_failures": None,
    "check_from": 0,
    "held_noise": 1.0,
    "centre": 0.0,
    "last_log_std": None,
    "gradient_steps": 1,
    "critic_steps": 0,
}
#: Smallest counts, by argument.
_LEAST = {
    **dict.fromkeys(
        ("total_steps", "frames", "n_envs", "n_steps", "batch_size", "n_epochs", "check_steps"), 1
    ),
    **dict.fromkeys(("noise_steps", "buffer_size", "gradient_steps", "threads"), 1),
    **dict.fromkeys(("checkpoint_steps", "check_from", "check_episodes", "eval_episodes", "critic_steps"), 0),
}
#: Shares of more than nothing, and numbers that must be more than 0 where they are given.
_SHARES = ("gamma", "gae_lambda")
_POSITIVE = ("learning_rate", "charge", "first_charge", "clip_reward", "idle", "time_budget")
#: What leaves such a number out.
_LEFT_OUT = {
    "idle": " - without it standing costs nothing more",
    "time_budget": " - without it total_steps alone decides",
    "first_charge": " - without it the charge holds from the start",
    "threads": " - without it there is one per usable processor",
}
#: Those of `agents.learning.sb3_vec_env`, which needs the extra ``rl``.
_OBJECTIVES = ("reward", "score")
#: Range of log standard deviations, and the largest seed of NumPy's former generators, which learners use.
_LOG_STD, _LARGEST_SEED = (-20.0, 2.0), 2**32 - 1

#: With the option's former spelling.
ActionInterfaceName = Annotated[str, tyro.conf.arg(aliases=["--guide"])]  # alias


@dataclass(frozen=True, kw_only=True)
class TrainArgs:
    """Arguments of one training run. A step is an action of the policy."""

    scenario: str = "speed"  #: what to learn: a name, a file *.yaml or inline YAML
    form: str = "matched"  #: of the benchmark, whose episodes are driven: matched, natural, ...
    algorithm: str = "ppo"  #: ppo, recurrent_ppo (memory) or sac
    terrain_info: str = "estimate"  #: terrain information in the policy's observation
    seed: int = 0  #: of network, actions and episodes
    total_steps: int = 30_000  #: steps of the policy at most
    time_budget: float | None = None  #: wall time after which training stops [s]
    out: Path = Path("out/train")  #: folder for policy, scaling, checkpoint and learning curve
    resume: bool = False  #: go on from the checkpoint in that folder
    checkpoint_steps: int = 8_000  #: steps between two checkpoints; 0 = none
    tensorboard: bool = False  #: also write what TensorBoard shows to out/tensorboard
    action_interface: ActionInterfaceName = "plan"  #: an action's: plan, tracker, direct, demand, share
    objective: str | None = None  #: reward, or score: what the benchmark measures; default where it is time
    charge: float = 1.0 / 3.0  #: of a failure in the score that is learnt, as a share of the time limit
    first_charge: float | None = None  #: at the start, if less: grows by equal factors to the other
    emulated: bool = False  #: learn and check with an emulated belief; only for terrain_info belief
    edge: tuple[float, float] | None = None  #: reward's weight of the edge while none arrives, when all do
    idle: float | None = None  #: time of standing that costs as much as a failure [s]; not for brake
    centre: float = 0.0  #: further weight of the edge, which no price of a failure depends on
    pace: float = 0.15  #: time that a metre of progress counts for in the score that is learnt [s/m]
    frames: int = 1  #: last observations that the policy sees side by side: memory without recurrence
    n_envs: int = 32  #: environments stepped together
    threads: int | None = None  #: threads that step them, default one per usable processor
    n_steps: int = 32  #: steps of each environment between two updates (not SAC)
    batch_size: int = 256  #: samples of one gradient step
    n_epochs: int = 8  #: passes over the samples of an update (not SAC)
    learning_rate: float = 1.5e-3  #: of Adam at the start; falls to 0 with the last step
    gamma: float = 0.96  #: discount per step; 1/(1 - gamma) steps of 0.2 s are 5 s
    gae_lambda: float = 0.9  #: bias against variance of the advantage (not SAC)
    log_std: float = -3.2  #: first log standard deviation of the noise (not SAC)
    noise_steps: int = 25  #: above 1, noise follows the state and is drawn anew after so many (not SAC)
    held_noise: float = 1.0  #: share of the steps after which it is drawn anew at every step
    last_log_std: float | None = None  #: from then on log_std is bounded, at the end by this (PPO)
    buffer_size: int = 300_000  #: steps that SAC remembers
    gradient_steps: int = 1  #: of SAC after each step of all environments
    clip_reward: float = 10.0  #: largest reward that is learnt from [standard deviations of their sums]
    first_drive: float = 0.0  #: drive that an untrained policy asks for (not SAC)
    hidden: tuple[int, ...] = (64, 64)  #: layers of policy and value network
    start: Path | None = None  #: folder of a policy to go on from, with its scaling of observations (PPO)
    critic_steps: int = 0  #: steps at first in which only the value network learns, which no policy keeps
    check_steps: int = 7_500  #: steps between two drives of the tuning episodes; the best policy is kept
    check_from: int = 0  #: steps before the first of them; policies that arrive nowhere drive the longest
    check_episodes: int = 16  #: of such a drive; 0 = none, the last policy is kept
    most_failures: float | None = None  #: choose the fastest that fails no more, on validation soils [-]
    eval_episodes: int = 3  #: test episodes that the reloaded policy drives at the end
    world: WorldOptions = field(default_factory=WorldOptions)  #: what is driven on and with


def objective(args: TrainArgs) -> str:
    """What is learnt: "reward" or "score"."""
    timed = find_scenario(args.scenario).measure == "time"
    return args.objective or ("score" if timed else "reward")


def configuration_hash(args: TrainArgs) -> str:
    """Digest of everything that decides what is learnt."""
    return hashlib.sha256(json.dumps(decisive(args), sort_keys=True).encode()).hexdigest()[:16]


def decisive(args: TrainArgs) -> dict[str, Any]:
    names = [entry.name for entry in fields(TrainArgs) if entry.name not in _INDIFFERENT]
    found = {name: getattr(args, name) for name in names}
    for name, usual in _ADDED.items():
        if found[name] == usual:
            del found[name]
    if args.start is not None:
        found["start"] = _digest(args.start)
    if args.scenario not in BUILT_IN:
        found["course"] = scenario_mapping(find_scenario(args.scenario))
    return {**found, "world": args.world.env_options()} if args.world.digest() else found


def _digest(folder: Path) -> str:
    """Of what a policy is continued from."""
    content = b"".join(read_file(folder / name, most=MOST_ARRAYS) for name in (WEIGHTS, SCALING))
    return hashlib.sha256(content).hexdigest()[:16]


def failure_charge(args: TrainArgs, steps: int) -> float:
    """What a failure costs after so many steps, as a share of the time limit."""
    if args.first_charge is None:
        return args.charge
    return float(args.first_charge * (args.charge / args.first_charge) ** min(steps / args.total_steps, 1.0))


def noise_bound(args: TrainArgs, steps: int) -> float:
    """Upper bound of the log standard deviation of the noise after so many steps; infinite: there is none."""
    share = steps / args.total_steps
    if args.last_log_std is None or share < args.held_noise or args.held_noise >= 1.0:
        return math.inf
    gone = min((share - args.held_noise) / (1.0 - args.held_noise), 1.0)
    return args.log_std + gone * (args.last_log_std - args.log_std)


def task_of(args: TrainArgs) -> Scenario:
    """The task as its form has it."""
    return (
        natural_scenario(args.scenario, args.form) if is_natural(args.form) else find_scenario(args.scenario)
    )


def world_of(args: TrainArgs) -> dict[str, Any]:
    """Arguments of the environment that the policy is driven in."""
    chosen = {"terrain_info": args.terrain_info, **args.world.env_options()}
    return dict(options_of(args.scenario, args.form, chosen))


def check_arguments(args: TrainArgs) -> None:
    """Refuse, by name, what could not be trained with, or would be found out after training only.

    Raises
    ------
    InvalidParameter
        With what is allowed.
    """
    _check_names(args)
    _check_counts(args)
    _check_numbers(args)
    _check_prices(args)
    _check_noise(args)
    _check_learner(args)


def _check_names(args: TrainArgs) -> None:
    """First, since what else is allowed depends on them."""
    for name, known in (("algorithm", ALGORITHMS), ("objective", _OBJECTIVES), ("form", FORMS)):
        given = getattr(args, name)
        if given not in known and not (name == "objective" and given is None):
            raise InvalidParameter(f"{name} must be one of {', '.join(known)}, got {given!r}")
    find_interface(args.action_interface)
    task = find_scenario(args.scenario).task
    if is_natural(args.form) and task not in NATURAL_TASKS:
        raise InvalidParameter(
            f"natural forms have {', '.join(NATURAL_TASKS)}, got {task} - there n alone changes, which no "
            "soils side by side do"
        )


def _check_counts(args: TrainArgs) -> None:
    for name, least in _LEAST.items():
        value = getattr(args, name)
        if value is not None and value < least:
            raise InvalidParameter(f"{name} must be >= {least}, got {value}{_LEFT_OUT.get(name, '')}")
    if not 0 <= args.seed <= _LARGEST_SEED:
        hint = " - learners take 32 bits" if args.seed > _LARGEST_SEED else ""
        raise InvalidParameter(f"seed must be in [0, {_LARGEST_SEED}], got {args.seed}{hint}")
    if args.frames > MOST_FRAMES:
        raise InvalidParameter(
            f"frames must be in [1, {MOST_FRAMES}], got {args.frames} - steps, not seconds"
        )
    sizes = args.hidden
    if not sizes or len(sizes) > DEEPEST or not 1 <= min(sizes) <= max(sizes) <= WIDEST:
        raise InvalidParameter(
            f"hidden must hold 1 to {DEEPEST} sizes in [1, {WIDEST}], got {' '.join(map(str, sizes))!r} - "
            "one number for each layer"
        )


def _check_numbers(args: TrainArgs) -> None:
    for name in _SHARES:
        value = getattr(args, name)
        if not 0.0 < value <= 1.0:
            raise InvalidParameter(f"{name} must be in (0, 1], got {value:g}{_percent(value)}")
    for name in ("most_failures", "held_noise"):
        value = getattr(args, name)
        if value is not None and not 0.0 <= value <= 1.0:
            raise InvalidParameter(f"{name} must be in [0, 1], got {value:g}{_percent(value)}")
    for name in _POSITIVE:
        value = getattr(args, name)
        if value is not None and not 0.0 < value < math.inf:
            raise InvalidParameter(f"{name} must be finite and > 0, got {value:g}{_LEFT_OUT.get(name, '')}")


def _percent(value: float) -> str:
    """What may be meant by a share of more than 1."""
    return " - in percent?" if value > 1.0 else ""


def _check_prices(args: TrainArgs) -> None:
    if args.first_charge is not None and args.first_charge > args.charge:
        raise InvalidParameter(
            f"first_charge must be at most charge = {args.charge:g}, got {args.first_charge:g} - what a "
            "failure costs grows from the one to the other"
        )
    edge = args.edge or (0.0, 0.0)
    for name, value in (("centre", args.centre), ("pace", args.pace), ("edge", edge[0]), ("edge", edge[1])):
        if not 0.0 <= value < math.inf:
            hint = " - a price, which is subtracted?" if value < 0.0 else ""
            raise InvalidParameter(f"{name} must be finite and >= 0, got {value:g}{hint}")


def _check_noise(args: TrainArgs) -> None:
    low, high = _LOG_STD
    if not low <= args.log_std <= high:
        hint = "a natural logarithm: -3.2 is a standard deviation of 0.04"
        raise InvalidParameter(f"log_std must be in [{low:g}, {high:g}], got {args.log_std:g} - {hint}")
    last = args.last_log_std
    if last is not None and not low <= last <= args.log_std:
        allowed = f"last_log_std must be in [{low:g}, log_std = {args.log_std:g}]"
        hint = " - noise that shall grow?" if last > args.log_std else ""
        raise InvalidParameter(f"{allowed}, got {last:g}{hint}")
    if last is not None and args.held_noise >= 1.0:
        raise InvalidParameter(
            f"last_log_std needs held_noise < 1, got {args.held_noise:g} - it bounds the noise after that "
            "share of the steps"
        )
    if not -1.0 <= args.first_drive <= 1.0:
        raise InvalidParameter(
            f"first_drive must be in [-1, 1], got {args.first_drive:g} - a share of the largest torque"
        )


def _check_learner(args: TrainArgs) -> None:
    """What only some of the algorithms take."""
    if args.algorithm != "sac":
        _check_batches(args)
        return
    if args.frames > 1:
        raise InvalidParameter(
            f"frames must be 1 with sac, got {args.frames} - its memory holds single observations"
        )
    if args.buffer_size < args.n_envs:
        raise InvalidParameter(
            f"buffer_size must be >= n_envs = {args.n_envs}, got {args.buffer_size} - it counts steps of all "
            "environments together"
        )
    for name, usual in (("first_drive", 0.0), ("last_log_std", None)):
        if getattr(args, name) != usual:
            raise InvalidParameter(
                f'{name} needs algorithm="ppo" or "recurrent_ppo", got "sac" - which decides it by itself'
            )


def _check_batches(args: TrainArgs) -> None:
    """Of PPO, which divides advantages by their standard deviation in the batch: one sample has none."""
    samples, size = args.n_envs * args.n_steps, args.batch_size
    if size < 2:
        raise InvalidParameter(
            f"batch_size must be >= 2 with {args.algorithm}, got {size} - samples of a gradient step"
        )
    if samples < 2:
        raise InvalidParameter(
            f"n_envs x n_steps must be >= 2 with {args.algorithm}, got {args.n_envs} x {args.n_steps} - it "
            "learns from as many samples at a time"
        )
    if args.algorithm == "recurrent_ppo" and samples % size == 1:  # PPO leaves such a batch as it is
        raise InvalidParameter(
            f"batch_size must not leave one of the n_envs x n_steps = {samples} samples alone, got {size}"
        )
