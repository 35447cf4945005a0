"""The arms of the benchmark: one controller, four sources of n.

All arms of a task are the same controller (`CONTROLLERS`); they differ only in the n that they assume:

oracle        the true n (``terrain_info="truth"``)
aware         mean and standard deviation of the online filter (``terrain_info="estimate"``)
nominal       one fixed n, the one that scores best over the prior on training seeds
conservative  the n of the prior that is worst for the task (`WORST`)

Each arm's *own knobs* are tuned with the same budget (`agents.benchmark.tune`), *common knobs* are those of
the oracle for all, so that arms differ by what they know alone; the outcome is
`agents.controllers.tuned`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.path_lqg import PathController, PathWeights
from agents.controllers.protocol import Agent, Observation
from agents.controllers.ride_controller import RideController, RideKnobs
from agents.controllers.slip_controller import SlipController
from agents.controllers.speed_control import SpeedGains
from agents.controllers.speed_planner import Belief, BeliefSource, PlannerGains, SoilTracker
from agents.controllers.stop_controller import StopController
from agents.controllers.traction_limits import Capability
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.errors import InvalidParameter

__all__ = [
    "ARMS",
    "COMMON_KNOBS",
    "CONTROLLERS",
    "WORST",
    "Arm",
    "ArmSettings",
    "believe_estimate",
    "believe_fixed",
    "believe_prior",
    "believe_truth",
    "believe_worst",
    "is_tuned",
    "make_arm",
]


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """The tuned knobs. An arm ignores those that do not concern it."""

    margin: float = 0.8  #: share of the believed lateral limit that is used [-]
    slip_angle: float = 0.3  #: largest slip angle that the plan allows [rad]
    feed_forward: float = 0.8  #: share of the believed slip angles that the steering anticipates [-]
    integral: float = 1.0  #: integral gain of the speed control [1/s^2]
    brake_share: float = 0.5  #: share of the believed braking that is used [-]
    slip_share: float = 1.0  #: climb: share of the believed best slip that is used [-]
    distance: float = 0.03  #: track: distance that counts as bad as 0.1 rad of steering [m]
    unknown: float = 1.0  #: track: size of what an axle holds beyond belief [m/s^2]
    ride_speed: float = 6.0  #: ride: scheduled speed in the middle of the prior [m/s]
    ride_change: float = 0.0  #: ride: change of it from the lowest to the highest n [m/s]
    ride_feel: float = 0.5  #: ride: weight of the measured against the scheduled speed [-]
    ride_share: float = 0.85  #: ride: share of the limit that feedback aims at [-]
    speed_max: float = 15.0  #: natural form: highest speed on any path [m/s]
    n: float = 0.5  #: nominal: believed place in the prior, 0 = lowest n, 1 = highest [-]
    z: float = 1.0  #: aware: how many standard deviations the insured interval reaches [-]


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A named agent and the environment mode that it needs."""

    name: str
    terrain_info: str  #: "none", "estimate" or "truth"
    informed: bool  #: whether it learns anything about the soil of the episode
    agent: Agent


def believe_fixed(place: float) -> BeliefSource:
    """Always the n at ``place`` in the prior (0 = lowest, 1 = highest)."""

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        low, high = briefing.n_range
        n = low + place * (high - low)
        return Belief(n, n, n)

    return believe


def believe_worst(worst: Callable[[Capability], float]) -> BeliefSource:
    """The n of the prior that is worst by ``worst``, a function of the table."""

    def believe(briefing: Any, table: Capability, observation: Observation) -> Belief:
        n = worst(table)
        return Belief(n, n, n)

    return believe


#: Task -> which n of the prior is worst for it, given the settings.
WORST: dict[str, Callable[[ArmSettings], Callable[[Capability], float]]] = {
    "climb": lambda settings: lambda table: table.worst_pull(),
    "brake": lambda settings: lambda table: table.worst_braking(),
    "ride": lambda settings: lambda table: float(table.grid[0]),
}


def _worst(scenario: str, settings: ArmSettings) -> Callable[[Capability], float]:
    """Where nothing else is said, the n with the least side grip is the worst."""
    if scenario in WORST:
        return WORST[scenario](settings)
    return lambda table: table.worst_lateral(settings.slip_angle)


