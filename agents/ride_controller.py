"""Rough ground: as fast as the limit on the vertical acceleration allows.

The r.m.s. of the vertical acceleration grows about in proportion to speed, and firm ground shakes more
than soft ground. Two sources are weighed against each other: a speed scheduled on the believed n, and
what the accelerometer says at the speed of the moment.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.protocol import Observation, Senses
from agents.speed_planner import Belief, BeliefSource, PlannerGains, SoilTracker

__all__ = ["RideController"]

_TIME = 2.0  # of the running mean square [s]
_LEAST = 1.0  # lowest speed that feedback asks for [m/s]
_NOISE = 0.02  # variance of the mean of two samples of the accelerometer [(m/s^2)^2]


class RideController(SoilTracker):
    """`SoilTracker` with a speed cap for the sake of the load.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`.
    ride
        (speed in the middle of the prior [m/s], change of it from the lowest to the highest n [m/s],
        weight of what is felt against what is scheduled, 0 ... 1, share of the limit that is aimed at).
    """

    def __init__(
        self,
        believe: BeliefSource,
        gains: PlannerGains | None = None,
        *,
        ride: tuple[float, float, float, float] = (6.0, 0.0, 0.5, 0.85),
    ) -> None:
        super().__init__(believe, gains)
        self.ride = ride

    def reset(self, briefing: Any) -> None:
        """As `SoilTracker`; nothing has been felt yet."""
        super().reset(briefing)
        self._mean_square = 0.0

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        felt = max(float(observation["imu"][2]) ** 2 - _NOISE, 0.0)
        self._mean_square += self._briefing.dt / _TIME * (felt - self._mean_square)
        return super().act(observation)

    def _wanted(self, senses: Senses, belief: Belief, lateral: float) -> tuple[float, float, float | None]:
        target, acceleration, slip_limit = super()._wanted(senses, belief, lateral)
        cap = self._cap(max(senses.speed, _LEAST), belief)
        return (target, acceleration, slip_limit) if target < cap else (cap, 0.0, slip_limit)

    def _cap(self, speed: float, belief: Belief) -> float:
        middle, change, weight, share = self.ride
        low, high = self._briefing.n_range
        # Low n is firm: the careful end of the belief is its lowest n.
        place = (belief.low - low) / max(high - low, 1e-6)
        scheduled = middle + change * (place - 0.5)
        shake = max(math.sqrt(self._mean_square), 0.1)
        felt = max(speed * share * self._briefing.shake_limit / shake, _LEAST)
        return (1.0 - weight) * scheduled + weight * min(felt, 2.0 * scheduled)
