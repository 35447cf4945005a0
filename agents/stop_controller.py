"""Braking before a line: as late as the soil believed in allows.

The plan is v^2 = 2 a (distance - aim) with a share of the deceleration that the soil gives a braked
wheel. Whoever believes in more than there is crosses the line, whoever believes in less arrives late.
"""

from __future__ import annotations

import math

from agents.protocol import Senses
from agents.speed_planner import Belief, BeliefSource, PlannerGains, SoilTracker

__all__ = ["StopController"]

#: Share of the zone before the line that is kept free [-].
_AIM = 0.3
#: Speed below which the brakes are simply held [m/s].
_HOLD = 0.6


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
        ahead = senses.distance - _AIM * zone - self.gains.lag * speed
        allowed = math.sqrt(2.0 * braking * max(ahead, 0.0))
        if senses.distance < zone and speed < _HOLD:
            return 0.0, -braking, slip_limit
        if allowed < target:
            return allowed, -braking, slip_limit
        return target, acceleration, slip_limit
