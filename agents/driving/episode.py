"""Drive one episode step by step, keeping its log: for commands, figures and videos."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np

from agents.controllers.arms import (
    ARMS,
    COMMON_KNOBS,
    CONTROLLERS,
    is_tuned,
    make_arm,
)
from agents.controllers.lqr import LqrTracker
from agents.controllers.natural_arms import NATURAL_FORMS, make_natural_arm
from agents.controllers.nmpc_arms import PREDICTIVE, make_nmpc
from agents.controllers.protocol import Agent
from agents.controllers.pure_pursuit import PurePursuitAgent
from agents.controllers.stanley import StanleyAgent
from agents.driving.own_agents import make_own_agent
from agents.driving.recording import EpisodeLog
from agents.driving.unwrapped import bekker_env
from agents.learning.policies import DIRECT, LEARNED, learned_folder, load_policy, shipped_seeds
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter

__all__ = [
    "AGENTS",
    "OWN_KNOBS",
    "Drive",
    "HalfWayPicture",
    "agent_list",
    "agents_of",
    "find_agent",
    "is_agent",
    "trained_name",
]

#: Ending of an arm's name that drives with knobs of its own.
OWN_KNOBS = "_own"
#: Agents without a model of the soil, for every scenario.
_TRACKERS: dict[str, Callable[[], Agent]] = {"pure_pursuit": PurePursuitAgent, "stanley": StanleyAgent}

#: The arms' beliefs and speed plans with another steering: name -> arm.
_STEERED = {f"lqr_{arm}": arm for arm in ARMS}
#: Tasks whose own controller does nothing but steer either.
_ONLY_STEERED = {"track"}

#: Names that `find_agent` accepts. Those of trained policies end in the number of the training seed.
AGENTS = (*_TRACKERS, *ARMS, *_STEERED, *PREDICTIVE, *(f"{arm}_SEED" for arm in (*LEARNED, *DIRECT)))


def agents_of(scenario: str) -> tuple[str, ...]:
    """Agents that exist for a scenario; policies with the numbers of their training seeds."""
    task = find_scenario(scenario).task
    steered = () if task in CONTROLLERS.keys() - _ONLY_STEERED else tuple(_STEERED)
    arms = tuple(arm for arm in ARMS if is_tuned(arm, task))
    policies = tuple(f"{arm}_{seed}" for arm in LEARNED for seed in shipped_seeds(task, arm))
    return (*_TRACKERS, *arms, *steered, *PREDICTIVE, *policies)


def agent_list(scenario: str) -> str:
    """The same in words: of the seeds of a policy the first and the last."""
    words, seeds = [], dict[str, list[str]]()
    for name in agents_of(scenario):
        if (trained := trained_name(name)) is None:
            words.append(name)
        else:
            seeds.setdefault(trained[0], []).append(name)
    return ", ".join([*words, *(f"{names[0]} ... {names[-1]}" for names in seeds.values())])


def is_agent(name: str) -> bool:
    """Whether `find_agent` may find it; the module of a user's own agent is loaded only then."""
    return name in AGENTS or ":" in name or trained_name(name) is not None


def trained_name(name: str) -> tuple[str, int] | None:
    """(arm, training seed) of a trained policy's name."""
    arm, _, seed = name.rpartition("_")
    return (arm, int(seed)) if arm in LEARNED | DIRECT and seed.isdecimal() else None


def find_agent(
    name: str, scenario: str, terrain_info: str | None, *, form: str = "matched"
) -> tuple[Agent, str]:
    """An agent by name, and the ``terrain_info`` of the environment that it is to drive in.

    Parameters
    ----------
    name
        In `AGENTS`, or ``module:Class`` of an agent of your own: a class that is called without
        arguments, from the working directory or an installed package.
    scenario
        Whose tuned settings an arm takes.
    terrain_info
        None for what the agent needs, which is "none" for those that do not look at it.
    form
        Form of the benchmark; in natural ones the arms know what the soil holds instead of n, and
        ``aware_own`` drives with knobs that were searched for it alone. In the other forms all do, and
        ``aware_common`` drives with those of the oracle.

    Raises
    ------
    InvalidParameter
        For an unknown name, or a ``terrain_info`` that starves the agent.
    """
    if ":" in name:
        return make_own_agent(name), terrain_info or "none"
    task = find_scenario(scenario).task
    if name in _TRACKERS:
        return _TRACKERS[name](), terrain_info or "none"
    if form in NATURAL_FORMS:
        return _natural_agent(name, task, terrain_info)
    if name in PREDICTIVE:
        made = make_nmpc(name, scenario=task)
        return made.agent, _checked_info(name, made.terrain_info, terrain_info)
    if (trained := trained_name(name)) is not None:
        if trained[0] in DIRECT:
            raise InvalidParameter(
                f"{name} has learnt on whole soils, it drives in {', '.join(NATURAL_FORMS)}"
            )
        return _shipped(*trained, task), _checked_info(name, LEARNED[trained[0]], terrain_info)
    if name in _STEERED:
        if task in CONTROLLERS.keys() - _ONLY_STEERED:
            raise InvalidParameter(f"{name} steers only, and {scenario!r} asks for more: an arm can do it")
        arm = make_arm(_STEERED[name], scenario=scenario, tracker=LqrTracker)
        return arm.agent, _checked_info(name, arm.terrain_info, terrain_info)
    kind = name.removesuffix(COMMON_KNOBS)
    if kind not in ARMS:
        raise InvalidParameter(f"agent must be one of {agent_list(scenario)}, or module:Class, got {name!r}")
    arm = make_arm(kind, scenario=scenario, knobs="own" if kind == name else "common")
    return arm.agent, _checked_info(name, arm.terrain_info, terrain_info)


