"""What an agent is, what it may read from an observation, and what a benchmark reports about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

__all__ = [
    "Agent",
    "ArmResult",
    "EpisodeResult",
    "Observation",
    "PathError",
    "Senses",
    "read_senses",
    "to_action",
]

Observation = Mapping[str, np.ndarray]


class Agent(Protocol):
    """Anything that drives: gets a briefing before the start, then is called once per control step."""

    def reset(self, briefing: Any) -> None:
        """Forget the last episode. ``briefing`` is ``env.unwrapped.briefing`` of the new one."""

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,) in [-1, 1]: steering (left positive) and drive (negative brakes)."""


class PathError(NamedTuple):
    """Where a vehicle is against its path."""

    cross_track: float  #: distance from the path, positive left of it [m]
    heading: float  #: yaw less the path's yaw [rad]


class Senses(NamedTuple):
    """The parts of an observation that a path tracker needs, by name."""

    cross_track: float  #: distance from the path, positive left of it [m]
    heading_error: float  #: yaw less the path's yaw [rad]
    target_speed: float  #: speed asked for, 0 = as fast as possible [m/s]
    curvature: np.ndarray  #: curvature at the preview distances of the briefing, left positive [1/m]
    speed: float  #: estimated speed [m/s]
    rim_speed: tuple[float, float]  #: rim speed r omega of front and rear wheels [m/s]
    distance: float = math.inf  #: way to the end of the path [m]

    @property
    def error(self) -> PathError:
        """Against the path."""
        return PathError(self.cross_track, self.heading_error)


def read_senses(observation: Observation) -> Senses:
    """Name the entries of ``observation["path"]`` and ``observation["motion"]``."""
    path, motion = observation["path"], observation["motion"]
    return Senses(
        cross_track=float(path[0]),
        heading_error=float(path[1]),
        target_speed=float(path[2]),
        curvature=np.asarray(path[3:-1], dtype=np.float64),
        distance=float(path[-1]),
        speed=float(motion[0]),
        rim_speed=(float(motion[1]), float(motion[2])),
    )


def to_action(steer: float, drive: float, steer_range: float) -> np.ndarray:
    """Action (2,) float32 from a steering angle [rad] and a drive command, clipped to [-1, 1]."""
    action = np.array([steer / steer_range, drive], dtype=np.float32)
    return np.clip(action, -1.0, 1.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class EpisodeResult:
    """How one episode ended."""

    seed: int  #: seed of the environment's reset
    n: float  #: true sinkage exponent of the base soil [-]
    success: bool  #: the goal was reached
    failure: str  #: why the episode failed: "", a failure of the environment, or "time_limit"
    time: float  #: simulated duration, to the goal or to the end [s]
    progress: float  #: distance covered along the path [m]
    score: float  #: measure of the task, less is better (`offroad_env.environment.scenarios.MEASURES`)
    reward: float  #: sum of rewards [-]
    cross_track_rms: float  #: root mean square of the true cross-track error [m]
    step_time: float  #: wall time of the agent per control step [s]; not repeatable
    env_time: float  #: the same of the environment and what runs on board [s]; not repeatable


@dataclass(frozen=True, kw_only=True, slots=True)
class ArmResult:
    """All episodes of one arm, in the order of the seeds that every arm shares."""

    name: str
    time_limit: float  #: longest episode [s]
    episodes: tuple[EpisodeResult, ...]

    @property
    def success(self) -> np.ndarray:
        """(E,) bool: the goal was reached."""
        return np.array([episode.success for episode in self.episodes], dtype=bool)

    @property
    def time(self) -> np.ndarray:
        """(E,) simulated duration [s]."""
        return np.array([episode.time for episode in self.episodes])

    @property
    def scores(self) -> np.ndarray:
        """(E,) measure of the task, less is better; defined in `agents.benchmark.runner`."""
        return np.array([episode.score for episode in self.episodes])

    @property
    def failures(self) -> dict[str, int]:
        """Number of failed episodes by cause."""
        counts: dict[str, int] = {}
        for episode in self.episodes:
            if not episode.success:
                counts[episode.failure] = counts.get(episode.failure, 0) + 1
        return counts
