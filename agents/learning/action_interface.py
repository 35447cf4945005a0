"""Action interfaces: what a learned policy's action means, from most help to none.

A decision fifty times a second is too often for a learner: the consequence of an action shows a second
later. An action of a policy is therefore held for a while, and its meaning depends on the interface.

``plan``: five times a second an offset to the tracker's steering, and a correction of n. In between, the
tracker and the speed plan of `agents.controllers.speed_planner` drive by that n. The tracking and the
traction limits at a known n are given; which soil it is, and how far to trust the estimate, is learnt. The
correction is added to the estimate where the policy has one, and to the prior's n of least grip otherwise:
the zero action drives as the aware arm without caution, or as the conservative arm.

``tracker``: five times a second an offset to the steering, and a speed. The path's geometry steers, without
any model of the soil: the speed that a bend allows is learnt. The zero action drives at 7.5 m/s.

``direct``: ten times a second steering and drive. The zero action rolls straight on to a stand.

``demand``: the same; the policy also sees what the path asks for at its speed: v^2 kappa ahead, and before a
line v^2 / (2 d).

``share``: the same; what the path asks for is also seen as a share of what the soil is believed to hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from agents.controllers.protocol import PathError
from agents.controllers.pure_pursuit import PursuitGains, goal_point, look_ahead
from agents.controllers.speed_control import SpeedGains, drive_share
from agents.controllers.speed_planner import (
    PathAhead,
    PlanLimits,
    PlannedMotion,
    curvature_in,
    path_ahead,
    path_steering,
    planned_motion,
)
from agents.controllers.stop_controller import stopped_motion
from agents.controllers.traction_limits import SlipAngles, SlipTable, anticipated_slip, soil_capability
from estimators.filters.online_soil_belief import BELIEF_VECTOR
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray, Vehicle
from offroad_env.simulation.soil_holds import REFERENCE_SPEED

__all__ = [
    "ACTION_INTERFACES",
    "ActionInterface",
    "Demand",
    "Direct",
    "PlanInterface",
    "Share",
    "TrackerInterface",
    "ZeroAction",
    "find_interface",
    "make_interface",
    "mirrored",
    "path_side",
]

#: Steering offset of an action of 1 [rad].
_STEER_RANGE = 0.1
#: Knobs of tracker and plan, about where the search for the arms with known n ends
#: (`agents.controllers.tuned`): share of the lateral limit, largest slip angle [rad], share of the slip
#: angles that is anticipated, of the braking.
_MARGIN, _SLIP_ANGLE, _FEED_FORWARD, _BRAKE_SHARE = 0.88, 0.29, 0.9, 1.2
#: Deceleration before a bend [m/s^2]: what every soil of the tasks gives beside some side force.
_SLOWING = 2.5
#: Time between a command and its effect [s], highest speed [m/s].
_LAG, _FASTEST = 0.25, 15.0
#: Distance to a line [m] below which, and deceleration [m/s^2] above which, no difference is shown.
_NEAREST, _HARDEST = 0.1, 15.0
#: Limits where nothing is known of the soil: middle and standard deviation of the population (150 soils,
#: docs/natural_benchmark.md): lateral acceleration [m/s^2], distance of a stop from `REFERENCE_SPEED` [m].
_NOMINAL = {"lateral": (5.6, 2.3), "stopping": (2.1, 0.9)}
#: Limit that no soil is taken to be below [m/s^2], and the largest share that is shown [-].
_LEAST_LIMIT, _LARGEST_SHARE = 0.5, 4.0
_AT = {name: BELIEF_VECTOR.index(name) for name in BELIEF_VECTOR}
#: Entries of the observation that change their sign in a mirror: lateral acceleration and yaw rate;
#: steering; distance and heading error from the path and its curvatures.
_LATERAL_SIGNALS = {"imu": [1, 4], "motion": [3], "path": [0, 1, *range(3, 11)]}


class _Course(NamedTuple):
    """What the compiled interfaces know of vehicle, path and controllers."""

    vehicle: Vehicle
    ahead: PathAhead
    pursuit: PursuitGains
    k_p: float  #: acceleration per speed error [1/s]
    zone: float  #: length of the zone before a line [m]; 0: there is none


class _Limits(NamedTuple):
    """Traction limits over n, from `agents.controllers.traction_limits.Capability`."""

    slip: SlipTable
    lateral: FloatArray  #: (D,) lateral limit [m/s^2]
    braking: FloatArray  #: (D,) [m/s^2]
    resistance: FloatArray  #: (D,) [N]


@kernel
def _planned(row: FloatArray, speed: float, lateral: float, braking: float, course: _Course) -> PlannedMotion:
    """The plan of the arms for a ``row`` of the observation's path."""
    limits = PlanLimits(_MARGIN * lateral, _SLOWING, _LAG, _FASTEST)
    motion = planned_motion(row[3:-1], speed, row[2], course.ahead, limits)
    if course.zone > 0.0:
        return stopped_motion(motion, row[-1], course.zone, speed, _BRAKE_SHARE * braking, _LAG)
    return motion


