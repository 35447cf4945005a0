"""Model predictive path integral control: sample plans, drive them in the model, take their weighted mean.

G. Williams, P. Drews, B. Goldfain, J. M. Rehg, E. A. Theodorou, Aggressive driving with model
predictive path integral control, ICRA 2016. A plan is not a row of raw commands but a row of speeds and
steering offsets for a tracking law (pure pursuit with a speed loop), which is simulated with it: a
sampled plan then stays near the path, and a few dozen of them are enough.

The model is the compiled vehicle on flat soil of the assumed n. Uncertainty of the estimate is covered by
driving every plan at the mean and at the low end of its interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.protocol import Observation, Senses, read_senses, to_action
from agents.controllers.pure_pursuit import PursuitGains, look_ahead
from agents.controllers.speed_planner import Belief, BeliefSource, speed_limit
from agents.controllers.traction_limits import soil_capability
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.packing import PackedPlant, pack, unpack
from offroad_env.physics.path_geometry import PathTable, path_point, project
from offroad_env.physics.records import FloatArray, Vehicle
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat

__all__ = ["MppiAgent", "MppiSettings", "roll_out"]

#: Path behind the vehicle that is laid out, and spacing of its nodes [m].
_BEHIND, _SPACING = 4.0, 1.0
#: Cost of leaving the corridor, in metres of progress.
_OUT = 60.0


@dataclass(frozen=True, kw_only=True)
class MppiSettings:
    """What can be chosen; each value has its reason here."""

    samples: int = 48  #: plans: a few dozen are enough for so few numbers
    knots: int = 6  #: speeds and steering offsets of a plan
    interval: float = 0.4  #: time between knots [s]: the horizon of 2.4 s is longer than a full stop
    period: float = 0.1  #: time between looks at the path within a rollout [s]
    dt: float = 0.02  #: step of the model [s]
    replan: int = 10  #: control steps between plans: 0.2 s
    speed_sd: float = 1.0  #: spread of the sampled speeds [m/s]
    steer_sd: float = 0.1  #: spread of the sampled steering offsets [rad]
    temperature: float = 1.0  #: differences of cost that matter [m of progress]
    margin: float = 0.5  #: share of the corridor that costs nothing extra [-]
    brake_share: float = 0.5  #: share of the believed braking that the terminal speed relies on [-]
    slip_angle: float = 0.3  #: slip angle of the terminal speed [rad]
    speed_max: float = 15.0  #: [m/s]
    pursuit: PursuitGains = field(default_factory=PursuitGains)


class _Gains(NamedTuple):
    """Tracking, timing and corridor of a roll-out."""

    pursuit: PursuitGains
    looks: int  #: at the path within the time of a knot
    period: float  #: between two looks [s]
    dt: float  #: step of the model [s]
    corridor: float  #: half width [m]
    margin: float  #: share of it that costs nothing extra [-]


@kernel
def _follow(
    path: PathTable, x: FloatArray, hint: int, wanted: FloatArray, vehicle: Vehicle, gains: _Gains
) -> tuple[tuple[float, float, float], float, float, int]:
    """Tracking law: command for a wanted (speed [m/s], steering offset [rad]); (command, s, error, hint)."""
    s, error, _, _, hint = project(path, x[at.X], x[at.Y], hint)
    speed = x[at.V_X]
    ahead = look_ahead(gains.pursuit, speed)
    goal_x, goal_y, _, _ = path_point(path, s + ahead)
    dx, dy = goal_x - x[at.X], goal_y - x[at.Y]
    left = dy * math.cos(x[at.YAW]) - dx * math.sin(x[at.YAW])
    kappa = 2.0 * left / max(dx * dx + dy * dy, 1.0)
    steer = math.atan((vehicle.l_f + vehicle.l_r) * kappa) + wanted[1]
    steer = min(max(steer, -vehicle.steer_max), vehicle.steer_max)
    torque = vehicle.m * 2.5 * (wanted[0] - speed) * vehicle.r
    drive = min(max(torque, 0.0), vehicle.drive_torque_max)
    brake = min(max(-torque, 0.0), vehicle.brake_torque_max)
    return (steer, drive, brake), s, error, hint


@kernel
def roll_out(
    start: FloatArray,
    packed: PackedPlant,
    path: PathTable,
    plans: FloatArray,
    limits: FloatArray,
    gains: _Gains,
    costs: FloatArray,
) -> None:
    """Drive every plan in the model and add what it costs, in metres of progress.

    Parameters
    ----------
    start (15,) : state of the vehicle
    packed : the believed plant
    path : ahead, laid out from the curvatures seen
    plans (K, knots, 2) : speeds [m/s] and steering offsets [rad]
    limits (S,) : highest speed [m/s] at the path's nodes from which what follows can be driven
    gains : timing and corridor
    costs (K,) : added to
    """
    plant = unpack(packed)
    work, readings = np.empty((WORK_ROWS, at.READINGS_SIZE)), np.empty(at.READINGS_SIZE)
    looks, period, corridor = gains.looks, gains.period, gains.corridor
    steps = round(period / gains.dt)
    for k in range(plans.shape[0]):
        x, warm, hint = start.copy(), np.zeros((2, at.CONTACT_SIZE)), 0
        s_0, _, _, _, hint = project(path, x[at.X], x[at.Y], hint)
        s, left = s_0, plans.shape[1] * looks
        full_derivative(x, (0.0, 0.0, 0.0), plant, warm, work[0], readings)
        for i in range(plans.shape[1] * looks):
            wanted = plans[k, i // looks]
            command, s, error, hint = _follow(path, x, hint, wanted, plant.vehicle, gains)
            over = max(abs(error) / corridor - gains.margin, 0.0)
            costs[k] += 10.0 * over * period
            left -= 1
            if abs(error) > corridor:
                costs[k] += _OUT + left * period
                break
            if full_continue(x, warm, command, plant, (gains.dt, steps), work, readings) >= SUNK:
                costs[k] += _OUT + left * period
                break
        speed = x[at.V_X]
        node = min(max(int(s / path.ds), 0), limits.shape[0] - 1)
        costs[k] += 4.0 * max(speed - limits[node], 0.0) ** 2 - (s - s_0)


class MppiAgent:
    """Sampling control on the compiled model.

    Parameters
    ----------
    believe
        As `agents.controllers.speed_planner.SoilTracker`.
    settings
    seed
        Of the sampled plans; every episode begins with it.
    """

    def __init__(self, believe: BeliefSource, settings: MppiSettings | None = None, *, seed: int = 0) -> None:
        self.believe = believe
        self.settings = settings or MppiSettings()
        self.seed = seed

    def reset(self, briefing: Any) -> None:
        """Forget the plan, tabulate what the briefed soil holds (cached)."""
        self._briefing = briefing
        self._capability = soil_capability(
            briefing.vehicle, briefing.soil, tuple(briefing.n_range), briefing.shear
        )
        self._preview = np.asarray(briefing.preview, dtype=np.float64)
        self._rng = np.random.default_rng(self.seed)
        self._plan = np.zeros((self.settings.knots, 2))
        self._plan[:, 0] = 3.0
        self._age = self.settings.replan
        self._plants: dict[float, Any] = {}

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        settings, briefing = self.settings, self._briefing
        senses = read_senses(observation)
        path = self._laid_out(senses)
        belief = self.believe(briefing, self._capability, observation)
        x = self._state(senses, observation, belief.mean)
        if self._age >= settings.replan:
            self._replan(x, path, belief)
        knot = min(int(self._age * briefing.dt / settings.interval), settings.knots - 1)
        self._age += 1
        command, *_ = _follow(path, x, 0, self._plan[knot], briefing.vehicle, self._gains())
        vehicle = briefing.vehicle
        drive = command[1] / vehicle.drive_torque_max - command[2] / vehicle.brake_torque_max
        return to_action(command[0], drive, vehicle.steer_max)

    def _gains(self) -> _Gains:
        s = self.settings
        looks = round(s.interval / s.period)
        return _Gains(s.pursuit, looks, s.period, s.dt, self._briefing.corridor, s.margin)

    def _laid_out(self, senses: Senses) -> PathTable:
        """The path ahead as nodes, from the curvatures seen, in axes along it at its nearest point."""
        count = int((self._preview[-1] + _BEHIND) / _SPACING) + 1
        s = _SPACING * np.arange(count) - _BEHIND
        kappa = np.interp(s, self._preview, senses.curvature)
        kappa[s < 0.0] = senses.curvature[0]
        turn = np.concatenate(([0.0], np.cumsum(0.5 * _SPACING * (kappa[1:] + kappa[:-1]))))
        yaw = turn - turn[int(_BEHIND / _SPACING)]
        middle = 0.5 * (yaw[1:] + yaw[:-1])
        X = np.concatenate(([0.0], np.cumsum(_SPACING * np.cos(middle))))
        Y = np.concatenate(([0.0], np.cumsum(_SPACING * np.sin(middle))))
        here = int(_BEHIND / _SPACING)
        nodes = np.column_stack((X - X[here], Y - Y[here], yaw, kappa))
        return PathTable(_SPACING, np.ascontiguousarray(nodes))

    def _state(self, senses: Senses, observation: Observation, n: float) -> np.ndarray:
        """The model's state, as far as the sensors tell; side slip as in a steady bend on soil n."""
        vehicle = self._briefing.vehicle
        x = np.zeros(at.STATE_SIZE)
        speed, yaw_rate = max(senses.speed, 0.3), float(observation["imu"][4])
        x[at.Y], x[at.YAW], x[at.V_X] = senses.cross_track, senses.heading_error, speed
        steady = speed * float(senses.curvature[0])
        _, rear = self._capability.slip_angles(n, speed * steady)
        x[at.V_Y] = vehicle.l_r * steady - speed * math.tan(rear)
        # The gyro is noisy; half of it and half of what the bend asks for.
        x[at.YAW_RATE] = 0.5 * (yaw_rate + steady)
        x[at.OMEGA_F], x[at.OMEGA_R] = (rim / vehicle.r for rim in senses.rim_speed)
        x[at.STEER], drive = float(observation["motion"][3]), float(observation["motion"][4])
        x[at.DRIVE] = max(drive, 0.0) * vehicle.drive_torque_max
        x[at.BRAKE] = max(-drive, 0.0) * vehicle.brake_torque_max
        return x

    def _replan(self, x: np.ndarray, path: PathTable, belief: Belief) -> None:
        """Shift the plan by the time that has passed, sample around it, weigh by cost."""
        s = self.settings
        passed = self._age * self._briefing.dt / s.interval
        knots = np.arange(s.knots) + passed
        mean = np.column_stack([np.interp(knots, np.arange(s.knots), column) for column in self._plan.T])
        noise = self._rng.standard_normal((s.samples, s.knots, 2)) * (s.speed_sd, s.steer_sd)
        # Half of the plans change all speeds together: to go faster or slower is the main question.
        noise[::2, :, 0] = noise[::2, :1, 0]
        noise[0] = 0.0
        plans = mean + noise
        plans[..., 0] = np.clip(plans[..., 0], 0.0, s.speed_max)
        costs = np.zeros(s.samples)
        for n in dict.fromkeys((belief.mean, belief.low)):
            limits = self._limits(path, belief)
            roll_out(x, self._packed(n), path, plans, limits, self._gains(), costs)
        weights = np.exp(-(costs - costs.min()) / s.temperature)
        self._plan = np.tensordot(weights / weights.sum(), plans, axes=1)
        self._age = 0

    def _limits(self, path: PathTable, belief: Belief) -> np.ndarray:
        """(S,) highest speed [m/s] at every node from which the rest of the path can be driven."""
        s, table = self.settings, self._capability
        lateral = table.lateral_limit(belief.low, belief.high, s.slip_angle)
        braking = s.brake_share * table.braking_limit(belief.low, belief.high)
        squares = speed_limit(path.nodes[:, 3], lateral, s.speed_max) ** 2
        squares[-1] = 0.0
        for i in range(len(squares) - 2, -1, -1):
            squares[i] = min(squares[i], squares[i + 1] + 2.0 * braking * path.ds)
        return np.sqrt(squares)

    def _packed(self, n: float) -> Any:
        """The believed plant, made once for every hundredth of n."""
        n = round(n, 2)
        if n not in self._plants:
            plant = make_plant(
                self._briefing.vehicle, make_soil(self._briefing.soil, n=n), flat(), vehicle_model="bicycle"
            )
            self._plants[n] = pack(plant)
        return self._plants[n]
