"""Set points instead of pedals: what a learned policy steers by when a tracker drives for it.

Fifty times a second is too often for a learner: what an action was good for shows a second later. A
guided policy speaks ten times a second and says two things, an offset to pure pursuit's steering and a
speed; between two words the tracker follows them. A policy that says nothing thus drives like pure
pursuit at 5 m/s, whatever it knows of the soil: it has the tracker's skill and must learn the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from agents.pure_pursuit import PursuitGains, goal_point, pursuit_curvature
from agents.speed_control import SpeedGains
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import Vehicle

__all__ = ["HOLD", "Guide"]

#: Control periods for which a word of the policy holds: 0.1 s.
HOLD = 5
#: Speed of the action 0, and what the actions -1 and 1 add to it [m/s].
_SPEED, _SPEED_RANGE = 5.0, 5.0
#: Steering offset of the action 1 [rad].
_STEER_RANGE = 0.15


@kernel
def _follow(path, motion, preview, words, car, gains, out):
    """Fill ``out`` (N, 2) with the actions that follow ``words`` (N, 2).

    ``car`` = (wheelbase [m], steering range [rad], m r / largest drive torque [s^2/m], the same of the
    brakes), ``gains`` = (look-ahead time [s], shortest, longest [m], acceleration per speed error [1/s]).
    """
    for i in range(words.shape[0]):
        speed = max(motion[i, 0], 0.0)
        ahead = min(max(gains[0] * speed, gains[1]), gains[2])
        goal = goal_point(path[i, 3:-1], preview, ahead)
        kappa = pursuit_curvature(path[i, 0], path[i, 1], goal)
        steer = math.atan(car[0] * kappa) + _STEER_RANGE * words[i, 0]
        wanted = gains[3] * (_SPEED + _SPEED_RANGE * words[i, 1] - motion[i, 0])
        drive = wanted * (car[2] if wanted > 0.0 else car[3])
        out[i, 0] = min(max(steer / car[1], -1.0), 1.0)
        out[i, 1] = min(max(drive, -1.0), 1.0)


class Guide:
    """Pure pursuit with a proportional speed loop, told where to go a little differently, and how fast.

    Parameters
    ----------
    vehicle
        What it believes to drive.
    preview
        Distances of the observed curvatures [m].
    """

    def __init__(self, vehicle: Vehicle, preview: tuple[float, ...]) -> None:
        v, pursuit = vehicle, PursuitGains()
        self._car = (
            v.l_f + v.l_r,
            v.steer_max,
            v.m * v.r / v.drive_torque_max,
            v.m * v.r / v.brake_torque_max,
        )
        self._gains = (pursuit.time, pursuit.shortest, pursuit.longest, SpeedGains().k_p)
        self._preview = np.asarray(preview, dtype=np.float64)

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """Actions (N, 2) of the environment that follow the policy's ``words`` (N, 2) in [-1, 1]."""
        out = np.empty((len(words), 2))
        path, motion = (np.asarray(observations[key], dtype=np.float64) for key in ("path", "motion"))
        _follow(path, motion, self._preview, np.asarray(words, np.float64), self._car, self._gains, out)
        return out
