"""Guides: what stands between a learned policy's words and the vehicle, from most help to none.

Fifty times a second is too often for a learner: what an action was good for shows a second later. A word
of a policy holds for a while, and what it means depends on the guide.

``plan``: five times a second an offset to the tracker's steering, and which n to believe in, as a
correction of what is told. Between two words the tracker and the plan of `agents.speed_planner` drive by
that n. The tracker's skill is given, and so is what a soil of known n holds; which soil it is, and how far
to trust that, is left to be learnt. The correction is added to the estimate where the policy sees one, and
to the prior's end of least grip where it does not: who says nothing drives as the aware arm without
caution, or as the conservative arm.

``tracker``: five times a second an offset to the steering, and a speed. The path's geometry steers, and
nothing is known of the soil: what a bend holds is left to be learnt. Who says nothing drives at 7.5 m/s.

``pedals``: ten times a second steering and drive. Who says nothing rolls straight on to a stand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from agents.capability import slip_angle_sizes, soil_capability
from agents.pure_pursuit import PursuitGains, goal_point, pursuit_curvature
from agents.speed_control import SpeedGains
from agents.speed_planner import planned_speed
from agents.stop_controller import stopping_speed
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel

__all__ = ["GUIDES", "Guide", "Pedals", "Planner", "Silent", "Tracker", "make_guide", "mirrored", "path_side"]

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
def _curvature(row, speed, plan):
    """Curvature of the path [1/m] where the vehicle is when a command takes effect."""
    return np.interp(_LAG * speed, plan[0], row[3:-1])


@kernel
def _slip_angles(a, n, lateral, table):
    """(front, rear) slip angles [rad] to anticipate in a bend that takes the acceleration ``a`` [m/s^2].

    ``lateral`` is the limit of the soil believed in [m/s^2], ``table`` that of its slip angles.
    """
    grid, angles, side = table
    a = min(max(a, -lateral), lateral)
    sizes = slip_angle_sizes(grid, angles, side, n, abs(a))
    share = _FEED_FORWARD if a >= 0.0 else -_FEED_FORWARD
    return share * sizes[0], share * sizes[1]


@kernel
def _steered(row, speed, kappa, slip, plan, car, gains):
    """Steering angle [rad] onto the path, as `agents.speed_planner.SoilTracker` has it.

    ``slip`` = (front, rear) slip angles [rad] that are anticipated.
    """
    front, rear = slip
    goal = goal_point(row[3:-1], plan[0], min(max(gains[0] * speed, gains[1]), gains[2]))
    wanted = pursuit_curvature(row[0], row[1] - (rear - car[1] * kappa), goal)
    return math.atan(car[0] * wanted) + front - rear


@kernel
def _write(steer, push, car, out):
    """Fill ``out`` (2,) with the action for a steering angle [rad] and an acceleration [m/s^2]."""
    drive = push * (car[3] if push > 0.0 else car[4])
    out[0] = min(max(steer / car[2], -1.0), 1.0)
    out[1] = min(max(drive, -1.0), 1.0)


@kernel
def _follow_plan(path, motion, words, plan, car, gains, table, out):
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
        kappa = _curvature(path[i], speed, plan)
        slip = _slip_angles(speed * speed * kappa, n, lateral, (grid, angles, side))
        steer = _steered(path[i], speed, kappa, slip, plan, car, gains) + _STEER_RANGE * words[i, 0]
        holds = (lateral, np.interp(n, grid, braking))
        target, acceleration = _wanted(path[i], speed, holds, plan)
        push = acceleration + gains[3] * (target - motion[i, 0]) + np.interp(n, grid, resistance) / car[5]
        _write(steer, push, car, out[i])


@kernel
def _follow_speed(path, motion, words, plan, car, gains, out):
    """Fill ``out`` (N, 2) with the actions that follow ``words`` (N, 2): an offset, and a speed [m/s].

    The other arguments are those of `_follow_plan`.
    """
    for i in range(words.shape[0]):
        speed = max(motion[i, 0], 0.0)
        kappa = _curvature(path[i], speed, plan)
        steer = _steered(path[i], speed, kappa, (0.0, 0.0), plan, car, gains) + _STEER_RANGE * words[i, 0]
        _write(steer, gains[3] * (words[i, 1] - motion[i, 0]), car, out[i])


def path_side(observations: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N,) 1 where the path turns left in the next 15 m, -1 where it turns right."""
    return np.where(observations["path"][..., 3:8].sum(axis=-1) < 0.0, -1.0, 1.0).astype(np.float32)


