"""Speed plan from what the soil holds at a believed n, and the tracker that drives it.

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

from agents.capability import Capability, soil_capability
from agents.protocol import Observation, Senses, read_senses, to_action
from agents.pure_pursuit import PursuitGains, goal_point, pursuit_curvature
from agents.speed_control import SpeedController, SpeedGains
from offroad_env.physics._jit import kernel

__all__ = ["Belief", "BeliefSource", "PlannerGains", "SoilTracker", "planned_speed", "speed_limit"]

#: Spacing of the points of the plan [m].
_STEP = 1.0
#: Curvature below which a path counts as straight [1/m]; avoids dividing by zero.
_STRAIGHT = 1e-4


class Belief(NamedTuple):
    """What a controller holds n to be: a best value and the interval that it insures against."""

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
    feed_forward: float = 1.0  #: share of the believed slip angles that the steering anticipates [-]
    turning: bool = False  #: whether the drive anticipates what a bend resists beyond the straight
    lag: float = 0.25  #: time between a command and its effect [s]
    speed_max: float = 15.0  #: highest speed on any path [m/s]
    pursuit: PursuitGains = field(default_factory=PursuitGains)
    speed: SpeedGains = field(default_factory=SpeedGains)


def speed_limit(curvature: np.ndarray, lateral: float, speed_max: float) -> np.ndarray:
    """Speed [m/s] at which the path of that curvature [1/m] takes the acceleration ``lateral``.

    v = sqrt(lateral / |kappa|), at most ``speed_max``.
    """
    return np.minimum(np.sqrt(lateral / np.maximum(np.abs(curvature), _STRAIGHT)), speed_max)


@kernel
def planned_speed(limits, stations, braking, at):
    """Highest speed [m/s] at station ``at`` from which every later limit can be met.

    Backward pass with constant deceleration in closed form: v^2 = min over the stations s_i ahead
    of v_i^2 + 2 braking (s_i - at). At the last station the vehicle must be able to stand, since
    nobody knows what follows.

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

    def __init__(
        self,
        believe: BeliefSource,
        gains: PlannerGains | None = None,
    ) -> None:
        self.believe = believe
        self.gains = gains or PlannerGains()

    def reset(self, briefing: Any) -> None:
        """Tabulate what the briefed soil holds for the briefed vehicle (cached)."""
        self._briefing = briefing
        self._capability = soil_capability(
            briefing.vehicle, briefing.soil, tuple(briefing.n_range), briefing.shear
        )
        self._preview = np.asarray(briefing.preview, dtype=np.float64)
        self._stations = np.arange(0.0, self._preview[-1] + 0.5 * _STEP, _STEP)
        self._speed_control = SpeedController(briefing.vehicle, briefing.dt, self.gains.speed)

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        belief = self.believe(self._briefing, self._capability, observation)
        lateral = self._capability.lateral_limit(belief.low, belief.high, self.gains.slip_angle)
        steer = self._steer(senses, belief.mean, lateral)
        drive = self._drive(senses, belief, lateral)
        return to_action(steer, drive, self._briefing.vehicle.steer_max)

    def _steer(self, senses: Senses, n: float, lateral: float) -> float:
        vehicle, gains = self._briefing.vehicle, self.gains
        speed = max(senses.speed, 0.0)
        kappa, a = self._turn(senses, lateral)
        front, rear = (gains.feed_forward * angle for angle in self._capability.slip_angles(n, a))
        course_error = senses.heading_error - (rear - vehicle.l_r * kappa)
        goal = goal_point(senses.curvature, self._preview, gains.pursuit.distance(speed))
        wanted = pursuit_curvature(senses.cross_track, course_error, goal)
        return math.atan((vehicle.l_f + vehicle.l_r) * wanted) + front - rear

    def _turn(self, senses: Senses, lateral: float) -> tuple[float, float]:
        """(curvature [1/m], lateral acceleration [m/s^2] up to ``lateral``) when a command takes effect."""
        speed = max(senses.speed, 0.0)
        kappa = float(np.interp(self.gains.lag * speed, self._preview, senses.curvature))
        return kappa, min(max(speed * speed * kappa, -lateral), lateral)

    def _drive(self, senses: Senses, belief: Belief, lateral: float) -> float:
        table = self._capability
        target, acceleration, slip_limit = self._wanted(senses, belief, lateral)
        resistance = table.at("resistance", belief.mean)
        if self.gains.turning:
            resistance += table.turning_resistance(belief.mean, self._turn(senses, lateral)[1])
        return self._speed_control.command(
            target,
            senses.speed,
            acceleration=min(acceleration, table.at("driving", belief.mean)),
            resistance=resistance,
            rim_speed=max(senses.rim_speed),
            slip_limit=slip_limit,
        )

    def _wanted(self, senses: Senses, belief: Belief, lateral: float) -> tuple[float, float, float | None]:
        """(speed [m/s], acceleration [m/s^2], limit of the drive slip or None): what a task changes."""
        gains, table = self.gains, self._capability
        kappa = np.interp(self._stations, self._preview, senses.curvature)
        limits = speed_limit(kappa, gains.margin * lateral, gains.speed_max)
        braking = gains.brake_share * table.braking_limit(belief.low, belief.high)
        ahead = gains.lag * max(senses.speed, 0.0)
        target = planned_speed(limits, self._stations, braking, ahead)
        later = planned_speed(limits, self._stations, braking, ahead + _STEP)
        acceleration = (later * later - target * target) / (2.0 * _STEP)
        asked = senses.target_speed
        if 0.0 < asked < target:
            target, acceleration = asked, 0.0
        return target, max(acceleration, -braking), None