def believe_estimate(z: float) -> BeliefSource:
    """Mean of the estimate, insured over mean -+ z standard deviations inside the prior.

    The larger the filter's standard deviation, the slower the vehicle. Before the filter has an estimate
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


def believe_prior(briefing: Any, table: Capability, observation: Observation) -> Belief:
    """The whole prior: its middle, insured from end to end."""
    low, high = briefing.n_range
    return Belief(low, 0.5 * (low + high), high)


def believe_truth(briefing: Any, table: Capability, observation: Observation) -> Belief:
    """The true n of ``terrain_info="truth"``."""
    n = float(np.clip(observation["terrain"][0], *briefing.n_range))
    return Belief(n, n, n)


#: Name -> (terrain_info, informed, how task and settings become a belief).
ARMS: dict[str, tuple[str, bool, Callable[[str, ArmSettings], BeliefSource]]] = {
    "nominal": ("none", False, lambda scenario, settings: believe_fixed(settings.n)),
    "conservative": ("none", False, lambda scenario, settings: believe_worst(_worst(scenario, settings))),
    "aware": ("estimate", True, lambda scenario, settings: believe_estimate(settings.z)),
    "oracle": ("truth", True, lambda scenario, settings: believe_truth),
}


def _ride(believe: BeliefSource, gains: PlannerGains, settings: ArmSettings) -> Agent:
    ride = RideKnobs(settings.ride_speed, settings.ride_change, settings.ride_feel, settings.ride_share)
    return RideController(believe, gains, ride=ride)


def _follow(believe: BeliefSource, gains: PlannerGains, settings: ArmSettings) -> Agent:
    weights = PathWeights(distance=settings.distance, unknown=settings.unknown)
    return PathController(believe, gains, weights=weights)


#: Ending of an arm's name that drives with common knobs where the others drive with their own.
COMMON_KNOBS = "_common"

#: Task -> its controller; the others are driven by `SoilTracker`.
CONTROLLERS: dict[str, Callable[[BeliefSource, PlannerGains, ArmSettings], Agent]] = {
    "track": _follow,
    "climb": lambda believe, gains, settings: SlipController(believe, gains, slip_share=settings.slip_share),
    "brake": lambda believe, gains, settings: StopController(believe, gains),
    "ride": _ride,
}


def is_tuned(name: str, task: str) -> bool:
    """Whether there are settings of an arm for a task."""
    from agents.controllers.tuned import SETTINGS

    return (task, name) in SETTINGS


def _tuned(name: str, task: str, knobs: str) -> ArmSettings:
    # Here and not above: who asks what sources stand behind a result adds the settings of its arm.
    from agents.controllers.tuned import COMMON_PLACES, SETTINGS

    if (task, name) not in SETTINGS or (knobs == "common" and task not in COMMON_PLACES):
        tuned = ", ".join(sorted({key[0] for key in SETTINGS}))
        raise InvalidParameter(
            f"no tuned settings for scenario {task!r}; tuned: {tuned}; made by agents.benchmark.tune"
        )
    if knobs == "common":
        # The insurance of aware is no outcome of a search: one standard deviation.
        return ArmSettings(**SETTINGS[task, "oracle"], n=COMMON_PLACES[task])
    return ArmSettings(**SETTINGS[task, name])


def make_arm(
    name: str,
    *,
    scenario: str = "speed",
    settings: ArmSettings | None = None,
    knobs: str = "own",
    tracker: Callable[[BeliefSource, PlannerGains], Agent] | None = None,
) -> Arm:
    """An arm with its tuned settings for a scenario.

    Parameters
    ----------
    name : {"nominal", "conservative", "aware", "oracle"}
    scenario : str
        Whose tuned settings to take; for one of your own, those of the task that it is most like.
    settings : ArmSettings, optional
        Instead of the tuned ones.
    knobs : {"own", "common"}
        Which tuned ones.
    tracker : callable, optional
        Makes another controller from belief and gains than the task's own.

    Raises
    ------
    InvalidParameter
        For an unknown name or kind of knobs, or a scenario that has not been tuned.
    """
    if name not in ARMS:
        raise InvalidParameter(f"arm must be one of {', '.join(ARMS)}, got {name!r}")
    if knobs not in ("own", "common"):
        raise InvalidParameter(f"knobs must be own or common, got {knobs!r}")
    driven = find_scenario(scenario)
    scenario = driven.task
    if settings is None:
        settings = _tuned(name, scenario, knobs)
    terrain_info, informed, belief = ARMS[name]
    # An integral learns a bend's drive, which is wrong on another soil: a feed-forward takes its place.
    changing = driven.changing
    gains = PlannerGains(
        margin=settings.margin,
        slip_angle=settings.slip_angle,
        feed_forward=settings.feed_forward,
        brake_share=settings.brake_share,
        turning=changing,
        speed=SpeedGains(k_i=settings.integral, whole_power=changing),
    )
    believe = belief(scenario, settings)
    if tracker is not None:
        agent = tracker(believe, gains)
    elif scenario in CONTROLLERS:
        agent = CONTROLLERS[scenario](believe, gains, settings)
    else:
        agent = SoilTracker(believe, gains)
    return Arm(name=name, terrain_info=terrain_info, informed=informed, agent=agent)
