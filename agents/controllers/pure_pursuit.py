"""Pure pursuit: steer onto the circle through a point of the path ahead.

R. C. Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, CMU-RI-TR-92-01, 1992.
Here the goal point is built from what the vehicle senses - cross-track error, heading error and
the curvature ahead - so no position in a global frame is needed.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.protocol import Observation, read_senses, to_action
from agents.controllers.speed_control import SpeedController, gentle_target
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray

__all__ = ["GoalPoint", "PurePursuitAgent", "PursuitGains", "goal_point", "look_ahead", "pursuit_curvature"]

#: Spacing of the points by which the path ahead is integrated [m].
_STEP = 0.5


class PursuitGains(NamedTuple):
    """The look-ahead distance grows with speed, which keeps the look-ahead time bounded."""

    time: float = 0.6  #: look-ahead per speed [s]
    shortest: float = 3.0  #: [m]
    longest: float = 15.0  #: [m]


class GoalPoint(NamedTuple):
    """A point of the path ahead, in axes along the path at the point nearest to the vehicle."""

    x: float  #: [m]
    y: float  #: [m]
    yaw: float  #: direction of the path there [rad]


@kernel
def look_ahead(gains: PursuitGains, speed: float) -> float:
    """Look-ahead distance along the path [m]."""
    return min(max(gains.time * speed, gains.shortest), gains.longest)


@kernel
def goal_point(curvature: FloatArray, preview: FloatArray, distance: float) -> GoalPoint:
    """The path at an arc length ahead, in axes along the path at its nearest point.

    Yaw is the integral of the curvature, linear between the preview points; position is the
    integral of (cos yaw, sin yaw), both by the trapezoidal rule.

    Parameters
    ----------
    curvature : array (P,)
        [1/m], left positive.
    preview : array (P,)
        Arc lengths of the curvature values [m], ascending from 0.
    distance : float
        Arc length ahead [m].

    Returns
    -------
    GoalPoint
    """
    cells = max(math.ceil(distance / _STEP), 1)
    ds = distance / cells
    x = y = yaw = 0.0
    kappa, last = curvature[0], 0
    for i in range(1, cells + 1):
        s = i * ds
        while last < preview.shape[0] - 2 and preview[last + 1] < s:
            last += 1
        share = min((s - preview[last]) / (preview[last + 1] - preview[last]), 1.0)
        ahead = curvature[last] + share * (curvature[last + 1] - curvature[last])
        before = yaw
        yaw += 0.5 * ds * (kappa + ahead)
        x += 0.5 * ds * (math.cos(before) + math.cos(yaw))
        y += 0.5 * ds * (math.sin(before) + math.sin(yaw))
        kappa = ahead
    return GoalPoint(x, y, yaw)


@kernel
def pursuit_curvature(cross_track: float, course_error: float, goal: GoalPoint) -> float:
    """Curvature [1/m] of the circle that leaves along the course and passes the goal point.

    With y' the goal point's distance to the left of the course and D its distance,
    curvature = 2 y' / D^2 (Coulter 1992, section 2).

    Parameters
    ----------
    cross_track : float
        Distance left of the path [m].
    course_error : float
        Direction in which the vehicle points or moves, less the path's [rad].
    goal : GoalPoint
        From `goal_point`.
    """
    dx, dy = goal.x, goal.y - cross_track
    left = dy * math.cos(course_error) - dx * math.sin(course_error)
    return 2.0 * left / (dx * dx + dy * dy)


class PurePursuitAgent:
    """Pure pursuit with a speed PI, without any model of the soil.

    Parameters
    ----------
    speed
        Speed to hold where the task gives none [m/s].
    gains
    """

    def __init__(self, *, speed: float = 4.0, gains: PursuitGains | None = None) -> None:
        self.speed = speed
        self.gains = gains or PursuitGains()

    def reset(self, briefing: Any) -> None:
        """Take vehicle, preview distances and control interval from the briefing."""
        self._wheelbase = briefing.vehicle.l_f + briefing.vehicle.l_r
        self._steer_range = briefing.vehicle.steer_max
        self._preview = np.asarray(briefing.preview, dtype=np.float64)
        self._speed_control = SpeedController(briefing.vehicle, briefing.dt)
        self._stop_zone = briefing.stop_zone

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        goal = goal_point(senses.curvature, self._preview, look_ahead(self.gains, senses.speed))
        kappa = pursuit_curvature(senses.cross_track, senses.heading_error, goal)
        target = gentle_target(senses.target_speed or self.speed, senses.distance, self._stop_zone)
        drive = self._speed_control.command(target, senses.speed, rim_speed=max(senses.rim_speed))
        return to_action(math.atan(self._wheelbase * kappa), drive, self._steer_range)
