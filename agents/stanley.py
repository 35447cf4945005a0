"""Stanley's steering law: heading error and cross-track error of the front axle.

G. M. Hoffmann, C. J. Tomlin, M. Montemerlo, S. Thrun, Autonomous automobile trajectory tracking
for off-road driving, ACC 2007, eq. 5 and the corrections of its section III.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.protocol import Observation, Senses, read_senses, to_action
from agents.speed_control import SpeedController

__all__ = ["StanleyAgent", "StanleyGains", "stanley_steer"]


@dataclass(frozen=True, kw_only=True)
class StanleyGains:
    """Gains of the steering law."""

    k: float = 1.0  #: cross-track gain: rate of convergence to the path [1/s]
    k_soft: float = 1.0  #: speed added in the cross-track term, keeps it calm at low speed [m/s]
    k_yaw: float = 0.1  #: damping of the yaw rate against the path's [s]


def stanley_steer(
    senses: Senses, yaw_rate: float, arms: tuple[float, float], gains: StanleyGains
) -> float:
    """Road-wheel angle [rad], left positive.

    The cross-track error is sensed at the CG and the law needs it at the front axle, l_f ahead:
    e_f = e + l_f sin(heading error) - kappa l_f^2 / 2. On a curve the wheels also point along the
    path's circle, atan(L kappa) for small slip angles.

    Parameters
    ----------
    senses
    yaw_rate
        Measured [rad/s].
    arms
        (l_f, l_r): CG to the axles [m].
    gains
    """
    l_f, l_r = arms
    kappa = float(senses.curvature[0])
    # Path yaw at the front axle; the vehicle's yaw is the same at both.
    heading = senses.heading_error - kappa * l_f
    front = senses.cross_track + l_f * math.sin(senses.heading_error) - 0.5 * kappa * l_f * l_f
    pull = math.atan2(gains.k * front, gains.k_soft + max(senses.speed, 0.0))
    damping = gains.k_yaw * (senses.speed * kappa - yaw_rate)
    # The body of a vehicle on a circle points outward of the front axle's course by L kappa.
    return -heading - pull + damping + math.atan((l_f + l_r) * kappa) - kappa * l_f


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
        self._arms = (briefing.vehicle.l_f, briefing.vehicle.l_r)
        self._steer_range = briefing.steer_range
        self._speed_control = SpeedController(briefing.vehicle, briefing.dt)

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        steer = stanley_steer(senses, float(observation["imu"][4]), self._arms, self.gains)
        drive = self._speed_control.command(
            senses.target_speed or self.speed, senses.speed, rim_speed=max(senses.rim_speed)
        )
        return to_action(steer, drive, self._steer_range)
