"""Reward terms, and the rules by which an episode ends.

Progress is signed distance along the path, so circling earns what standing still earns: nothing
but the cost of time. Terms and rules are compiled functions of numbers: one vehicle and a fleet are
judged by the same code.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields
from typing import NamedTuple

import numpy as np

from offroad_env.physics._jit import kernel

__all__ = [
    "ENDINGS",
    "SHAKE_TIME",
    "STANDING",
    "TERMS",
    "Moment",
    "Outcome",
    "RewardWeights",
    "Rules",
    "broken_rule",
    "reached_goal",
    "reward_terms",
    "write_terms",
]

#: Speed below which a vehicle stands [m/s].
STANDING = 0.1
#: Time constant of the mean square of the vertical acceleration [s].
SHAKE_TIME = 2.0

#: How an episode stands, by the number in its record; from 2 on they are failures.
ENDINGS = ("", "goal", "left_corridor", "overran", "too_rough", "rollover", "immobilised", "diverged")
_LEFT, _OVERRAN, _TOO_ROUGH = 2, 3, 4


class Rules(NamedTuple):
    """When an episode of a task is over."""

    corridor: float  #: half width of the corridor; leaving it is a failure [m]
    time_limit: float = 120.0  #: [s]
    stop_zone: float = 0.0  #: > 0: stand within this distance before the line, never cross it [m]
    shake_limit: float = math.inf  #: largest running r.m.s. of the vertical acceleration [m/s^2]
    stalling: float = 0.0  #: 1 = to be stuck is how the task ends for everybody, not a failure


class Moment(NamedTuple):
    """Where the vehicle is, as far as the rules ask."""

    progress: float  #: distance along the path [m]
    length: float  #: length of the path, to the goal or to the line [m]
    cross_track: float  #: [m]
    speed: float  #: [m/s]
    shake: float  #: running r.m.s. of the vertical acceleration [m/s^2]


@kernel
def reached_goal(rules, moment):
    """Whether the task is done: at the goal, or standing in the zone before the line."""
    progress, length, _, speed, _ = moment
    zone = rules[2]
    if zone > 0.0:
        return progress >= length - zone and speed < STANDING
    return progress >= length


@kernel
def broken_rule(rules, moment):
    """The rule of the task that is broken, as a number of `ENDINGS`; 0 where none is."""
    progress, length, cross_track, _, shake = moment
    if abs(cross_track) > rules[0]:
        return _LEFT
    if rules[2] > 0.0 and progress > length:
        return _OVERRAN
    return _TOO_ROUGH if shake > rules[3] else 0


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

    def row(self, time_limit: float) -> np.ndarray:
        """The weights (7,) in the order of `TERMS`."""
        return np.array([*astuple(self), self.failure(time_limit)])


class Outcome(NamedTuple):
    """What one control interval brought."""

    advance: float  #: signed distance gained along the path [m]
    cross_track: float  #: distance from the path [m]
    speed: float  #: speed over ground [m/s]
    action_change: float  #: summed squared change of the action [-]
    success: bool
    failed: bool


#: Names of the terms, in the order of the weights.
TERMS = (*(field.name for field in fields(RewardWeights)), "failure")


@kernel
def write_terms(outcome, scale, weights, terms):
    """Fill ``terms`` (7,) from an `Outcome`; ``scale`` = (corridor [m], target speed [m/s], dt [s]).

    ``weights`` (7,) in the order of `TERMS`.
    """
    advance, cross_track, speed, action_change, success, failed = outcome
    corridor, target_speed, dt = scale
    off = min(abs(cross_track) / corridor, 1.0)
    error = 0.0
    if target_speed > 0.0:
        miss = speed - target_speed
        error = math.tanh(miss * miss)
    terms[0] = weights[0] * advance
    terms[1] = -weights[1] * dt
    terms[2] = -weights[2] * off * off * dt
    terms[3] = -weights[3] * error * dt
    terms[4] = -weights[4] * action_change * dt
    terms[5] = weights[5] if success else 0.0
    terms[6] = -weights[6] if failed else 0.0


def reward_terms(
    rules: Rules, weights: RewardWeights, target_speed: float, outcome: Outcome, dt: float
) -> dict[str, float]:
    """Named terms that add up to the reward of one control interval of ``dt`` [s]."""
    terms = np.empty(len(TERMS))
    scale = (rules.corridor, float(target_speed), float(dt))
    write_terms(tuple(outcome), scale, weights.row(rules.time_limit), terms)
    return dict(zip(TERMS, terms.tolist(), strict=True))
