"""Nonlinear model-predictive control of steering and drive, by real-time iteration.

The problem of `agents.controllers.nmpc_problem` is solved by one linearisation and one quadratic programme a
decision (M. Diehl, H. G. Bock, J. P. Schloder, A real-time iteration scheme for nonlinear optimization in
optimal feedback control, SIAM J. Control Optim. 43, 2005), started from the last plan. It drives as far as
possible within the horizon, inside the corridor, below the slip angles at which the axles hold most, and so
that the vehicle can slow down for what it sees beyond. The number of iterations is fixed: no clock decides.

What the sensors do not show - side speed, and what the axles hold beyond the model - comes from an extended
Kalman filter on the same model, which makes the control free of offset (G. Pannocchia, J. B. Rawlings, AIChE
J. 49, 2003).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from agents.controllers.nmpc_problem import (
    DRAG_ANGLE,
    INPUTS,
    SOIL,
    STATES,
    Horizon,
    fitted_side,
    make_problem,
)
from agents.controllers.nmpc_programme import Limits, Programme
from agents.controllers.protocol import Observation, Senses, read_senses, to_action
from agents.controllers.speed_control import SpeedGains, drive_share, slip_between, slip_share
from agents.controllers.speed_planner import Belief, BeliefSource, limits_over_n, planned_speed, speed_limit
from agents.controllers.traction_limits import Capability
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import AIR_DENSITY, GRAVITY
from offroad_env.physics.records import Vehicle

__all__ = ["NmpcAgent", "NmpcSettings", "SoilNumbers", "soil_numbers"]

_E, _PSI, _S, _V, _VY, _R, _STEER, _PUSH, _STEER_COMMAND, _PUSH_COMMAND = range(len(STATES))
_N = len(STATES)
#: Nodes of the fits over the table, and of the preview [m].
_NODES, _SPACING = 13, 1.0
#: States that the observer corrects with what it measures: distance, heading, speed, yaw rate.
_SEEN = (_E, _PSI, _V, _R)
_SEEN_SD = (0.03, 0.02, 0.1, 0.0124)
#: Side acceleration of the IMU [m/s^2].
_SIDE_SD = 0.3
#: Wander of the states, and of what the axles hold beyond the model [1/sqrt(s)].
_WANDER = np.array([0.01, 0.01, 0.0, 0.3, 0.1, 0.05, 0.02, 0.0, 0.0, 0.0])
_UNKNOWN, _FADING = 1.0, 3.0
#: Numbers at the end of `SOIL` that the observer estimates: what the model leaves out.
_BEYOND = 3
#: Of sensors: bias of the heading, of the side acceleration; how they wander, of their size [1/sqrt(s)].
_BIASES, _BIAS_WANDER = 2, 0.1
_ALL = _N + _BEYOND + _BIASES
#: A plan is one if the model follows it to so much in distance from the path [m] and speed [m/s].
_STRAYS = (0.3, 1.0)
#: Drive command per slip of a wheel that is held [-]: the drive lags by 0.2 s, and with four times as much
#: the wheel locks and spins in turn, and steers half as well.
_ROLL_ON = 0.7
#: Linearisations where it does not, and shares of a step that are tried.
_NEWTON, _SHARES = 3, (1.0, 0.5, 0.25, 0.1)
#: Share of the largest power up to which its loss is inverted [-].
_MOST_POWER = 0.99


#: Largest values of the settings. Beyond 30 degrees of slip angle the tables end.
_HIGHEST = {
    "margin": 1.5,
    "slip_angle": 0.52,
    "corridor": 1.0,
    "inside": 3.0,
    "beyond": 3.0,
    "brake_share": 1.0,
    "braking": 1.0,
    "speed_max": 50.0,
}


@dataclass(frozen=True, kw_only=True)
class NmpcSettings:
    """Caution, weights and timing."""

    margin: float = 0.85  #: share of the side force that the plan counts on [-]
    slip_angle: float = 0.3  #: largest slip angle of the plan [rad]
    corridor: float = 0.55  #: share of the corridor's half width that the plan uses [-]
    inside: float = 1.25  #: share of the lateral limit that the path itself may take inside the plan [-]
    beyond: float = 1.0  #: share of the lateral limit by which it must be able to slow down beyond [-]
    brake_share: float = 0.5  #: share of the braking with which it slows down for bends [-]
    braking: float = 0.8  #: share of what the axles hold along that the plan itself brakes with [-]
    speed_max: float = 15.0  #: [m/s]
    heading_bias: float = 0.0  #: standard deviation of what the heading is off [rad]
    side_bias: float = 0.0  #: and the side acceleration of the IMU, mounting included [m/s^2]
    replan: int = 4  #: control intervals between two decisions
    iterations: int = 1  #: linearisations a decision
    horizon: Horizon = field(default_factory=Horizon)

    def __post_init__(self) -> None:
        for name, highest in _HIGHEST.items():
            value = getattr(self, name)
            if not 0.0 < value <= highest:
                raise InvalidParameter(f"{name} must be above 0 and at most {highest:g}, got {value:g}")
        for name in ("heading_bias", "side_bias"):
            if not getattr(self, name) >= 0.0:
                raise InvalidParameter(f"{name} must be 0 or more, got {getattr(self, name):g}")
        for name in ("replan", "iterations"):
            if getattr(self, name) < 1:
                raise InvalidParameter(f"{name} must be at least 1, got {getattr(self, name)}")


class SoilNumbers(NamedTuple):
    """What the problem's parameters are over a table: functions of its coordinate."""

    grid: np.ndarray  #: (K,)
    rows: np.ndarray  #: (K, 9) `SOIL` without what the axles hold beyond

    def at(self, low: float, mean: float, margin: float) -> np.ndarray:
        """(12,) `SOIL`: side forces of the cautious end of a belief, the rest of its mean."""
        cautious, middle = (self._row(value) for value in (low, mean))
        found = np.append(middle, np.zeros(_BEYOND))
        for i in (0, 3):
            found[i : i + 3] = cautious[i : i + 3]
            found[i] *= margin
        return found

    def _row(self, value: float) -> np.ndarray:
        return np.array([np.interp(value, self.grid, column) for column in self.rows.T])