def _natural_agent(name: str, task: str, terrain_info: str | None) -> tuple[Agent, str]:
    """An agent of the benchmark's natural forms."""
    if name in PREDICTIVE:
        predictive = make_nmpc(name, scenario=task, natural=True)
        return predictive.agent, _checked_info(name, predictive.terrain_info, terrain_info)
    trained = trained_name(name)
    if trained is not None and trained[0] in DIRECT:
        return _shipped(*trained, task), _checked_info(name, DIRECT[trained[0]], terrain_info)
    arm = name.removesuffix(OWN_KNOBS)
    if arm not in ARMS:
        have = (*_TRACKERS, *ARMS, *PREDICTIVE, *(f"{policy}_SEED" for policy in DIRECT))
        raise InvalidParameter(f"natural forms have {', '.join(have)}, or module:Class, got {name!r}")
    made = make_natural_arm(arm, scenario=task, knobs="own" if name.endswith(OWN_KNOBS) else "common")
    return made.agent, _checked_info(name, made.terrain_info, terrain_info)


def _shipped(arm: str, seed: int, scenario: str) -> Agent:
    seeds = shipped_seeds(scenario, arm)
    if seed not in seeds:
        have = f"seeds {', '.join(map(str, seeds))}" if seeds else "none"
        raise InvalidParameter(f"no policy {arm}_{seed} is shipped for {scenario!r}, there: {have}")
    return load_policy(learned_folder(scenario, arm, seed))


def _checked_info(name: str, needs: str, terrain_info: str | None) -> str:
    """The ``terrain_info`` to drive with: another one would starve an agent that looks at it."""
    if terrain_info not in (None, needs) and needs != "none":
        raise InvalidParameter(
            f'terrain_info must be "{needs}" for the agent {name!r}, got {terrain_info!r} - leave it out?'
        )
    return terrain_info or needs


class Drive:
    """One episode, driven while it is iterated over: every item is ``info``, the first after reset.

    Parameters
    ----------
    env
        From ``gym.make``.
    agent
    seed
        Of the reset.
    options
        Of the reset, for example ``{"n": 0.7}``.
    """

    log: EpisodeLog  #: one row a step
    info: dict[str, Any]  #: of the last step
    reward: float  #: sum so far

    def __init__(
        self, env: gym.Env, agent: Agent, *, seed: int, options: dict[str, Any] | None = None
    ) -> None:
        self.env, self.agent, self.seed, self.options = env, agent, seed, options
        self.stopped = False  #: whether the agent, a person, has ended the drive
        self.largest = 0.0  #: size of the largest action; beyond 1 the environment cuts it off

    def __iter__(self) -> Iterator[dict[str, Any]]:
        observation, self.info = self.env.reset(seed=self.seed, options=self.options)
        self.agent.reset(bekker_env(self.env).briefing)
        self.log, self.reward, done = EpisodeLog.start(self.env, self.info), 0.0, False
        yield self.info
        while not done:
            action = self.agent.act(observation)
            observation, reward, terminated, truncated, self.info = self.env.step(action)
            self.log.add(action, self.info)
            self.largest = max(self.largest, float(np.abs(action).max()))
            self.reward += float(reward)
            self.stopped = bool(getattr(self.agent, "stopped", False))
            done = terminated or truncated or self.stopped
            yield self.info

    @property
    def ending(self) -> str:
        """How it ended, in words."""
        if self.info["success"]:
            return "reached the goal"
        failure: str = self.info["failure"]
        return (failure or ("stopped by the driver" if self.stopped else "time limit")).replace("_", " ")


class HalfWayPicture:
    """Keeps the picture of the moment when half of the course was done, or the last one before.

    The charts in a picture show the past only where pictures were made, so it looks now and then.
    """

    EVERY = 10  #: steps between two looks

    def __init__(self) -> None:
        self.frame: np.ndarray | None = None  #: (H, W, 3) uint8

    def look(self, env: gym.Env, step: int, info: dict[str, Any]) -> None:
        """Take a picture, if this step is one for it; call after every step."""
        if step % self.EVERY == 0 and (self.frame is None or info["progress"] < 0.5 * info["path_length"]):
            self.frame = np.asarray(env.render())
