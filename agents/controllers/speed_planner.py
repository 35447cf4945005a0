"""Speed plan from the traction limits at an assumed n, and the tracker that drives it.

The plan is the classical two-pass speed profile on the previewed curvature: the soil's lateral
acceleration limits the speed in every bend, its braking how early to slow down for it
(N. R. Kapania, J. Subosits, J. C. Gerdes, A sequential two-step algorithm for fast generation of
vehicle racing trajectories, J. Dyn. Sys. Meas. Control 138, 2016, section 3). The forward pass is
left to the vehicle: it takes what drive force it has.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.protocol import Observation, PathError, Senses, read_senses, to_action
from agents.controllers.pure_pursuit import GoalPoint, PursuitGains, goal_point, look_ahead, pursuit_curvature
from agents.controllers.speed_control import SpeedController, SpeedGains
from agents.controllers.traction_limits import Capability, SlipAngles, anticipated_slip, soil_capability
from offroad_env.physics._jit import kernel
from offroad_env.physics.records import FloatArray, Vehicle

__all__ = [
    "Belief",
    "BeliefSource",
    "PathAhead",
    "PlanLimits",
    "PlannedMotion",
    "PlannerGains",
    "SoilTracker",
    "curvature_in",
    "limits_over_n",
    "path_ahead",
    "path_steering",
    "planned_motion",
    "planned_speed",
    "speed_limit",
]

#: Spacing of the points of the plan [m].
_STEP = 1.0
#: Curvature below which a path counts as straight [1/m]; avoids dividing by zero.
_STRAIGHT = 1e-4


class Belief(NamedTuple):
    """The n that a controller assumes: a best value, and an interval whose worst value it must survive."""

    low: float
    mean: float
    high: float


#: ``believe(briefing, capability, observation)`` -> `Belief`.
BeliefSource = Callable[[Any, Capability, Observation], Belief]


@dataclass(frozen=True, kw_only=True)
class PlannerGains:
    """Caution and timing of plan and tracker."""

    margin: float = 0.8  #: share of the soil's lateral acceleration that is used [-]
    slip_angle: float = 0.2  #: largest slip angle that the plan allows either axle [rad]
    brake_share: float = 0.5  #: share of the soil's braking that is used [-]
    feed_forward: float = 1.0  #: share of the soil's slip angles that the steering anticipates [-]
    turning: bool = False  #: whether the drive anticipates what a bend resists beyond the straight
    lag: float = 0.25  #: time between a command and its effect [s]
    speed_max: float = 15.0  #: highest speed on any path [m/s]
    pursuit: PursuitGains = field(default_factory=PursuitGains)
    speed: SpeedGains = field(default_factory=SpeedGains)


class PathAhead(NamedTuple):
    """Arc lengths ahead of the vehicle at which a path is known, and at which its speed is planned."""

    preview: FloatArray  #: (P,) of the curvatures of an observation [m], ascending from 0
    stations: FloatArray  #: (S,) of the speed plan [m], ascending from 0


class PlanLimits(NamedTuple):
    """Limits of the speed plan."""

    lateral: float  #: lateral acceleration that is used [m/s^2]
    braking: float  #: deceleration that is used [m/s^2]
    lag: float  #: time between a command and its effect [s]
    speed_max: float  #: highest speed on any path [m/s]


class PlannedMotion(NamedTuple):
    """What the plan asks for now."""

    speed: float  #: [m/s]
    acceleration: float  #: [m/s^2]


def path_ahead(preview: FloatArray) -> PathAhead:
    """Stations every metre as far as the preview distances [m] reach."""
    preview = np.asarray(preview, dtype=np.float64)
    return PathAhead(preview, np.arange(0.0, preview[-1] + 0.5 * _STEP, _STEP))


@kernel
def speed_limit(curvature: FloatArray, lateral: float, speed_max: float) -> FloatArray:
    """Speed [m/s] at which the path of that curvature [1/m] takes the acceleration ``lateral``.

    v = sqrt(lateral / |kappa|), at most ``speed_max``.
    """
    return np.minimum(np.sqrt(lateral / np.maximum(np.abs(curvature), _STRAIGHT)), speed_max)


@kernel
def planned_speed(limits: FloatArray, stations: FloatArray, braking: float, at: float) -> float:
    """Highest speed [m/s] at station ``at`` from which every later limit can be met.

    Backward pass with constant deceleration in closed form: v^2 = min over the stations s_i ahead
    of v_i^2 + 2 braking (s_i - at). At the last station the vehicle must be able to stand, since
    what follows is unknown.

    Parameters
    ----------
    limits : array (S,)
        Speed limits [m/s].
    stations : array (S,)
        Where they hold [m], ascending.
    braking : float
        Deceleration [m/s^2].
    at : float
        Station of the wanted speed [m].
    """
    last = stations.shape[0] - 1
    least = 2.0 * braking * max(stations[last] - at, 0.0)
    for i in range(last):
        if stations[i] >= at - _STEP:
            least = min(least, limits[i] * limits[i] + 2.0 * braking * max(stations[i] - at, 0.0))
    return math.sqrt(least)


@kernel
def planned_motion(
    curvature: FloatArray, speed: float, asked: float, ahead: PathAhead, limits: PlanLimits
) -> PlannedMotion:
    """Speed and acceleration of the plan over the previewed ``curvature`` (P,) [1/m].

    ``asked`` [m/s] is a speed that the task gives; 0: as fast as possible.
    """
    at_stations = np.interp(ahead.stations, ahead.preview, curvature)
    highest = speed_limit(at_stations, limits.lateral, limits.speed_max)
    start = limits.lag * speed
    target = planned_speed(highest, ahead.stations, limits.braking, start)
    later = planned_speed(highest, ahead.stations, limits.braking, start + _STEP)
    if 0.0 < asked < target:
        return PlannedMotion(asked, 0.0)
    return PlannedMotion(target, max((later * later - target * target) / (2.0 * _STEP), -limits.braking))


@kernel
def curvature_in(time: float, speed: float, curvature: FloatArray, preview: FloatArray) -> float:
    """Curvature of the path [1/m] where the vehicle is after ``time`` [s] at this speed."""
    return np.interp(time * speed, preview, curvature)


@kernel
def path_steering(
    error: PathError, goal: GoalPoint, kappa: float, slip: SlipAngles, vehicle: Vehicle
) -> float:
    """Steering angle [rad] by pure pursuit around the slip angles of a steady bend, see `SoilTracker`."""
    course_error = error.heading - (slip.rear - vehicle.l_r * kappa)
    wanted = pursuit_curvature(error.cross_track, course_error, goal)
    return math.atan((vehicle.l_f + vehicle.l_r) * wanted) + slip.front - slip.rear


def limits_over_n(briefing: Any) -> Capability:
    """Traction limits of the briefed vehicle on the briefed soil over the prior of n (cached)."""
    return soil_capability(briefing.vehicle, briefing.soil, tuple(briefing.n_range), briefing.shear)


class SoilTracker:
    """Pure pursuit with feed-forward of the slip angles, at the planned speed.

    On soft soil a bend takes slip angles of many degrees at both axles. A tracker that ignores
    them sees a heading error where there is none and runs wide. In a steady bend of curvature
    kappa with lateral acceleration a = v^2 kappa and slip angles beta_f(a, n), beta_r(a, n) (sizes,
    of the sign of a), the course equals the path's direction when the heading error is
    beta_r - l_r kappa, and the front wheels stand at L kappa + beta_f - beta_r.

    Parameters
    ----------
    believe
        ``believe(briefing, capability, observation)`` -> `Belief`, asked at every step.
    gains
    """

    #: Drive slip at which the torque begins to be cut, in place of that of the gains [-].
    drive_slip_limit: float | None = None

    def __init__(self, believe: BeliefSource, gains: PlannerGains | None = None) -> None:
        self.believe = believe
        self.gains = gains or PlannerGains()
        #: ``tabulate(briefing)`` -> traction limits; what they run over is what ``believe`` believes.
        self.tabulate: Callable[[Any], Capability] = limits_over_n

    def reset(self, briefing: Any) -> None:
        """Tabulate the traction limits."""
        self._briefing = briefing
        self._capability = self.tabulate(briefing)
        self._ahead = path_ahead(briefing.preview)
        self._speed_control = SpeedController(briefing.vehicle, briefing.dt, self.gains.speed)

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        belief = self.believe(self._briefing, self._capability, observation)
        lateral = self._capability.lateral_limit(belief.low, belief.high, self.gains.slip_angle)
        steer = self.steer(senses, belief.mean, lateral)
        drive = self.drive(senses, belief, lateral)
        return to_action(steer, drive, self._briefing.vehicle.steer_max)

    def steer(self, senses: Senses, n: float, lateral: float) -> float:
        """Steering angle [rad]: pure pursuit around the slip angles of the bend."""
        kappa, a = self.turn(senses, lateral)
        slip = anticipated_slip(self._capability.slip_table, n, a, self.gains.feed_forward)
        distance = look_ahead(self.gains.pursuit, max(senses.speed, 0.0))
        goal = goal_point(senses.curvature, self._ahead.preview, distance)
        return path_steering(senses.error, goal, kappa, slip, self._briefing.vehicle)

    def turn(self, senses: Senses, lateral: float) -> tuple[float, float]:
        """(curvature [1/m], lateral acceleration up to ``lateral`` [m/s^2]) when a command takes effect."""
        speed = max(senses.speed, 0.0)
        kappa = curvature_in(self.gains.lag, speed, senses.curvature, self._ahead.preview)
        return kappa, min(max(speed * speed * kappa, -lateral), lateral)

    def drive(self, senses: Senses, belief: Belief, lateral: float) -> float:
        """Drive command, -1 ... 1; ``lateral`` is the lateral limit [m/s^2]."""
        table = self._capability
        motion = self.planned(senses, belief, lateral)
        resistance = table.at("resistance", belief.mean)
        if self.gains.turning:
            resistance += table.turning_resistance(belief.mean, self.turn(senses, lateral)[1])
        return self._speed_control.command(
            motion.speed,
            senses.speed,
            acceleration=min(motion.acceleration, table.at("driving", belief.mean)),
            resistance=resistance,
            rim_speed=max(senses.rim_speed),
            slip_limit=self.drive_slip_limit,
            slowest_rim=min(senses.rim_speed),
        )

    def braking(self, belief: Belief) -> float:
        """Deceleration [m/s^2] that plans may use."""
        return self.gains.brake_share * self._capability.braking_limit(belief.low, belief.high)

    def planned(self, senses: Senses, belief: Belief, lateral: float) -> PlannedMotion:
        """Speed and acceleration to drive at: what the controllers of single tasks replace."""
        gains = self.gains
        limits = PlanLimits(gains.margin * lateral, self.braking(belief), gains.lag, gains.speed_max)
        speed = max(senses.speed, 0.0)
        return planned_motion(senses.curvature, speed, senses.target_speed, self._ahead, limits)
