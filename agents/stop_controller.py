"""Braking before a line: as late as the soil believed in allows.

The plan is v^2 = 2 a (distance - aim) with a share of the deceleration that the soil gives a braked
wheel. Whoever believes in more than there is crosses the line, whoever believes in less arrives late.
"""

from __future__ import annotations

import math

from agents.protocol import Senses
from agents.speed_planner import Belief, BeliefSource, PlannerGains, SoilTracker
from offroad_env.physics._jit import kernel

__all__ = ["StopController", "stopping_speed"]

#: Share of the zone before the line that is kept free [-].
_AIM = 0.3
#: Speed below which the brakes are simply held [m/s].
_HOLD = 0.6


@kernel
def stopping_speed(distance, zone, speed, braking, lag):
    """Highest speed [m/s] from which the vehicle comes to stand in the zone before a line.

    Parameters
    ----------
    distance, zone : float
        Way to the line, and length of the zone before it [m].
    speed : float
        Of the vehicle [m/s]; below walking pace inside the zone the brakes are simply held.
    braking : float
        Deceleration [m/s^2].
    lag : float
        Time between a command and its effect [s].
    """
    if distance < zone and speed < _HOLD:
        return 0.0
    return math.sqrt(2.0 * braking * max(distance - _AIM * zone - lag * speed, 0.0))


class StopController(SoilTracker):
    """`SoilTracker` that stands in the zone before the end of the path.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`; ``gains.brake_share`` is the share of the believed braking that is used.
    """

    def __init__(self, believe: BeliefSource, gains: PlannerGains | None = None) -> None:
        super().__init__(believe, gains)

    def _wanted(self, senses: Senses, belief: Belief, lateral: float) -> tuple[float, float, float | None]:
        target, acceleration, slip_limit = super()._wanted(senses, belief, lateral)
        zone, speed = self._briefing.stop_zone, max(senses.speed, 0.0)
        braking = self.gains.brake_share * self._capability.braking_limit(belief.low, belief.high)
        allowed = stopping_speed(senses.distance, zone, speed, braking, self.gains.lag)
        if allowed < target:
            return allowed, -braking, slip_limit
        return target, acceleration, slip_limit
