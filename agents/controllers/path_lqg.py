"""Following a path at a given speed: steering by LQG over a bicycle on yielding soil.

The axles hold the vehicle to its path by side forces that grow with their slip angles, with a cornering
stiffness that depends on the soil. Around the steady bend the errors of a bicycle with such axles are linear
(R. Rajamani, Vehicle Dynamics and Control, 2nd ed. 2012, section 2.5). A Kalman filter estimates them from
the measurements, and with them the side force of each axle beyond the model's: slopes, forces of the
drive, and the error of n. Steering that counters those has integral action: no offset is left
in a bend (G. Pannocchia, J. B. Rawlings, Disturbance models for offset-free model-predictive control,
AIChE J. 49, 2003). Both gains come from the Riccati equation, for the assumed soil.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from agents.controllers.protocol import Observation, Senses, read_senses, to_action
from agents.controllers.speed_planner import Belief, BeliefSource, PlannedMotion, PlannerGains, SoilTracker
from agents.controllers.traction_limits import Capability
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Vehicle

__all__ = ["PathController", "PathLaw", "PathWeights", "bend_dynamics", "path_law"]

# State: distance from the path [m], heading error [rad], side speed [m/s], yaw rate [rad/s] and steering
# [rad], all less those of the steady bend; what front and rear axle hold beyond belief [m/s^2], and the
# error of the heading that is seen [rad].
_DISTANCE, _HEADING, _SIDE, _YAW_RATE, _STEER, _FRONT, _REAR, _BIAS = range(8)
_SIZE = 8
#: Measurements: distance, heading error, yaw rate, side acceleration.
_SEEN = 4
#: Their standard deviations [m, rad, rad/s, m/s^2]: of the navigation filter, and of the IMU's mean of two.
_SEEN_SD = (0.02, 0.02, 0.0124, 0.2)
#: Standard deviation [rad] and fading [s] of the error that lasts: the navigation filter expects small slip
#: angles and sees a vehicle that slides through a bend turned too far out.
_BIAS_SD, _BIAS_FADING = 0.1, 10.0
#: Wander of the motion itself beside what the axles hold: side speed [m/s/sqrt(s)], yaw rate [rad/s/sqrt(s)].
_WANDER = 0.01
#: Time in which what an axle holds beyond belief fades [s]: a few waves of the ground, a quarter of a bend.
_FADING = 3.0
#: Largest steering beyond the bend's, and steepest way back to the path that a distance may ask for [rad].
#: Swung further, at its limited rate, the steering comes so late that the loop swings from end to end.
_SWING, _STEEPEST = 0.3, 0.05
#: Steering that counts as bad as the distance of `PathWeights` [rad].
_STEERING = 0.1
#: Lateral acceleration at which the stiffness of an axle is read from the table [m/s^2].
_GENTLE = 1.0
#: Beliefs for which the law is made; in between its matrices are interpolated.
_NODES = 9
_TINY = 1e-9  # keeps the Riccati equations regular


@dataclass(frozen=True, kw_only=True)
class PathWeights:
    """What the law of the steering is made for."""

    distance: float = 0.03  #: distance from the path that counts as bad as 0.1 rad of steering [m]
    unknown: float = 1.0  #: size of what an axle holds beyond belief [m/s^2]


def bend_dynamics(
    vehicle: Vehicle, stiffness: tuple[float, float], speed: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors about a steady bend: (A (8, 8), B (8,), C (4, 8)) of x' = A x + B u, y = C x.

    With axle accelerations s_i = C_i beta_i + d_i, where beta_f = delta - (v_y + l_f r) / v and
    beta_r = -(v_y - l_r r) / v,

        v_y' + v r = (l_r s_f + l_f s_r) / L,   r' = m l_f l_r / (L I_z) (s_f - s_r).

    Parameters
    ----------
    vehicle
    stiffness
        C_f, C_r: lateral acceleration that front and rear axle hold per slip angle [m/s^2/rad].
    speed
        [m/s]
    """
    l_f, l_r = vehicle.l_f, vehicle.l_r
    wheelbase = l_f + l_r
    front, rear = np.zeros(_SIZE), np.zeros(_SIZE)
    front[[_SIDE, _YAW_RATE, _STEER]] = stiffness[0] * np.array([-1.0 / speed, -l_f / speed, 1.0])
    rear[[_SIDE, _YAW_RATE]] = stiffness[1] * np.array([-1.0 / speed, l_r / speed])
    front[_FRONT] = rear[_REAR] = 1.0
    side_acceleration = (l_r * front + l_f * rear) / wheelbase
    A = np.zeros((_SIZE, _SIZE))
    A[_DISTANCE, _HEADING], A[_DISTANCE, _SIDE] = speed, 1.0
    A[_HEADING, _YAW_RATE] = 1.0
    A[_SIDE] = side_acceleration
    A[_SIDE, _YAW_RATE] -= speed
    A[_YAW_RATE] = vehicle.m * l_f * l_r / (wheelbase * vehicle.I_z) * (front - rear)
    A[_STEER, _STEER] = -1.0 / vehicle.steer_lag
    A[_FRONT, _FRONT] = A[_REAR, _REAR] = -1.0 / _FADING
    A[_BIAS, _BIAS] = -1.0 / _BIAS_FADING
    B = np.zeros(_SIZE)
    B[_STEER] = 1.0 / vehicle.steer_lag
    C = np.zeros((_SEEN, _SIZE))
    C[0, _DISTANCE] = C[1, _HEADING] = C[1, _BIAS] = C[2, _YAW_RATE] = 1.0
    C[3] = side_acceleration
    return A, B, C


