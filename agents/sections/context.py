"""What the parts of the demo share: how much of everything runs, and the one episode that two of them show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.arms import make_arm
from agents.benchmark.runner import ENV_ID

__all__ = ["DemoSettings", "Run", "Trace", "record_trace"]

_PICTURE_EVERY = 10  # steps: the charts of a picture show the past only where pictures were made


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How much of everything runs."""

    out: Path  #: folder for the trained policy
    seed: int = 0  #: of noise, episodes and learning
    duration: float = 50.0  #: forward comparison [s]
    row: int = 4  #: row of the paper's table of results, 1 ... 8
    row_duration: float = 100.0  #: [s]
    scenario: str = "speed"  #: of the episode, the arms and learning
    episodes: int = 30  #: paired episodes an arm
    n_jobs: int = 2  #: local processes of the arms
    learning_time: float = 30.0  #: wall time of learning [s]
    test_episodes: int = 3  #: episodes that the trained policy drives

    def quick(self) -> DemoSettings:
        """The same in a fraction of the time, to see that it works."""
        return replace(self, duration=20.0, row_duration=30.0, episodes=4, learning_time=2.0, test_episodes=1)


@dataclass(frozen=True, kw_only=True)
class Trace:
    """One episode of the arm that lives on its estimate."""

    t: np.ndarray  #: (T,) [s]
    n: np.ndarray  #: (T,) true exponent under the front axle [-]
    mean: np.ndarray  #: (T,) estimate [-]
    sd: np.ndarray  #: (T,) its standard deviation [-]
    speed: np.ndarray  #: (T,) [m/s]
    last: dict[str, Any]  #: info of the last step
    frame: np.ndarray | None  #: picture half way, None without the extra ``view``


def record_trace(settings: DemoSettings, tick: Callable[[float], None]) -> Trace:
    """Drive the episode of ``settings.seed``; ``tick`` hears the share of the course that is done."""
    arm = make_arm("aware", scenario=settings.scenario)
    env = gym.make(ENV_ID, scenario=settings.scenario, terrain_info=arm.terrain_info, render_mode="rgb_array")
    observation, info = env.reset(seed=settings.seed)
    arm.agent.reset(env.unwrapped.briefing)
    infos, frame, done = [info], None, False
    half = 0.5 * info["path_length"]
    while not done:
        observation, _, terminated, truncated, info = env.step(arm.agent.act(observation))
        done = terminated or truncated
        if infos[-1]["progress"] < half and (done or len(infos) % _PICTURE_EVERY == 0):
            frame = _picture(env)
            tick(max(info["progress"], 0.0) / info["path_length"])
        infos.append(info)
    env.close()
    names = {"t": "time", "n": "n_front", "mean": "n_estimate", "sd": "n_estimate_sd", "speed": "speed"}
    series = {key: np.array([info[name] for info in infos]) for key, name in names.items()}
    return Trace(**series, last=infos[-1], frame=frame)


def _picture(env: gym.Env) -> np.ndarray | None:
    """A picture of the environment, or None where drawing is not installed."""
    try:
        return env.render()
    except gym.error.DependencyNotInstalled:
        return None


@dataclass
class Run:
    """One run of the demo: settings, where progress goes, and what is made once and shown twice."""

    settings: DemoSettings
    tick: Callable[[float], None] = field(default=lambda share: None)  #: share of the section that is done

    @cached_property
    def trace(self) -> Trace:
        """The episode, driven when it is first asked for."""
        return record_trace(self.settings, self.tick)
