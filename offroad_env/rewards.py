"""Reward terms: progress along the path, and what it must not cost.

Progress is signed distance along the path, so circling earns what standing still earns: nothing
but the cost of time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from offroad_env.scenarios import Scenario

__all__ = ["Outcome", "RewardWeights", "reward_terms"]


@dataclass(frozen=True, kw_only=True)
class RewardWeights:
    """Weights of the terms; every term is at most of order one per second of driving."""

    progress: float = 0.1  #: per metre along the path
    time: float = 0.2  #: per second
    cross_track: float = 0.2  #: per second at the edge of the corridor, quadratic
    speed_error: float = 0.1  #: per second and (m/s)^2 away from the target speed, saturating
    smoothness: float = 0.05  #: per unit of squared change of the action
    goal: float = 10.0  #: once, on arrival
    failure: float = 20.0  #: once, on leaving the corridor, rolling over, being stuck or diverging


class Outcome(NamedTuple):
    """What one control interval brought."""

    advance: float  #: signed distance gained along the path [m]
    cross_track: float  #: distance from the path [m]
    speed: float  #: speed over ground [m/s]
    action_change: float  #: summed squared change of the action [-]
    success: bool
    failed: bool


def reward_terms(scenario: Scenario, weights: RewardWeights, outcome: Outcome, dt: float) -> dict[str, float]:
    """Named terms that add up to the reward of one control interval of ``dt`` [s]."""
    off = min(abs(outcome.cross_track) / scenario.corridor, 1.0)
    error = 0.0
    if scenario.target_speed > 0.0:
        miss = outcome.speed - scenario.target_speed
        error = math.tanh(miss * miss)
    return {
        "progress": weights.progress * outcome.advance,
        "time": -weights.time * dt,
        "cross_track": -weights.cross_track * off * off * dt,
        "speed_error": -weights.speed_error * error * dt,
        "smoothness": -weights.smoothness * outcome.action_change * dt,
        "goal": weights.goal if outcome.success else 0.0,
        "failure": -weights.failure if outcome.failed else 0.0,
    }
