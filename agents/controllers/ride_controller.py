"""Rough ground: as fast as the limit on the vertical acceleration allows.

The r.m.s. of the vertical acceleration grows about in proportion to speed, and firm ground shakes more
than soft ground. Two sources are weighed against each other: a speed scheduled on the assumed n, and
the accelerometer's reading at the present speed.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.protocol import Observation, Senses
from agents.controllers.speed_planner import Belief, BeliefSource, PlannedMotion, PlannerGains, SoilTracker

__all__ = ["RideController", "RideKnobs"]

_TIME = 2.0  # of the running mean square [s]
_LEAST = 1.0  # lowest speed that feedback asks for [m/s]
_NOISE = 0.02  # variance of the mean of two samples of the accelerometer [(m/s^2)^2]


class RideKnobs(NamedTuple):
    """Schedule and feedback of the speed."""

    speed: float = 6.0  #: scheduled in the middle of the prior [m/s]
    change: float = 0.0  #: of the scheduled speed from the lowest to the highest n [m/s]
    feedback: float = 0.5  #: weight of the measured against the scheduled speed, 0 ... 1 [-]
    share: float = 0.85  #: share of the limit that feedback aims at [-]


class RideController(SoilTracker):
    """`SoilTracker` with a speed cap for the sake of the load.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`.
    ride
    """

    def __init__(
        self,
        believe: BeliefSource,
        gains: PlannerGains | None = None,
        *,
        ride: RideKnobs | None = None,
    ) -> None:
        super().__init__(believe, gains)
        self.ride = ride or RideKnobs()

    def reset(self, briefing: Any) -> None:
        """As `SoilTracker`; the running mean square starts at zero."""
        super().reset(briefing)
        self._mean_square = 0.0

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        square = max(float(observation["imu"][2]) ** 2 - _NOISE, 0.0)
        self._mean_square += self._briefing.dt / _TIME * (square - self._mean_square)
        return super().act(observation)

    def planned(self, senses: Senses, belief: Belief, lateral: float) -> PlannedMotion:
        """As `SoilTracker`, below the speed that the limit allows."""
        motion = super().planned(senses, belief, lateral)
        cap = self._cap(max(senses.speed, _LEAST), belief)
        return motion if motion.speed < cap else PlannedMotion(cap, 0.0)

    def _cap(self, speed: float, belief: Belief) -> float:
        ride = self.ride
        low, high = self._briefing.n_range
        # Low n is firm: the cautious end of the interval is its lowest n.
        place = (belief.low - low) / max(high - low, 1e-6)
        scheduled = ride.speed + ride.change * (place - 0.5)
        shake = max(math.sqrt(self._mean_square), 0.1)
        measured = max(speed * ride.share * self._briefing.shake_limit / shake, _LEAST)
        cap: float = (1.0 - ride.feedback) * scheduled + ride.feedback * min(measured, 2.0 * scheduled)
        return cap
