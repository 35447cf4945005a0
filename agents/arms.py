"""The arms of the benchmark: one controller, four sources of knowledge about the soil.

All arms are the same `SoilTracker`; they differ only in where the believed n comes from:

oracle        the true n (``terrain_info="truth"``)
aware         mean and standard deviation of the embedded filter (``terrain_info="estimate"``)
nominal       one fixed n, the one that scores best over the prior on training seeds
conservative  the n of the prior that is worst for the task

Each arm's knobs are tuned with the same budget (`agents.tune`); the outcome is `agents.tuned`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.capability import Capability
from agents.protocol import Agent, Observation
from agents.speed_planner import Belief, PlannerGains, SoilTracker
from agents.tuned import SETTINGS
from offroad_env.errors import InvalidParameter

__all__ = [
    "ARMS",
    "Arm",
    "ArmSettings",
    "believe_estimate",
    "believe_fixed",
    "believe_truth",
    "believe_worst",
    "make_arm",
]


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """The tuned knobs. An arm ignores those that do not concern it."""

    margin: float  #: share of the believed lateral limit that is used [-]
    slip_angle: float  #: largest slip angle that the plan allows [rad]
    feed_forward: float  #: share of the believed slip angles that the steering anticipates [-]
    n: float = 0.5  #: nominal: believed place in the prior, 0 = lowest n, 1 = highest [-]
    z: float = 1.0  #: aware: how many standard deviations the insured interval reaches [-]


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A named agent and the environment mode that it needs."""

    name: str
    terrain_info: str  #: "none", "estimate" or "truth"
    informed: bool  #: whether it learns anything about the soil of the episode
    agent: Agent


def believe_fixed(place: float) -> Callable[[Any, Capability, Observation], Belief]:
    """Always the n at ``place`` in the prior (0 = lowest, 1 = highest)."""

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        low, high = briefing.n_range
        n = low + place * (high - low)
        return Belief(n, n, n)

    return believe


def believe_worst(slip_angle: float) -> Callable[[Any, Capability, Observation], Belief]:
    """The n of the prior with the smallest lateral limit at that slip angle [rad]."""

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        n = table.worst_lateral(slip_angle)
        return Belief(n, n, n)

    return believe


def believe_estimate(z: float) -> Callable[[Any, Capability, Observation], Belief]:
    """Mean of the estimate, insured over mean -+ z standard deviations inside the prior.

    The larger the filter's own doubt, the slower the vehicle. Before the filter has an estimate
    the prior's mean and standard deviation (uniform: width / sqrt(12)) stand in.
    """

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        low, high = briefing.n_range
        mean, sd, valid = (float(value) for value in observation["terrain"])
        if valid < 0.5 or not (math.isfinite(mean) and math.isfinite(sd)):
            mean, sd = 0.5 * (low + high), (high - low) / math.sqrt(12.0)
        mean = min(max(mean, low), high)
        return Belief(max(mean - z * sd, low), mean, min(mean + z * sd, high))

    return believe


def believe_truth(briefing: Any, table: Capability, observation: Observation) -> Belief:
    """The true n, as ``terrain_info="truth"`` tells it."""
    n = float(np.clip(observation["terrain"][0], *briefing.n_range))
    return Belief(n, n, n)


#: Name -> (terrain_info, informed, how the settings become a belief).
ARMS: dict[str, tuple[str, bool, Callable[[ArmSettings], Callable[..., Belief]]]] = {
    "nominal": ("none", False, lambda settings: believe_fixed(settings.n)),
    "conservative": ("none", False, lambda settings: believe_worst(settings.slip_angle)),
    "aware": ("estimate", True, lambda settings: believe_estimate(settings.z)),
    "oracle": ("truth", True, lambda settings: believe_truth),
}


def make_arm(name: str, *, scenario: str = "speed", settings: ArmSettings | None = None) -> Arm:
    """An arm with its tuned settings for a scenario.

    Parameters
    ----------
    name : {"nominal", "conservative", "aware", "oracle"}
    scenario : str
        Whose tuned settings to take.
    settings : ArmSettings, optional
        Instead of the tuned ones.

    Raises
    ------
    InvalidParameter
        For an unknown name, or a scenario that has not been tuned.
    """
    if name not in ARMS:
        raise InvalidParameter(f"arm must be one of {', '.join(ARMS)}, got {name!r}")
    if settings is None:
        if (scenario, name) not in SETTINGS:
            tuned = ", ".join(sorted({key[0] for key in SETTINGS}))
            raise InvalidParameter(
                f"no tuned settings for scenario {scenario!r}; tuned: {tuned} - agents.tune makes them"
            )
        settings = ArmSettings(**SETTINGS[scenario, name])
    terrain_info, informed, belief = ARMS[name]
    gains = PlannerGains(
        margin=settings.margin, slip_angle=settings.slip_angle, feed_forward=settings.feed_forward
    )
    return Arm(
        name=name, terrain_info=terrain_info, informed=informed, agent=SoilTracker(belief(settings), gains)
    )
