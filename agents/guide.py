"""A belief instead of pedals: what a learned policy steers by when a tracker drives for it.

Fifty times a second is too often for a learner: what an action was good for shows a second later. A
guided policy speaks five times a second and says two things: an offset to the tracker's steering, and
which n to believe in, as a correction of what it is told. Between two words the tracker and the plan of
`agents.speed_planner` drive by that n. The tracker's skill is given, and so is what a soil of known n
holds; which soil it is, and how far to trust that, is left to be learnt.

The correction is added to the estimate where the policy sees one, and to the prior's end of least grip
where it does not: who says nothing drives as the aware arm without caution, or as the conservative arm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.capability import slip_angle_sizes, soil_capability
from agents.pure_pursuit import PursuitGains, goal_point, pursuit_curvature
from agents.speed_control import SpeedGains
from agents.speed_planner import planned_speed
from agents.stop_controller import stopping_speed
from offroad_env.physics._jit import kernel

__all__ = ["HOLD", "Guide", "Silent"]

#: Control periods for which a word of the policy holds: 0.2 s.
HOLD = 10
#: Steering offset of the word 1 [rad].
_STEER_RANGE = 0.1
#: Knobs of tracker and plan, about where the search for the arms that know n ends (`agents.tuned`): share of
#: the lateral limit, largest slip angle [rad], share of the slip angles that is anticipated, of the braking.
_MARGIN, _SLIP_ANGLE, _FEED_FORWARD, _BRAKE_SHARE = 0.88, 0.29, 0.9, 1.2
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
def _wanted(row, speed, holds, plan):
    """(speed [m/s], acceleration [m/s^2]) of the plan for a ``row`` of the observation's path.

    ``holds`` = (lateral acceleration, deceleration) of the soil believed in [m/s^2].
    """
    preview, stations, zone = plan
    kappa = np.abs(np.interp(stations, preview, row[3:-1]))
    limits = np.minimum(np.sqrt(_MARGIN * holds[0] / np.maximum(kappa, _STRAIGHT)), _FASTEST)
    ahead = _LAG * speed
    target = planned_speed(limits, stations, _SLOWING, ahead)
    later = planned_speed(limits, stations, _SLOWING, ahead + _STEP)
    acceleration = max((later * later - target * target) / (2.0 * _STEP), -_SLOWING)
    if 0.0 < row[2] < target:
        target, acceleration = row[2], 0.0
    if zone > 0.0:
        braking = _BRAKE_SHARE * holds[1]
        allowed = stopping_speed(row[-1], zone, speed, braking, _LAG)
        if allowed < target:
            target, acceleration = allowed, -braking
    return target, acceleration


@kernel
def _steered(row, speed, slip, plan, car, gains):
    """Steering angle [rad] onto the path, as `agents.speed_planner.SoilTracker` has it.

    ``slip`` = (n, lateral limit [m/s^2], table of the slip angles).
    """
    n, lateral, (grid, angles, side) = slip
    kappa = np.interp(_LAG * speed, plan[0], row[3:-1])
    a = min(max(speed * speed * kappa, -lateral), lateral)
    sizes = slip_angle_sizes(grid, angles, side, n, abs(a))
    share = _FEED_FORWARD if a >= 0.0 else -_FEED_FORWARD
    front, rear = share * sizes[0], share * sizes[1]
    goal = goal_point(row[3:-1], plan[0], min(max(gains[0] * speed, gains[1]), gains[2]))
    wanted = pursuit_curvature(row[0], row[1] - (rear - car[1] * kappa), goal)
    return math.atan(car[0] * wanted) + front - rear


@kernel
def _follow(path, motion, words, plan, car, gains, table, out):
    """Fill ``out`` (N, 2) with the actions that follow ``words`` (N, 2): an offset, and n.

    ``plan`` = (preview distances [m], stations [m], zone before the line [m]), ``car`` = (wheelbase [m],
    of it behind the centre of mass [m], steering range [rad], m r / largest drive torque [s^2/m], the same
    of the brakes, mass [kg]), ``gains`` = (look-ahead time [s], shortest, longest [m], acceleration per
    speed error [1/s]), ``table`` = (grid of n, lateral limits, braking [m/s^2], resistance [N], slip
    angles [rad], lateral acceleration that each axle holds at them [m/s^2]).
    """
    grid, limits, braking, resistance, angles, side = table
    for i in range(words.shape[0]):
        speed, n = max(motion[i, 0], 0.0), words[i, 1]
        lateral = np.interp(n, grid, limits)
        slip = (n, lateral, (grid, angles, side))
        steer = _steered(path[i], speed, slip, plan, car, gains) + _STEER_RANGE * words[i, 0]
        holds = (lateral, np.interp(n, grid, braking))
        target, acceleration = _wanted(path[i], speed, holds, plan)
        push = acceleration + gains[3] * (target - motion[i, 0]) + np.interp(n, grid, resistance) / car[5]
        drive = push * (car[3] if push > 0.0 else car[4])
        out[i, 0] = min(max(steer / car[2], -1.0), 1.0)
        out[i, 1] = min(max(drive, -1.0), 1.0)


class Guide:
    """The tracker and speed plan of the arms, told where to go a little differently and what n to believe.

    Parameters
    ----------
    briefing
        `offroad_env.env.Briefing` of the task: vehicle, soil, prior, preview distances, line.
    """

    def __init__(self, briefing: Any) -> None:
        v, pursuit = briefing.vehicle, PursuitGains()
        inertia = v.m * v.r
        self._car = (
            v.l_f + v.l_r,
            v.l_r,
            v.steer_max,
            inertia / v.drive_torque_max,
            inertia / v.brake_torque_max,
            v.m,
        )
        self._gains = (pursuit.time, pursuit.shortest, pursuit.longest, SpeedGains().k_p)
        preview = np.asarray(briefing.preview, dtype=np.float64)
        stations = np.arange(0.0, preview[-1] + 0.5 * _STEP, _STEP)
        self._plan = (preview, stations, float(briefing.stop_zone))
        self._prior = low, high = tuple(briefing.n_range)
        held = soil_capability(v, briefing.soil, (low, high), briefing.shear)
        limits = np.array([held.lateral_limit(n, n, _SLIP_ANGLE) for n in held.grid])
        self._worst = held.worst_lateral(_SLIP_ANGLE)
        self._table = (held.grid, limits, held.braking, held.resistance, held.angles, held.side)

    def believed(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """(N,) n that ``words`` (N,) ask to believe in: 1 is the width of the prior above what is told."""
        low, high = self._prior
        told = np.full(len(words), self._worst)
        if "terrain" in observations:
            mean, _, valid = np.asarray(observations["terrain"], dtype=np.float64).T
            known = (valid > 0.5) & np.isfinite(mean)
            told[known] = np.clip(mean[known], low, high)
        return np.clip(told + (high - low) * words, low, high)

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

        ``observations`` are the environment's own; the first word is an offset into the bend, the second
        one as in `believed`.
        """
        out = np.empty((len(words), 2))
        path, motion = (np.asarray(observations[key], dtype=np.float64) for key in ("path", "motion"))
        said = np.array(words, dtype=np.float64)
        said[:, 0] *= self.side(observations)
        said[:, 1] = self.believed(observations, said[:, 1])
        _follow(path, motion, said, self._plan, self._car, self._gains, self._table, out)
        return out


class Silent:
    """An agent that says nothing: what the guide does by itself."""

    def reset(self, briefing: Any) -> None:
        """Meet the guide."""
        self._guide = Guide(briefing)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Action (2,)."""
        rows = {key: np.asarray(value)[None] for key, value in observation.items()}
        return self._guide.actions(rows, np.zeros((1, 2)))[0]
