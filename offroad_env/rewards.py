"""Reward terms, and the rules by which an episode ends.

Progress is signed distance along the path, so circling earns what standing still earns: nothing
but the cost of time. Everything here is a plain function of floats and of the numbers of a task,
`RewardWeights` and `Rules`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["Moment", "Outcome", "RewardWeights", "Rules", "broken_rule", "reached_goal", "reward_terms"]

#: Speed below which a vehicle stands [m/s].
STANDING = 0.1
#: Time constant of the mean square of the vertical acceleration [s].
SHAKE_TIME = 2.0


class Rules(NamedTuple):
    """When an episode of a task is over."""

    corridor: float  #: half width of the corridor; leaving it is a failure [m]
    time_limit: float = 120.0  #: [s]
    stop_zone: float = 0.0  #: > 0: stand within this distance before the line, never cross it [m]
    shake_limit: float = math.inf  #: largest running r.m.s. of the vertical acceleration [m/s^2]
    stalling: float = 0.0  #: 1 = to be stuck is how the task ends for everybody, not a failure


@dataclass(frozen=True, kw_only=True)
class RewardWeights:
    """Weights of the terms; every term but the last two is at most of order one per second of driving."""

    progress: float = 0.1  #: per metre along the path
    time: float = 0.2  #: per second
    cross_track: float = 0.2  #: per second at the edge of the corridor, quadratic
    speed_error: float = 0.1  #: per second and (m/s)^2 away from the target speed, saturating
    smoothness: float = 0.05  #: per unit of squared change of the action
    goal: float = 10.0  #: once, on arrival

    def failure(self, time_limit: float) -> float:
        """What a failure costs, once: all that an episode of ``time_limit`` [s] could cost otherwise.

        Whoever leaves the corridor in the first second thus has no less to pay than whoever stands
        until the time is over.
        """
        return (self.time + self.cross_track + self.speed_error) * time_limit


class Outcome(NamedTuple):
    """What one control interval brought."""

    advance: float  #: signed distance gained along the path [m]
    cross_track: float  #: distance from the path [m]
    speed: float  #: speed over ground [m/s]
    action_change: float  #: summed squared change of the action [-]
    success: bool
    failed: bool


class Moment(NamedTuple):
    """Where the vehicle is, as far as the rules ask."""

    progress: float  #: distance along the path [m]
    length: float  #: length of the path, to the goal or to the line [m]
    cross_track: float  #: [m]
    speed: float  #: [m/s]
    shake: float  #: running r.m.s. of the vertical acceleration [m/s^2]


def reached_goal(rules: Rules, moment: Moment) -> bool:
    """Whether the task is done: at the goal, or standing in the zone before the line."""
    if rules.stop_zone > 0.0:
        return moment.progress >= moment.length - rules.stop_zone and moment.speed < STANDING
    return moment.progress >= moment.length


def broken_rule(rules: Rules, moment: Moment) -> str:
    """The rule of the task that is broken: "left_corridor", "overran", "too_rough" or ""."""
    if abs(moment.cross_track) > rules.corridor:
        return "left_corridor"
    if rules.stop_zone > 0.0 and moment.progress > moment.length:
        return "overran"
    return "too_rough" if moment.shake > rules.shake_limit else ""


def reward_terms(
    rules: Rules, weights: RewardWeights, target_speed: float, outcome: Outcome, dt: float
) -> dict[str, float]:
    """Named terms that add up to the reward of one control interval of ``dt`` [s]."""
    off = min(abs(outcome.cross_track) / rules.corridor, 1.0)
    error = 0.0
    if target_speed > 0.0:
        miss = outcome.speed - target_speed
        error = math.tanh(miss * miss)
    return {
        "progress": weights.progress * outcome.advance,
        "time": -weights.time * dt,
        "cross_track": -weights.cross_track * off * off * dt,
        "speed_error": -weights.speed_error * error * dt,
        "smoothness": -weights.smoothness * outcome.action_change * dt,
        "goal": weights.goal if outcome.success else 0.0,
        "failure": -weights.failure(rules.time_limit) if outcome.failed else 0.0,
    }
