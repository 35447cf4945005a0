"""Reward terms: progress along the path, and what it must not cost.

Progress is signed distance along the path, so circling earns what standing still earns: nothing
but the cost of time.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, fields
from typing import NamedTuple

import numpy as np

from offroad_env.physics._jit import kernel
from offroad_env.scenarios import Scenario

__all__ = ["TERMS", "Outcome", "RewardWeights", "reward_terms", "write_terms"]


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


#: Names of the terms, in the order of the weights.
TERMS = tuple(field.name for field in fields(RewardWeights))


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


def reward_terms(scenario: Scenario, weights: RewardWeights, outcome: Outcome, dt: float) -> dict[str, float]:
    """Named terms that add up to the reward of one control interval of ``dt`` [s]."""
    terms = np.empty(len(TERMS))
    scale = (scenario.corridor, scenario.target_speed, float(dt))
    write_terms(tuple(outcome), scale, np.array(astuple(weights)), terms)
    return dict(zip(TERMS, terms.tolist(), strict=True))
