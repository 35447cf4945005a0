"""Trust instead of pedals: what a learned policy steers by when a tracker drives for it.

Fifty times a second is too often for a learner: what an action was good for shows a second later. A
guided policy speaks five times a second and says two things: an offset to pure pursuit's steering, and how
much it trusts the soil, as the lateral acceleration that a bend may take and the deceleration before a
line. Between two words pure pursuit and the speed plan of `agents.speed_planner` drive by them. The
tracker's skill is given; what the soil holds is left to be learnt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.pure_pursuit import PursuitGains, goal_point, pursuit_curvature
from agents.speed_control import SpeedGains
from agents.speed_planner import planned_speed
from agents.stop_controller import stopping_speed
from offroad_env.physics._jit import kernel

__all__ = ["HOLD", "Guide"]

#: Control periods for which a word of the policy holds: 0.2 s.
HOLD = 10
#: Steering offset of the word 1 [rad].
_STEER_RANGE = 0.1
#: Lateral acceleration at the word 0 [m/s^2], and by how much the words -1 and 1 divide or multiply it.
_LATERAL, _LATERAL_FACTOR = 1.4, 3.0
#: The same of the deceleration before a line.
_STOPPING, _STOPPING_FACTOR = 5.0, 2.0
#: Deceleration before a bend [m/s^2]: what every soil of the tasks gives beside some side force.
_SLOWING = 2.5
#: Spacing of the stations of the plan [m], time between a command and its effect [s], highest speed [m/s].
_STEP, _LAG, _FASTEST = 1.0, 0.25, 15.0
#: Entries of the observation that change their sign in a mirror: lateral acceleration and yaw rate;
#: steering; distance and heading error from the path and its curvatures.
_LATERAL_SIGNALS = {"imu": [1, 4], "motion": [3], "path": [0, 1, *range(3, 11)]}
#: Curvature below which a path counts as straight [1/m].
_STRAIGHT = 1e-4


@kernel
def _wanted(row, speed, trust, plan):
    """(speed [m/s], acceleration [m/s^2]) of the plan for a ``row`` of the observation's path."""
    preview, stations, zone = plan
    lateral = _LATERAL * _LATERAL_FACTOR**trust
    kappa = np.abs(np.interp(stations, preview, row[3:-1]))
    limits = np.minimum(np.sqrt(lateral / np.maximum(kappa, _STRAIGHT)), _FASTEST)
    ahead = _LAG * speed
    target = planned_speed(limits, stations, _SLOWING, ahead)
    later = planned_speed(limits, stations, _SLOWING, ahead + _STEP)
    acceleration = max((later * later - target * target) / (2.0 * _STEP), -_SLOWING)
    if 0.0 < row[2] < target:
        target, acceleration = row[2], 0.0
    if zone > 0.0:
        braking = _STOPPING * _STOPPING_FACTOR**trust
        allowed = stopping_speed(row[-1], zone, speed, braking, _LAG)
        if allowed < target:
            target, acceleration = allowed, -braking
    return target, acceleration


@kernel
def _follow(path, motion, words, plan, car, gains, out):
    """Fill ``out`` (N, 2) with the actions that follow ``words`` (N, 2).

    ``plan`` = (preview distances [m], stations [m], zone before the line [m]), ``car`` = (wheelbase [m],
    steering range [rad], m r / largest drive torque [s^2/m], the same of the brakes), ``gains`` =
    (look-ahead time [s], shortest, longest [m], acceleration per speed error [1/s]).
    """
    for i in range(words.shape[0]):
        speed = max(motion[i, 0], 0.0)
        goal = goal_point(path[i, 3:-1], plan[0], min(max(gains[0] * speed, gains[1]), gains[2]))
        kappa = pursuit_curvature(path[i, 0], path[i, 1], goal)
        steer = math.atan(car[0] * kappa) + _STEER_RANGE * words[i, 0]
        target, acceleration = _wanted(path[i], speed, words[i, 1], plan)
        push = acceleration + gains[3] * (target - motion[i, 0])
        drive = push * (car[2] if push > 0.0 else car[3])
        out[i, 0] = min(max(steer / car[1], -1.0), 1.0)
        out[i, 1] = min(max(drive, -1.0), 1.0)


class Guide:
    """Pure pursuit with a speed plan, told where to go a little differently and what the soil holds.

    Parameters
    ----------
    briefing
        `offroad_env.env.Briefing` of the task: vehicle, preview distances, line.
    """

    def __init__(self, briefing: Any) -> None:
        v, pursuit = briefing.vehicle, PursuitGains()
        inertia = v.m * v.r
        self._car = (
            v.l_f + v.l_r,
            v.steer_max,
            inertia / v.drive_torque_max,
            inertia / v.brake_torque_max,
        )
        self._gains = (pursuit.time, pursuit.shortest, pursuit.longest, SpeedGains().k_p)
        preview = np.asarray(briefing.preview, dtype=np.float64)
        stations = np.arange(0.0, preview[-1] + 0.5 * _STEP, _STEP)
        self._plan = (preview, stations, float(briefing.stop_zone))

    @staticmethod
    def side(observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N,) 1 where the path turns left in the next 15 m, -1 where it turns right."""
        return np.where(observations["path"][..., 3:8].sum(axis=-1) < 0.0, -1.0, 1.0).astype(np.float32)

    @classmethod
    def mirrored(cls, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the policy sees: every bend as one to the left, since soil and vehicle have no sides."""
        seen = {key: np.array(value) for key, value in observations.items()}
        side = cls.side(observations)[..., None]
        for key, columns in _LATERAL_SIGNALS.items():
            seen[key][..., columns] *= side
        return seen

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """Actions (N, 2) of the environment that follow the policy's ``words`` (N, 2) in [-1, 1].

        ``observations`` are the environment's own; the first word is an offset into the bend.
        """
        out = np.empty((len(words), 2))
        path, motion = (np.asarray(observations[key], dtype=np.float64) for key in ("path", "motion"))
        said = np.array(words, dtype=np.float64)
        said[:, 0] *= self.side(observations)
        _follow(path, motion, said, self._plan, self._car, self._gains, out)
        return out