@lru_cache(maxsize=32)
def soil_numbers(vehicle: Vehicle, table: Capability) -> SoilNumbers:
    """Fits of the table's side forces and drags."""
    places = np.linspace(0, table.grid.size - 1, _NODES).astype(int)
    angles, rows = table.angles, []
    shape = np.sqrt(angles**2 + DRAG_ANGLE**2) - DRAG_ANGLE
    for i in places:
        drag = table.turning[:, i].mean(axis=0) / vehicle.m
        fit = float(shape @ drag / (shape @ shape))
        hold = max(0.5 * (table.braking[i] + table.driving[i]), 0.3)
        rows.append(
            [
                *fitted_side(angles, table.side[0, i]),
                *fitted_side(angles, table.side[1, i]),
                *(max(fit, 0.0), float(table.resistance[i]) / vehicle.m, hold),
            ]
        )
    return SoilNumbers(table.grid[places], np.array(rows))


class NmpcAgent:
    """Model-predictive control with any source of belief.

    Parameters
    ----------
    believe
        As `agents.controllers.speed_planner.SoilTracker`.
    settings
    slips
        At which slips drive and brakes are cut off, as every car does. Default: never.
    """

    def __init__(
        self,
        believe: BeliefSource,
        settings: NmpcSettings | None = None,
        *,
        slips: SpeedGains | None = None,
    ) -> None:
        self.believe, self.settings, self._slips = believe, settings or NmpcSettings(), slips
        self.tabulate: Callable[[Any], Capability] = limits_over_n  #: as `SoilTracker`

    def reset(self, briefing: Any) -> None:
        """Tabulate the soils, and forget plan and state.

        Raises
        ------
        InvalidParameter
            In tasks that end at a line, or limit the shaking.
        """
        if briefing.stop_zone > 0.0 or np.isfinite(briefing.shake_limit):
            raise InvalidParameter(
                f"nmpc drives courses without line or limit of shaking, not {briefing.scenario!r}"
            )
        self._briefing, self._vehicle = briefing, briefing.vehicle
        self._table = self.tabulate(briefing)
        self._numbers = soil_numbers(self._vehicle, self._table)
        self._problem = make_problem(self._vehicle, self.settings.horizon, briefing.dt)
        self._programme = Programme(self.settings.horizon)
        self._preview = np.asarray(briefing.preview, dtype=np.float64)
        self._stations = np.arange(0.0, self._preview[-1] + 0.5 * _SPACING, _SPACING)
        self._x: np.ndarray | None = None
        sizes = np.square([self.settings.heading_bias, self.settings.side_bias])
        first = np.square([0.1, 0.1, 0.0, 0.3, 0.2, 0.1, 0.02, 0.0, 0.0, 0.0])
        self._P = np.diag([*first, *[0.5] * _BEYOND, *sizes])
        self._wander = np.array(
            [*_WANDER**2, *[2.0 * _UNKNOWN**2 / _FADING] * _BEYOND, *_BIAS_WANDER**2 * sizes]
        )
        self._beyond, self._biases = np.zeros(_BEYOND), np.zeros(_BIASES)
        self._plan: tuple[np.ndarray, np.ndarray] | None = None
        self._age = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Action (2,)."""
        senses = read_senses(observation)
        belief = self.believe(self._briefing, self._table, observation)
        soil = self._numbers.at(belief.low, belief.mean, self.settings.margin)
        self._observe(senses, observation, self._numbers.at(belief.mean, belief.mean, 1.0))
        assert self._x is not None
        if self._plan is None or self._age >= self.settings.replan:
            self._replan(senses, belief, soil)
        self._age += 1
        assert self._plan is not None
        _, inputs = self._plan
        # Commands of the first stage move at their planned rates.
        self._x[[_STEER_COMMAND, _PUSH_COMMAND]] += self._briefing.dt * inputs[0, : len(INPUTS)]
        steer, push = self._x[_STEER_COMMAND], self._x[_PUSH_COMMAND]
        return to_action(float(steer), self._drive(float(push), senses), self._vehicle.steer_max)

    def _drive(self, push: float, senses: Senses) -> float:
        """Drive command for a force per mass [m/s^2]."""
        v = self._vehicle
        speed = senses.speed
        drag = 0.5 * AIR_DENSITY * v.drag_area * speed * abs(speed) + v.rolling_resistance * v.m * GRAVITY
        force = v.m * push + drag
        command = drive_share(force, v)
        if force > 0.0:
            # Near its largest power P the drive gives T / sqrt(1 + (T omega / P)^2) of an asked torque T.
            share = min(force * max(*senses.rim_speed, speed, 0.0) / v.power_max, _MOST_POWER)
            command /= math.sqrt(1.0 - share * share)
        return self._kept_rolling(float(np.clip(command, -1.0, 1.0)), senses)

    def _kept_rolling(self, command: float, senses: Senses) -> float:
        """The drive command without what makes wheels spin or lock: both hardly steer any more.

        Soft soil holds a locked wheel even without brakes: it is driven until it rolls again.
        """
        gains = self._slips
        if gains is None:
            return command
        assert self._x is not None
        _, _, _, v, vy, r, steer, *_ = self._x
        # A steered wheel rolls at the speed along its own plane.
        front = v * math.cos(steer) + (vy + self._vehicle.l_f * r) * math.sin(steer)
        wheels = [*zip(senses.rim_speed, (front, v), strict=True)]
        if command > 0.0:
            command *= min(slip_share(ground, rim, gains.slip_limit, gains) for rim, ground in wheels)
        else:
            command *= min(slip_share(rim, ground, gains.brake_slip, gains) for rim, ground in wheels)
        slip = max(slip_between(rim, ground, gains) for rim, ground in wheels)
        locked = slip - gains.brake_slip - gains.slip_band
        return max(command, min(_ROLL_ON * locked, 1.0)) if locked > 0.0 else command

    # ------------------------------------------------------------------ state

    def _observe(self, senses: Senses, observation: Observation, soil: np.ndarray) -> None:
        """Extended Kalman filter of the state, of what the axles hold beyond the model, and of biases."""
        seen = np.array(
            [senses.cross_track, senses.heading_error, senses.speed, float(observation["imu"][4])]
        )
        if self._x is None:
            self._x = np.zeros(_N)
            self._x[[*_SEEN]] = seen
            self._x[_PUSH_COMMAND] = self._x[_PUSH] = soil[SOIL.index("resistance")]
        soil = soil.copy()
        soil[-_BEYOND:] = self._beyond
        dt = self._briefing.dt
        x, J = self._problem.short_step(self._x, soil, float(senses.curvature[0]))
        x, J = np.asarray(x).ravel(), np.asarray(J)
        F, kept = np.eye(_ALL), slice(_N, _N + _BEYOND)
        F[:_N, :_N], F[:_N, kept] = J[:, :_N], J[:, -_BEYOND:]
        F[kept, kept] *= 1.0 - dt / _FADING
        P = F @ self._P @ F.T + dt * np.diag(self._wander)
        mean = np.concatenate([x, (1.0 - dt / _FADING) * self._beyond, self._biases])
        # The side acceleration of the model: v_y' + v r, by finite change over the interval.
        side_row = (F[_VY] - np.eye(_ALL)[_VY]) / dt
        side_row[_R] += mean[_V]
        side = (x[_VY] - self._x[_VY]) / dt + mean[_V] * mean[_R]
        H = np.vstack([np.eye(_ALL)[[*_SEEN]], side_row])
        H[_SEEN.index(_PSI), -_BIASES] = H[-1, -1] = 1.0
        expected = np.append(mean[[*_SEEN]], side)
        expected[[_SEEN.index(_PSI), -1]] += self._biases
        innovation = np.append(seen, float(observation["imu"][1])) - expected
        R = np.diag(np.square([*_SEEN_SD, _SIDE_SD]))
        gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        mean = mean + gain @ innovation
        self._P = P - gain @ H @ P
        self._P = 0.5 * (self._P + self._P.T)
        self._x, self._beyond, self._biases = mean[:_N], np.clip(mean[kept], -2.0, 2.0), mean[-_BIASES:]
        self._x[_S] = 0.0
        self._x[_V] = max(self._x[_V], 0.3)

    # ------------------------------------------------------------------ plan

    def _replan(self, senses: Senses, belief: Belief, soil: np.ndarray) -> None:
        """One decision: linearise about the last plan, moved on by the time since, and solve."""
        assert self._x is not None
        soil = soil.copy()
        soil[-_BEYOND:] = self._beyond
        states, inputs = self._guess()
        limits = self._limits(senses, belief, soil)
        for _ in range(self.settings.iterations):
            found = self._solved(states, inputs, senses.curvature, soil, limits)
            if found is None or self._strays(found, senses.curvature, soil):
                # Far from the last plan its linearisation is of no use: that of the drive that follows is.
                states, inputs = self._drivable(inputs, senses.curvature, soil, limits)
            else:
                states, inputs = found
        self._plan, self._age = (states, inputs), 0

    def _solved(
        self, states: np.ndarray, inputs: np.ndarray, curvature: np.ndarray, soil: np.ndarray, limits: Limits
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """The plan by one linearisation about states (N+1, 10) and inputs (N, 2), if it is found."""
        assert self._x is not None
        kappas = np.interp(states[:-1, _S], self._preview, curvature)
        return self._programme.solve(self._problem, self._x, states, inputs, soil, kappas, limits)

    def _strays(self, plan: tuple[np.ndarray, np.ndarray], curvature: np.ndarray, soil: np.ndarray) -> bool:
        """Whether the model leaves the plan where it is driven by the plan's inputs."""
        states, inputs = plan
        off = np.abs(self._rolled_out(inputs, curvature, soil) - states)[:, [_E, _V]]
        return not bool((off.max(axis=0) <= _STRAYS).all())

    def _drivable(
        self, inputs: np.ndarray, curvature: np.ndarray, soil: np.ndarray, limits: Limits
    ) -> tuple[np.ndarray, np.ndarray]:
        """The best drive on the way from inputs (N, 2) to those of a plan linearised about their drive.

        Steps are halved until the cost falls, as Newton's method does far from its end (J. Nocedal,
        S. J. Wright, Numerical Optimization, 2nd ed. 2006, section 3.1).
        """
        states = self._rolled_out(inputs, curvature, soil)
        for _ in range(_NEWTON):
            least = self._programme.cost(self._problem, states, inputs, limits)
            found = self._solved(states, inputs, curvature, soil, limits)
            if found is None:
                break
            for share in _SHARES:
                moved = inputs + share * (found[1] - inputs)
                drive = self._rolled_out(moved, curvature, soil)
                if self._programme.cost(self._problem, drive, moved, limits) < least:
                    states, inputs = drive, moved
                    break
            else:
                break
        return states, inputs

    def _rolled_out(self, inputs: np.ndarray, curvature: np.ndarray, soil: np.ndarray) -> np.ndarray:
        """States (N+1, 10) of the model with inputs (N, 2) from here."""
        assert self._x is not None
        states = [self._x]
        for row in inputs:
            kappa = float(np.interp(states[-1][_S], self._preview, curvature))
            states.append(np.asarray(self._problem.step(states[-1], row, soil, kappa)).ravel())
        return np.array(states)

    def _guess(self) -> tuple[np.ndarray, np.ndarray]:
        """States (N+1, 10) and inputs (N, 2) to linearise about."""
        assert self._x is not None
        stages, dt = self.settings.horizon
        if self._plan is None:
            states = np.tile(self._x, (stages + 1, 1))
            states[:, _S] = np.arange(stages + 1) * dt * self._x[_V]
            return states, np.zeros((stages, len(INPUTS)))
        old, inputs = self._plan
        passed = self._age * self._briefing.dt / dt
        places = np.minimum(np.arange(stages + 1) + passed, stages)
        states = np.column_stack([np.interp(places, np.arange(stages + 1), column) for column in old.T])
        states[:, _S] -= states[0, _S]
        shift = np.minimum(np.arange(stages) + passed, stages - 1)
        moved = np.column_stack([np.interp(shift, np.arange(stages), column) for column in inputs.T])
        return states, moved[:, : len(INPUTS)]

    def _profile(self, highest: np.ndarray, braking: float) -> np.ndarray:
        """(S,) speeds from which all later ones can be met with this deceleration [m/s^2]."""
        at = self._stations
        return np.array([planned_speed(highest, at, braking, float(station)) for station in at])

    def _limits(self, senses: Senses, belief: Belief, soil: np.ndarray) -> Limits:
        """Bounds of the plan."""
        s, v, table = self.settings, self._vehicle, self._table
        lateral = table.lateral_limit(belief.low, belief.high, s.slip_angle)
        braking = s.brake_share * table.braking_limit(belief.low, belief.high)
        curvature = np.interp(self._stations, self._preview, senses.curvature)
        speeds, final = (
            self._profile(speed_limit(curvature, share * lateral, s.speed_max), braking)
            for share in (s.inside, s.beyond)
        )
        if senses.target_speed > 0.0:
            speeds, final = (np.minimum(row, senses.target_speed) for row in (speeds, final))
        hold = soil[SOIL.index("hold")]
        resistance = soil[SOIL.index("resistance")]
        most = v.drive_torque_max / v.r
        most /= math.hypot(1.0, most * max(*senses.rim_speed, senses.speed) / v.power_max)
        push = min(most / v.m, 0.9 * hold + resistance)
        brake = -min(v.brake_torque_max / (v.r * v.m), s.braking * hold)
        return Limits(
            corridor=s.corridor * self._briefing.corridor,
            slip=s.slip_angle,
            steer=v.steer_max,
            steer_rate=v.steer_rate,
            push=max(push, 0.5),
            brake=min(brake, -0.5),
            stations=self._stations,
            speeds=speeds,
            final=final,
        )