class PathLaw(NamedTuple):
    """Matrices of the controller for a period, for one soil; or stacked, for several."""

    transition: np.ndarray  #: (8, 8) of the state
    effect: np.ndarray  #: (8,) of the steering commanded on the state
    steering: np.ndarray  #: (8,) gains: the steering beyond the bend's is minus their product with the state
    believing: np.ndarray  #: (8, 4) gains of the filter
    seen: np.ndarray  #: (4, 8) measurement of a state


def path_law(
    vehicle: Vehicle, stiffness: tuple[float, float], speed: float, dt: float, weights: PathWeights
) -> PathLaw:
    """The law for axles of that stiffness: LQR gains, and those of the Kalman filter in its steady state.

    Parameters as in `bend_dynamics`; ``dt`` is the control interval [s].
    """
    A, B, C = bend_dynamics(vehicle, stiffness, speed)
    whole = np.zeros((_SIZE + 1, _SIZE + 1))
    whole[:_SIZE, :_SIZE], whole[:_SIZE, _SIZE] = A, B
    step = expm(whole * dt)
    F, G = step[:_SIZE, :_SIZE], step[:_SIZE, _SIZE:]
    cost = _TINY * np.eye(_SIZE)
    cost[_DISTANCE, _DISTANCE] = weights.distance**-2
    effort = np.array([[_STEERING**-2]])
    P = solve_discrete_are(F, G, cost, effort)
    steering = np.linalg.solve(G.T @ P @ G + effort, G.T @ P @ F)
    wander = np.full(_SIZE, _TINY)
    wander[[_SIDE, _YAW_RATE]] = _WANDER**2
    wander[[_FRONT, _REAR]] = 2.0 * weights.unknown**2 / _FADING
    wander[_BIAS] = 2.0 * _BIAS_SD**2 / _BIAS_FADING
    noise = np.diag(np.square(_SEEN_SD))
    S = solve_discrete_are(F.T, C.T, np.diag(wander * dt), noise)
    believing = np.linalg.solve(C @ S @ C.T + noise, C @ S).T
    return PathLaw(F, G[:, 0], steering[0], believing, C)


def _moved(vehicle: Vehicle, steer: float, command: float, dt: float) -> float:
    """Steering [rad] after ``dt`` of a command: a first-order lag at a limited rate, in closed form.

    delta' = w tanh((u - delta) / (T w)) gives sinh((u - delta) / (T w)) e^(-t / T) for the same at t.
    """
    reach = vehicle.steer_lag * vehicle.steer_rate
    left = math.sinh((command - steer) / reach) * math.exp(-dt / vehicle.steer_lag)
    return command - reach * math.asinh(left)


