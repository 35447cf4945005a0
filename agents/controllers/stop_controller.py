"""Braking before a line: as late as the assumed soil allows.

The plan is v^2 = 2 a (distance - aim) with a share of the deceleration that the soil gives a braked
wheel. If it assumes too much the vehicle crosses the line, if too little it arrives late.
"""

from __future__ import annotations

import math

from agents.controllers.protocol import Senses
from agents.controllers.speed_planner import Belief, BeliefSource, PlannedMotion, PlannerGains, SoilTracker
from offroad_env.physics._jit import kernel

__all__ = ["StopController", "stopped_motion", "stopping_speed"]

#: Share of the zone before the line that is kept free [-].
_AIM = 0.3
#: Speed below which the brakes are simply held [m/s].
_HOLD = 0.6


@kernel
def stopping_speed(distance: float, zone: float, speed: float, braking: float, lag: float) -> float:
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


@kernel
def stopped_motion(
    motion: PlannedMotion, distance: float, zone: float, speed: float, braking: float, lag: float
) -> PlannedMotion:
    """The planned motion, or the one before a line if that is slower; arguments of `stopping_speed`."""
    allowed = stopping_speed(distance, zone, speed, braking, lag)
    if allowed < motion.speed:
        return PlannedMotion(allowed, -braking)
    return motion


class StopController(SoilTracker):
    """`SoilTracker` that stands in the zone before the end of the path.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`; ``gains.brake_share`` is the share of the soil's braking that is used.
    """

    def __init__(self, believe: BeliefSource, gains: PlannerGains | None = None) -> None:
        super().__init__(believe, gains)

    def planned(self, senses: Senses, belief: Belief, lateral: float) -> PlannedMotion:
        """As `SoilTracker`, and slow enough to stand before the line."""
        motion = super().planned(senses, belief, lateral)
        speed, braking = max(senses.speed, 0.0), self.braking(belief)
        return stopped_motion(
            motion, senses.distance, self._briefing.stop_zone, speed, braking, self.gains.lag
        )