@kernel
def _steered(row: FloatArray, speed: float, kappa: float, slip: SlipAngles, course: _Course) -> float:
    """Steering angle [rad] onto the path, as `agents.controllers.speed_planner.SoilTracker` has it."""
    goal = goal_point(row[3:-1], course.ahead.preview, look_ahead(course.pursuit, speed))
    return path_steering(PathError(row[0], row[1]), goal, kappa, slip, course.vehicle)


@kernel
def _write(steer: float, acceleration: float, vehicle: Vehicle, out: FloatArray) -> None:
    """Fill ``out`` (2,) with the action for a steering angle [rad] and an acceleration [m/s^2]."""
    out[0] = min(max(steer / vehicle.steer_max, -1.0), 1.0)
    out[1] = min(max(drive_share(vehicle.m * acceleration, vehicle), -1.0), 1.0)


@kernel
def _follow_plan(
    path: FloatArray, motion: FloatArray, asked: FloatArray, course: _Course, table: _Limits, out: FloatArray
) -> None:
    """Fill ``out`` (N, 2) with the environment's actions for ``asked`` (N, 2): steering offset, and n."""
    for i in range(asked.shape[0]):
        speed, n = max(motion[i, 0], 0.0), asked[i, 1]
        lateral = np.interp(n, table.slip.grid, table.lateral)
        kappa = curvature_in(_LAG, speed, path[i, 3:-1], course.ahead.preview)
        a = min(max(speed * speed * kappa, -lateral), lateral)
        slip = anticipated_slip(table.slip, n, a, _FEED_FORWARD)
        steer = _steered(path[i], speed, kappa, slip, course) + _STEER_RANGE * asked[i, 0]
        braking = np.interp(n, table.slip.grid, table.braking)
        plan = _planned(path[i], speed, lateral, braking, course)
        resistance = np.interp(n, table.slip.grid, table.resistance) / course.vehicle.m
        push = plan.acceleration + course.k_p * (plan.speed - motion[i, 0]) + resistance
        _write(steer, push, course.vehicle, out[i])


@kernel
def _follow_speed(
    path: FloatArray, motion: FloatArray, asked: FloatArray, course: _Course, out: FloatArray
) -> None:
    """Fill ``out`` (N, 2) with the environment's actions for ``asked`` (N, 2): offset, and speed [m/s]."""
    straight = SlipAngles(0.0, 0.0)
    for i in range(asked.shape[0]):
        speed = max(motion[i, 0], 0.0)
        kappa = curvature_in(_LAG, speed, path[i, 3:-1], course.ahead.preview)
        steer = _steered(path[i], speed, kappa, straight, course) + _STEER_RANGE * asked[i, 0]
        _write(steer, course.k_p * (asked[i, 1] - motion[i, 0]), course.vehicle, out[i])


def path_side(observations: Mapping[str, np.ndarray]) -> np.ndarray:
    """(N,) 1 where the path turns left in the next 15 m, -1 where it turns right."""
    return np.where(observations["path"][..., 3:8].sum(axis=-1) < 0.0, -1.0, 1.0).astype(np.float32)