@lru_cache(maxsize=64)
def _laws(vehicle: Vehicle, table: Capability, speed: float, dt: float, weights: PathWeights) -> PathLaw:
    """The laws for `_NODES` soils, evenly over the table's grid of n, stacked."""
    laws = []
    for n in np.linspace(table.grid[0], table.grid[-1], _NODES):
        front, rear = table.slip_angles(float(n), _GENTLE)
        laws.append(path_law(vehicle, (_GENTLE / front, _GENTLE / rear), speed, dt, weights))
    return PathLaw(*(np.stack(parts) for parts in zip(*laws, strict=True)))


class PathController(SoilTracker):
    """`SoilTracker` that steers by `path_law`, at the speed that is asked for.

    The speed is given, so a controller cannot be more precise by being slower.

    Parameters
    ----------
    believe, gains
        As `SoilTracker`; ``gains.feed_forward`` is the share of the believed slip angles that the
        steering anticipates.
    weights
    """

    def __init__(
        self, believe: BeliefSource, gains: PlannerGains | None = None, *, weights: PathWeights | None = None
    ) -> None:
        super().__init__(believe, gains)
        self.weights = weights or PathWeights()

    def reset(self, briefing: Any) -> None:
        """Make the laws for the briefed vehicle, soil and speed (cached).

        Raises
        ------
        InvalidParameter
            If the task gives no speed.
        """
        if not briefing.target_speed > 0.0:
            raise InvalidParameter(f"{briefing.scenario!r} gives no speed to follow its path at")
        super().reset(briefing)
        self._laws = _laws(
            briefing.vehicle, self._capability, briefing.target_speed, briefing.dt, self.weights
        )
        self._state = np.zeros(_SIZE)
        self._beyond = 0.0  # the last command less the bend's steering [rad]
        self._steering = 0.0  # where the wheels stand [rad]

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        belief = self.believe(self._briefing, self._capability, observation)
        steer = self._follow(senses, observation["imu"], belief.mean)
        drive = self.drive(senses, belief, math.inf)
        return to_action(steer, drive, self._briefing.vehicle.steer_max)

    def _follow(self, senses: Senses, imu: np.ndarray, n: float) -> float:
        """Steering [rad] by the law, with one step of its filter."""
        vehicle, law = self._briefing.vehicle, self._law(n)
        kappa, speed = float(senses.curvature[0]), max(senses.speed, 0.0)
        bend, heading = self._steady_bend(n, kappa, speed)
        seen = np.array(
            [
                senses.cross_track,
                senses.heading_error - heading,
                float(imu[4]) - speed * kappa,
                float(imu[1]) - speed * speed * kappa,
            ]
        )
        state = law.transition @ self._state + law.effect * self._beyond
        state = state + law.believing @ (seen - law.seen @ state)
        state[_STEER] = self._steering - bend
        self._state = state
        counted = state.copy()
        far = _STEEPEST * float(law.steering[_HEADING] / law.steering[_DISTANCE])
        counted[_DISTANCE] = min(max(counted[_DISTANCE], -far), far)
        beyond = -float(law.steering @ counted)
        steer = bend + min(max(beyond, -_SWING), _SWING)
        steer = min(max(steer, -vehicle.steer_max), vehicle.steer_max)
        self._steering = _moved(vehicle, self._steering, steer, self._briefing.dt)
        self._beyond = steer - bend
        return float(steer)

    def _steady_bend(self, n: float, kappa: float, speed: float) -> tuple[float, float]:
        """Steering and heading error [rad] that hold the path's curvature [1/m], see `SoilTracker`."""
        vehicle = self._briefing.vehicle
        angles = self._capability.slip_angles(n, speed * speed * kappa)
        front, rear = (self.gains.feed_forward * angle for angle in angles)
        return math.atan((vehicle.l_f + vehicle.l_r) * kappa) + front - rear, rear - vehicle.l_r * kappa

    def _law(self, n: float) -> PathLaw:
        """The law for a believed n, linear between the nodes."""
        grid = self._capability.grid
        place = (min(max(n, grid[0]), grid[-1]) - grid[0]) / (grid[-1] - grid[0]) * (_NODES - 1)
        low = min(int(place), _NODES - 2)
        share = place - low
        return PathLaw(*(part[low] + share * (part[low + 1] - part[low]) for part in self._laws))

    def planned(self, senses: Senses, belief: Belief, lateral: float) -> PlannedMotion:
        """The speed that the task gives."""
        return PlannedMotion(senses.target_speed, 0.0)
