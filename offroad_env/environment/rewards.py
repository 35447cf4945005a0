"""Reward terms, and the rules by which an episode ends.

Progress is signed distance along the path, so circling earns what standing still earns: nothing
but the cost of time. Terms and rules are compiled functions of numbers: one vehicle and a fleet are
judged by the same code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
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
    "Scale",
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
    """The state of an episode that the rules look at."""

    progress: float  #: distance along the path [m]
    length: float  #: length of the path, to the goal or to the line [m]
    cross_track: float  #: [m]
    speed: float  #: [m/s]
    shake: float  #: running r.m.s. of the vertical acceleration [m/s^2]


@kernel
def reached_goal(rules: Rules, moment: Moment) -> bool:
    """Whether the task is done: at the goal, or standing in the zone before the line."""
    if rules.stop_zone > 0.0:
        return moment.progress >= moment.length - rules.stop_zone and moment.speed < STANDING
    return moment.progress >= moment.length


@kernel
def broken_rule(rules: Rules, moment: Moment) -> int:
    """The rule of the task that is broken, as a number of `ENDINGS`; 0 where none is."""
    if abs(moment.cross_track) > rules.corridor:
        return _LEFT
    if rules.stop_zone > 0.0 and moment.progress > moment.length:
        return _OVERRAN
    return _TOO_ROUGH if moment.shake > rules.shake_limit else 0


@dataclass(frozen=True, kw_only=True)
class RewardWeights:
    """Weights of the terms; every term but the last two is at most of order one per second of driving."""

    progress: float = 0.1  #: per metre along the path
    time: float = 0.2  #: per second
    cross_track: float = 0.2  #: per second at the edge of the corridor, quadratic
    speed_error: float = 0.1  #: per second and (m/s)^2 away from the target speed, saturating
    smoothness: float = 0.05  #: per second and unit of squared change of the action
    goal: float = 10.0  #: once, on arrival

    def failure(self, time_limit: float) -> float:
        """What a failure costs, once: all that an episode of ``time_limit`` [s] could cost otherwise.

        Leaving the corridor in the first second thus costs no less than standing until the time is over.
        """
        return (self.time + self.cross_track + self.speed_error) * time_limit

    def row(self, time_limit: float) -> np.ndarray:
        """The weights (7,) in the order of `TERMS`."""
        return np.array([*vars(self).values(), self.failure(time_limit)])


class Outcome(NamedTuple):
    """The result of one control interval."""

    advance: float  #: signed distance gained along the path [m]
    cross_track: float  #: distance from the path [m]
    speed: float  #: speed over ground [m/s]
    action_change: float  #: summed squared change of the action [-]
    success: bool
    failed: bool


class Scale(NamedTuple):
    """What the terms of an interval are measured by."""

    corridor: float  #: half width of the corridor [m]
    target_speed: float  #: 0 = as fast as possible [m/s]
    dt: float  #: length of the interval [s]


#: Names of the terms, in the order of the weights.
TERMS = (*(field.name for field in fields(RewardWeights)), "failure")
_PROGRESS, _TIME, _CROSS_TRACK, _SPEED_ERROR, _SMOOTHNESS, _SUCCESS, _FAILURE = range(len(TERMS))


@kernel
def write_terms(outcome: Outcome, scale: Scale, weights: np.ndarray, terms: np.ndarray) -> None:
    """Fill ``terms`` (7,) of one interval; ``weights`` (7,) and ``terms`` in the order of `TERMS`."""
    dt = scale.dt
    off = min(abs(outcome.cross_track) / scale.corridor, 1.0)
    error = 0.0
    if scale.target_speed > 0.0:
        miss = outcome.speed - scale.target_speed
        error = math.tanh(miss * miss)
    terms[_PROGRESS] = weights[_PROGRESS] * outcome.advance
    terms[_TIME] = -weights[_TIME] * dt
    terms[_CROSS_TRACK] = -weights[_CROSS_TRACK] * off * off * dt
    terms[_SPEED_ERROR] = -weights[_SPEED_ERROR] * error * dt
    terms[_SMOOTHNESS] = -weights[_SMOOTHNESS] * outcome.action_change * dt
    terms[_SUCCESS] = weights[_SUCCESS] if outcome.success else 0.0
    terms[_FAILURE] = -weights[_FAILURE] if outcome.failed else 0.0


def reward_terms(
    rules: Rules, weights: RewardWeights, target_speed: float, outcome: Outcome, dt: float
) -> dict[str, float]:
    """Named terms that add up to the reward of one control interval of ``dt`` [s]."""
    terms = np.empty(len(TERMS))
    scale = Scale(rules.corridor, float(target_speed), float(dt))
    write_terms(outcome, scale, weights.row(rules.time_limit), terms)
    return dict(zip(TERMS, terms.tolist(), strict=True))