def mirrored(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The policy's observation: every bend as one to the left, since soil and vehicle have no sides."""
    seen = {key: np.array(value) for key, value in observations.items()}
    side = path_side(observations)[..., None]
    for key, columns in _LATERAL_SIGNALS.items():
        seen[key][..., columns] *= side
    return seen


def _unmirrored(observations: Mapping[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
    """The policy's actions (N, 2) with the first entry to the vehicle's left and not into the bend."""
    asked = np.array(actions, dtype=np.float64)
    asked[:, 0] *= path_side(observations)
    return asked


class ActionInterface(Protocol):
    """Turns actions of a policy into actions of the environment."""

    hold: int  #: control periods for which an action is held; one lasts 0.02 s

    def __init__(self, briefing: Any) -> None: ...

    def seen(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the policy sees of the environment's observations, of one row or of many."""

    def actions(self, observations: Mapping[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """Actions (N, 2) of the environment for the policy's ``actions`` (N, 2) in [-1, 1].

        ``observations`` are the environment's own; the first entry of an action points into the bend.
        """


class Direct:
    """The policy's action is steering and drive."""

    hold = 5

    def __init__(self, briefing: Any) -> None:
        """Needs nothing of the briefing."""

    def seen(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Mirrored."""
        return mirrored(observations)

    def actions(self, observations: Mapping[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """The actions, the first entry to the side of the bend."""
        return _unmirrored(observations, actions)


class Demand(Direct):
    """As `Direct`, and the policy sees what the path asks for at the speed of now.

    Parameters
    ----------
    briefing
        `offroad_env.environment.env.Briefing` of the task: whether there is a line to stop at.
    """

    def __init__(self, briefing: Any) -> None:
        super().__init__(briefing)
        self._stops = float(briefing.stop_zone) > 0.0

    def seen(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Mirrored, with a key "demand".

        Its entries are v^2 kappa for every curvature ahead [m/s^2]. Where there is a line at the distance d,
        two more: the deceleration v^2 / (2 d) that stops there [m/s^2], up to `_HARDEST`, and log(1 + d). Of
        90 m the last three decide: scaled by the spread of all of them, a tenth of a standard deviation
        would have to tell a stop in the zone from one beyond the line.
        """
        found = mirrored(observations)
        path, speed = found["path"], found["motion"][..., :1]
        parts = [speed**2 * path[..., 3:-1]]
        if self._stops:
            line = path[..., -1:]
            stop = np.clip(speed**2 / (2.0 * np.maximum(line, _NEAREST)), 0.0, _HARDEST)
            parts += [stop, np.sign(line) * np.log1p(np.abs(line))]
        found["demand"] = np.concatenate(parts, axis=-1).astype(np.float32)
        return found


def _limit(name: str, terrain: np.ndarray | None, deviations: float) -> np.ndarray:
    """(..., 1) a limit so many standard deviations above its mean, in logarithms; see `_NOMINAL`."""
    mean, sd = (np.array([value]) for value in _NOMINAL[name])
    if terrain is not None and terrain.shape[-1] == len(BELIEF_VECTOR):
        shown, spread = (terrain[..., _AT[key], None].astype(np.float64) for key in (name, f"{name}_sd"))
        known = (terrain[..., -1:] > 0.5) & np.isfinite(shown) & np.isfinite(spread)
        mean, sd = np.where(known, shown, mean), np.where(known, spread, sd)
    mean = np.maximum(mean, _LEAST_LIMIT)
    return np.asarray(np.maximum(mean * np.exp(deviations * sd / mean), _LEAST_LIMIT))


class Share(Demand):
    """As `Demand`, and the policy sees which share of the soil's limits that takes.

    A policy that is shown the demand and a limit has to learn their quotient, and of rare weak soils it has
    seen little. The limits are those of the key "terrain" where it holds what the soil holds, else the
    middle of the population, whatever the true soil.
    """

    def seen(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """As `Demand`, with a key "share".

        Its entries are v^2 kappa over the lateral limit for every curvature ahead, and the deceleration that
        stops at a line over that of the brakes, where there is a line: first with the means of the belief,
        then with what lies one standard deviation below. Up to `_LARGEST_SHARE`.
        """
        found = super().seen(observations)
        bends = found["path"].shape[-1] - 4
        demand = found["demand"].astype(np.float64)
        terrain, parts = found.get("terrain"), []
        for deviations in (0.0, 1.0):
            parts.append(demand[..., :bends] / _limit("lateral", terrain, -deviations))
            if self._stops:
                stopping = _limit("stopping", terrain, deviations)
                braking = REFERENCE_SPEED**2 / (2.0 * np.maximum(stopping, _NEAREST))
                parts.append(demand[..., bends : bends + 1] / np.maximum(braking, _LEAST_LIMIT))
        shares = np.concatenate(parts, axis=-1)
        found["share"] = np.clip(shares, -_LARGEST_SHARE, _LARGEST_SHARE).astype(np.float32)
        return found


class TrackerInterface:
    """Steers onto the path by geometry and drives at the speed of the action, without any model of the soil.

    Parameters
    ----------
    briefing
        `offroad_env.environment.env.Briefing` of the task: vehicle, preview distances, line.
    """

    hold = 10

    def __init__(self, briefing: Any) -> None:
        self._course = _Course(
            vehicle=briefing.vehicle,
            ahead=path_ahead(briefing.preview),
            pursuit=PursuitGains(),
            k_p=SpeedGains().k_p,
            zone=float(briefing.stop_zone),
        )

    def seen(self, observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Mirrored."""
        return mirrored(observations)

    def actions(self, observations: Mapping[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """As `ActionInterface`; the second entry is a speed, from standing (-1) to 15 m/s (1)."""
        asked = _unmirrored(observations, actions)
        asked[:, 1] = 0.5 * _FASTEST * (1.0 + asked[:, 1])
        out, (path, motion) = np.empty_like(asked), _path_and_motion(observations)
        _follow_speed(path, motion, asked, self._course, out)
        return out


class PlanInterface(TrackerInterface):
    """Tracker and speed plan of the arms, with an offset to the steering and a corrected n.

    Parameters
    ----------
    briefing
        `offroad_env.environment.env.Briefing` of the task: vehicle, soil, prior, preview distances, line.
    """

    def __init__(self, briefing: Any) -> None:
        super().__init__(briefing)
        self._prior = low, high = tuple(briefing.n_range)
        held = soil_capability(briefing.vehicle, briefing.soil, (low, high), briefing.shear)
        limits = np.array([held.lateral_limit(n, n, _SLIP_ANGLE) for n in held.grid])
        self._worst = held.worst_lateral(_SLIP_ANGLE)
        self._table = _Limits(held.slip_table, limits, held.braking, held.resistance)

    def assumed_n(self, observations: Mapping[str, np.ndarray], correction: np.ndarray) -> np.ndarray:
        """(N,) n to drive by: the estimate plus ``correction`` (N,) in widths of the prior."""
        low, high = self._prior
        n = np.full(len(correction), self._worst)
        if "terrain" in observations:
            terrain = np.asarray(observations["terrain"], dtype=np.float64)
            # A belief about whole soils and the true limits have n among other numbers.
            whole = terrain.shape[-1] == len(BELIEF_VECTOR)
            mean, valid = (terrain[:, _AT[name] if whole else at] for name, at in (("n", 0), ("valid", 2)))
            known = (valid > 0.5) & np.isfinite(mean)
            n[known] = np.clip(mean[known], low, high)
        return np.asarray(np.clip(n + (high - low) * correction, low, high))

    def actions(self, observations: Mapping[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """As `ActionInterface`; the second entry is as in `assumed_n`."""
        asked = _unmirrored(observations, actions)
        asked[:, 1] = self.assumed_n(observations, asked[:, 1])
        out, (path, motion) = np.empty_like(asked), _path_and_motion(observations)
        _follow_plan(path, motion, asked, self._course, self._table, out)
        return out


def _path_and_motion(observations: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The entries of the observation that the kernels steer by."""
    return (
        np.asarray(observations["path"], dtype=np.float64),
        np.asarray(observations["motion"], dtype=np.float64),
    )


#: Action interfaces, from most help to none.
ACTION_INTERFACES: dict[str, type[ActionInterface]] = {
    "plan": PlanInterface,
    "tracker": TrackerInterface,
    "direct": Direct,
    "demand": Demand,
    "share": Share,
}
_ALIASES = {"pedals": "direct"}


def find_interface(name: str) -> type[ActionInterface]:
    """The action interface of that name.

    Raises
    ------
    InvalidParameter
        For a name that is not in `ACTION_INTERFACES`.
    """
    known = _ALIASES.get(name, name)
    if known not in ACTION_INTERFACES:
        raise InvalidParameter(
            f"action_interface must be one of {', '.join(ACTION_INTERFACES)}, got {name!r}"
        )
    return ACTION_INTERFACES[known]


def make_interface(name: str, briefing: Any) -> ActionInterface:
    """The action interface of that name for a briefed task; errors of `find_interface`."""
    return find_interface(name)(briefing)


class ZeroAction:
    """An agent whose action is zero: the action interface alone drives."""

    def __init__(self, action_interface: str = "plan") -> None:
        self._name = action_interface

    def reset(self, briefing: Any) -> None:
        """Make the interface for the task."""
        self._interface = make_interface(self._name, briefing)

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """Action (2,)."""
        rows = {key: np.asarray(value)[None] for key, value in observation.items()}
        action: np.ndarray = self._interface.actions(rows, np.zeros((1, 2)))[0]
        return action
