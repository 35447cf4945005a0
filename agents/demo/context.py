"""What the parts of the demo share: how much of everything runs, and an episode that two of them show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import gymnasium as gym
import numpy as np

from agents.benchmark.runner import ENV_ID
from agents.controllers.arms import make_arm
from agents.driving.episode import Drive, HalfWayPicture

__all__ = ["DemoSettings", "Driven", "Run", "drive_aware"]


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How much of everything runs."""

    out: Path  #: folder for the trained policy
    seed: int = 0  #: of noise, episodes and learning
    duration: float = 50.0  #: forward comparison [s]
    row: int = 4  #: row of the paper's table of results, 1 ... 8
    row_duration: float = 100.0  #: [s]
    scenario: str = "speed"  #: of the episode, the arms and learning
    episodes: int = 20  #: paired episodes an arm
    n_jobs: int = 2  #: local processes of the arms
    learning_time: float = 10.0  #: wall time of learning [s]
    test_episodes: int = 3  #: episodes that the trained policy drives
    log_duration: float = 40.0  #: drive in which something is hidden [s]

    def quick(self) -> DemoSettings:
        """The same in a fraction of the time, to see that it works."""
        return replace(
            self,
            duration=20.0,
            row_duration=30.0,
            episodes=4,
            learning_time=2.0,
            test_episodes=1,
            log_duration=30.0,
        )


@dataclass(frozen=True, kw_only=True)
class Driven:
    """An episode of the arm that lives on its estimate."""

    drive: Drive  #: with its log
    frame: np.ndarray | None  #: picture half way, None without the extra ``view``


def drive_aware(settings: DemoSettings, tick: Callable[[float], None]) -> Driven:
    """Drive the episode of ``settings.seed``; ``tick`` hears the share of the course that is done."""
    arm = make_arm("aware", scenario=settings.scenario)
    env = gym.make(ENV_ID, scenario=settings.scenario, terrain_info=arm.terrain_info, render_mode="rgb_array")
    drive, picture, drawable = Drive(env, arm.agent, seed=settings.seed), HalfWayPicture(), True
    for step, info in enumerate(drive):
        try:
            if drawable:
                picture.look(env, step, info)
        except gym.error.DependencyNotInstalled:  # the base install does not draw
            drawable = False
        tick(info["progress"] / info["path_length"])
    env.close()
    return Driven(drive=drive, frame=picture.frame)


@dataclass
class Run:
    """One run of the demo: settings, where progress goes, and what is made once and shown twice."""

    settings: DemoSettings
    tick: Callable[[float], None] = field(default=lambda share: None)  #: share of the section that is done

    @cached_property
    def driven(self) -> Driven:
        """The episode, driven when it is first asked for."""
        return drive_aware(self.settings, self.tick)
