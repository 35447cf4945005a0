"""Climbing: hold the slip that gives most pull on the assumed soil.

A wheel pulls by shearing the soil, and shears it by slipping; but slip also digs (Wong, Theory of
Ground Vehicles, section 2.9). Between the two lies a best slip, which depends on n. The controller
drives at the speed asked for and lets the rim speed rise to v / (1 - best slip) and no further. Rim
speeds are measured far better than the slip of a creeping vehicle, so it is they that are controlled.

A wheel that slips along its plane has little force left across it (friction ellipse; Wong, section 1.3), and
where the path is not the steepest line gravity pulls aside. So slip is given up towards the corridor's edge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.controllers.protocol import Senses
from agents.controllers.speed_control import SpeedController, SpeedGains
from agents.controllers.speed_planner import Belief, BeliefSource, PlannerGains, SoilTracker

__all__ = ["SlipController"]

#: Speed that slip is referred to at least [m/s]: standing wheels must begin to turn.
_LOW_SPEED = 0.3
_MOST_SLIP = 0.9
#: Rim speed answers torque at once but for the torque's lag, so a softer loop than a vehicle's does.
_RIM_GAINS = SpeedGains(k_p=1.0, k_i=2.0, integral_max=6.0, slip_limit=10.0)


class SlipController(SoilTracker):
    """`SoilTracker` whose rim speed is limited to the one of the best slip.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`.
    slip_share
        Share of the best slip that is used [-].
    """

    drive_slip_limit = _MOST_SLIP

    def __init__(
        self, believe: BeliefSource, gains: PlannerGains | None = None, *, slip_share: float = 1.0
    ) -> None:
        super().__init__(believe, gains)
        self.slip_share = slip_share

    def reset(self, briefing: Any) -> None:
        """As `SoilTracker`."""
        super().reset(briefing)
        self._rim_control = SpeedController(briefing.vehicle, briefing.dt, _RIM_GAINS)

    def drive(self, senses: Senses, belief: Belief, lateral: float) -> float:
        """As `SoilTracker`, but no more than holds the rim speed of the best slip."""
        wanted = super().drive(senses, belief, lateral)
        slip = min(self.slip_share * self._capability.best_slip(belief.low, belief.high), _MOST_SLIP)
        slip *= math.sqrt(max(1.0 - (senses.cross_track / self._briefing.corridor) ** 2, 0.0))
        allowed = max(senses.speed, _LOW_SPEED) / (1.0 - slip)
        resistance = self._capability.at("resistance", belief.mean)
        held = self._rim_control.command(allowed, float(np.mean(senses.rim_speed)), resistance=resistance)
        return min(wanted, max(held, 0.0))
