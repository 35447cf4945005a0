"""Steering by LQR, scheduled on speed and on the soil believed in, around a feed-forward of the slip angles.

Along the path, with distance s as the clock, the vehicle's distance e from it and its course error theta
obey e' = theta and theta' = b u, where u is the steering beyond what the bend takes. In steady state a
bicycle turns by b = 1 / (L + K v^2) per radian of steering (T. D. Gillespie, Fundamentals of Vehicle
Dynamics, SAE 1992, chapter 6); the understeer gradient K, slip angle of the front axle less that of the
rear one per lateral acceleration, is the soil's. Two states have a closed form for the gains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agents.controllers.protocol import Senses
from agents.controllers.speed_planner import BeliefSource, PlannerGains, SoilTracker
from agents.controllers.traction_limits import anticipated_slip

__all__ = ["LqrTracker", "LqrWeights", "path_gains"]

#: Lateral acceleration at which the understeer gradient is read from the table [m/s^2].
_GENTLE = 1.0


@dataclass(frozen=True, kw_only=True)
class LqrWeights:
    """Sizes that count as equally bad (A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975).

    Chosen on six tuning episodes each of `track` and `speed`.
    """

    cross_track: float = 0.25  #: [m]
    course: float = 0.2  #: [rad]
    steer: float = 0.1  #: [rad]


def path_gains(b: float, weights: LqrWeights) -> tuple[float, float]:
    """Gains (k_e [rad/m], k_theta [-]) of u = -k_e e - k_theta theta for e' = theta, theta' = b u.

    The cost is the integral of (e / e_0)^2 + (theta / theta_0)^2 + (u / u_0)^2 over the way. Its Riccati
    equation gives k_e = u_0 / e_0 and k_theta^2 = (u_0 / theta_0)^2 + 2 k_e / b.
    """
    k_e = weights.steer / weights.cross_track
    return k_e, math.sqrt((weights.steer / weights.course) ** 2 + 2.0 * k_e / b)


class LqrTracker(SoilTracker):
    """`SoilTracker` that steers by these gains instead of pure pursuit; its speed plan is the same.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`.
    weights
    """

    def __init__(
        self, believe: BeliefSource, gains: PlannerGains | None = None, *, weights: LqrWeights | None = None
    ) -> None:
        super().__init__(believe, gains)
        self.weights = weights or LqrWeights()

    def steer(self, senses: Senses, n: float, lateral: float) -> float:
        """Steering angle [rad] by LQR around the steady bend."""
        vehicle = self._briefing.vehicle
        speed, wheelbase = max(senses.speed, 0.0), vehicle.l_f + vehicle.l_r
        kappa, a = self.turn(senses, lateral)
        front, rear = anticipated_slip(self._capability.slip_table, n, a, self.gains.feed_forward)
        course_error = senses.heading_error - (rear - vehicle.l_r * kappa)
        # An oversteering vehicle has a speed at which it turns by itself: no gain is planned beyond.
        arm = max(wheelbase + self._understeer(n) * speed * speed, 0.5 * wheelbase)
        k_e, k_theta = path_gains(1.0 / arm, self.weights)
        bend = math.atan(wheelbase * kappa) + front - rear
        command: float = bend - k_e * senses.cross_track - k_theta * course_error
        return command

    def _understeer(self, n: float) -> float:
        """Slip angle of the front axle less that of the rear one per lateral acceleration [rad s^2/m]."""
        front, rear = self._capability.slip_angles(n, _GENTLE)
        return (front - rear) / _GENTLE
