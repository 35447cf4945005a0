"""Stanley's steering law: heading error and cross-track error of the front axle.

G. M. Hoffmann, C. J. Tomlin, M. Montemerlo, S. Thrun, Autonomous automobile trajectory tracking
for off-road driving, ACC 2007, eq. 5 and the corrections of its section III.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.protocol import Observation, Senses, read_senses, to_action
from agents.controllers.speed_control import SpeedController, gentle_target

__all__ = ["StanleyAgent", "StanleyGains", "stanley_steer"]


@dataclass(frozen=True, kw_only=True)
class StanleyGains:
    """Gains of the steering law."""

    k: float = 1.0  #: cross-track gain: rate of convergence to the path [1/s]
    k_soft: float = 1.0  #: speed added in the cross-track term, keeps it calm at low speed [m/s]
    k_yaw: float = 0.1  #: damping of the yaw rate against the path's [s]


def stanley_steer(senses: Senses, yaw_rate: float, l_f: float, gains: StanleyGains) -> float:
    """Road-wheel angle [rad], left positive.

    The errors are sensed at the CG and the law needs them at the front axle, l_f ahead, where the
    path has turned by kappa l_f and moved by kappa l_f^2 / 2. The front axle then follows the
    path; the CG runs inside of it by about kappa (l_f l_r + l_f^2 / 2).

    Parameters
    ----------
    senses
    yaw_rate
        Measured [rad/s].
    l_f
        CG to the front axle [m].
    gains
    """
    kappa = float(senses.curvature[0])
    heading = senses.heading_error - kappa * l_f
    front = senses.cross_track + l_f * math.sin(senses.heading_error) - 0.5 * kappa * l_f * l_f
    pull = math.atan2(gains.k * front, gains.k_soft + max(senses.speed, 0.0))
    damping = gains.k_yaw * (senses.speed * kappa - yaw_rate)
    return -heading - pull + damping


class StanleyAgent:
    """Stanley's steering with a speed PI: knows nothing of the soil.

    Parameters
    ----------
    speed
        Speed to hold where the task gives none [m/s].
    gains
    """

    def __init__(self, *, speed: float = 4.0, gains: StanleyGains | None = None) -> None:
        self.speed = speed
        self.gains = gains or StanleyGains()

    def reset(self, briefing: Any) -> None:
        """Take vehicle and control interval from the briefing."""
        self._l_f = briefing.vehicle.l_f
        self._steer_range = briefing.vehicle.steer_max
        self._speed_control = SpeedController(briefing.vehicle, briefing.dt)
        self._stop_zone = briefing.stop_zone

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        steer = stanley_steer(senses, float(observation["imu"][4]), self._l_f, self.gains)
        target = gentle_target(senses.target_speed or self.speed, senses.distance, self._stop_zone)
        drive = self._speed_control.command(target, senses.speed, rim_speed=max(senses.rim_speed))
        return to_action(steer, drive, self._steer_range)