def mirrored(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the policy sees: every bend as one to the left, since soil and vehicle have no sides."""
    seen = {key: np.array(value) for key, value in observations.items()}
    side = path_side(observations)[..., None]
    for key, columns in _LATERAL_SIGNALS.items():
        seen[key][..., columns] *= side
    return seen


def _said(observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
    """The words (N, 2) with the first one to the vehicle's left and not into the bend."""
    said = np.array(words, dtype=np.float64)
    said[:, 0] *= path_side(observations)
    return said


class Guide(Protocol):
    """What stands between a policy's words and the vehicle."""

    hold: int  #: control periods for which a word holds; one lasts 0.02 s

    def __init__(self, briefing: Any) -> None: ...

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """Actions (N, 2) of the environment that follow the policy's ``words`` (N, 2) in [-1, 1].

        ``observations`` are the environment's own; the first word is one into the bend.
        """


class Pedals:
    """No help: the words are steering and drive."""

    hold = 5

    def __init__(self, briefing: Any) -> None:
        """Nothing that the briefing says is needed."""

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """The words, the first one to the side of the bend."""
        return _said(observations, words)


class Tracker:
    """Steers onto the path by geometry and drives at the speed it is told: it knows nothing of the soil.

    Parameters
    ----------
    briefing
        `offroad_env.env.Briefing` of the task: vehicle, preview distances, line.
    """

    hold = 10

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

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """As `Guide` has it; the second word is a speed, from standing (-1) to 15 m/s (1)."""
        said = _said(observations, words)
        said[:, 1] = 0.5 * _FASTEST * (1.0 + said[:, 1])
        out, (path, motion) = np.empty_like(said), _followed(observations)
        _follow_speed(path, motion, said, self._plan, self._car, self._gains, out)
        return out


class Planner(Tracker):
    """Tracker and speed plan of the arms, told where to go a little differently and what n to believe.

    Parameters
    ----------
    briefing
        `offroad_env.env.Briefing` of the task: vehicle, soil, prior, preview distances, line.
    """

    def __init__(self, briefing: Any) -> None:
        super().__init__(briefing)
        self._prior = low, high = tuple(briefing.n_range)
        held = soil_capability(briefing.vehicle, briefing.soil, (low, high), briefing.shear)
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

    def actions(self, observations: Mapping[str, np.ndarray], words: np.ndarray) -> np.ndarray:
        """As `Guide` has it; the second word is as in `believed`."""
        said = _said(observations, words)
        said[:, 1] = self.believed(observations, said[:, 1])
        out, (path, motion) = np.empty_like(said), _followed(observations)
        _follow_plan(path, motion, said, self._plan, self._car, self._gains, self._table, out)
        return out


def _followed(observations: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What the kernels steer by: path and motion."""
    return (
        np.asarray(observations["path"], dtype=np.float64),
        np.asarray(observations["motion"], dtype=np.float64),
    )


#: What may stand between a policy and the vehicle, from most help to none.
GUIDES: dict[str, type[Guide]] = {"plan": Planner, "tracker": Tracker, "pedals": Pedals}


def make_guide(name: str, briefing: Any) -> Guide:
    """The guide of that name.

    Raises
    ------
    InvalidParameter
        For a name that is not in `GUIDES`.
    """
    if name not in GUIDES:
        raise InvalidParameter(f"guide must be one of {', '.join(GUIDES)}, got {name!r}")
    return GUIDES[name](briefing)


class Silent:
    """An agent that says nothing: what a guide does by itself."""

    def __init__(self, guide: str = "plan") -> None:
        self._name = guide

    def reset(self, briefing: Any) -> None:
        """Meet the guide."""
        self._guide = make_guide(self._name, briefing)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Action (2,)."""
        rows = {key: np.asarray(value)[None] for key, value in observation.items()}
        return self._guide.actions(rows, np.zeros((1, 2)))[0]
