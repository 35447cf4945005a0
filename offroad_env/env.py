"""The environment ``OffroadBekker-v0``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from estimators.embedded import EmbeddedParameterUKF
from estimators.navigation import NavigationFilter
from estimators.protocol import Estimate
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.observation import PREVIEW, Layout, write_observation
from offroad_env.period import drive_full, drive_paper
from offroad_env.physics import state as at
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.packing import pack
from offroad_env.physics.path_kernels import nearest_index, project
from offroad_env.physics.records import Soil, SoilMap, Vehicle
from offroad_env.physics.sensor_kernels import CHANNELS, GNSS, IMU, WHEEL
from offroad_env.rewards import (
    SHAKE_TIME,
    STANDING,
    Moment,
    Outcome,
    broken_rule,
    reached_goal,
    reward_terms,
)
from offroad_env.scenarios import Course, Scenario, find_scenario
from offroad_env.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulator import (
    FULL_STEP,
    MODELS,
    PAPER_SLIP,
    VEHICLE_MODELS,
    Plant,
    make_plant,
    settled_state,
)
from offroad_env.soils import SOILS, make_soil
from offroad_env.terrain import flat, soil_map, soil_patches_along
from offroad_env.vehicles import VEHICLES, make_vehicle

__all__ = ["CONTROL_PERIOD", "PREVIEW", "TERRAIN_INFO", "Briefing", "OffroadBekkerEnv", "Snapshot"]

CONTROL_PERIOD = 0.02  #: time between actions [s]
TERRAIN_INFO = ("none", "estimate", "truth")
ESTIMATORS = ("parameter", "none")

_SAMPLES = 2  # IMU samples per control period
_STEPS = round(CONTROL_PERIOD / _SAMPLES / FULL_STEP)  # steps of the plant per IMU sample
_PAPER_FORCE = 3.0  # body force at full drive, per unit of mass [m/s^2]: above the paper's largest, 2.4
_STUCK_TIME, _STUCK_DRIVE = 4.0, 0.3  # [s], [-]
_ROLLOVER_TIME = 0.2  # [s]


@dataclass(frozen=True, kw_only=True)
class Briefing:
    """What a controller may know before it starts; the same whatever the true soil is."""

    scenario: str
    vehicle: Vehicle  #: nominal vehicle
    soil: Soil  #: believed soil, with n at the middle of ``n_range``
    n_range: tuple[float, float]  #: prior of the sinkage exponent: uniform [-]
    corridor: float  #: half width [m]
    target_speed: float  #: [m/s], 0 = as fast as possible
    time_limit: float  #: [s]
    stop_zone: float  #: > 0: stand within this distance before the end of the path [m]
    shake_limit: float  #: largest running r.m.s. of the vertical acceleration [m/s^2]
    preview: tuple[float, ...] = PREVIEW  #: distances of the observed curvatures [m]
    dt: float = CONTROL_PERIOD  #: [s]
    shear: str = "resultant"  #: shear law of the model, for `wheel_forces`


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The truth at one moment, for pictures and logs: arrays are copies, nothing leads back."""

    scenario: Scenario
    course: Course
    plant: Plant  #: true vehicle, soil and ground
    model: str
    terrain_info: str
    time: float  #: [s]
    state: np.ndarray  #: (15,), see `offroad_env.physics.state`
    readings: np.ndarray  #: (32,), see `offroad_env.physics.state`
    command: tuple[float, float]  #: the last action: steering, drive [-]
    progress: float  #: distance along the path [m]
    cross_track_error: float  #: [m], left positive
    n_range: tuple[float, float]  #: prior of the sinkage exponent: uniform [-]
    estimate: Estimate | None  #: None where no estimator runs
    ending: str  #: "" while the episode goes on, "goal", or the failure


class OffroadBekkerEnv(gym.Env):
    """Drive a vehicle along a path over soil whose sinkage exponent n nobody tells you.

    ## Action: Box(-1, 1, (2,), float32)
    | index | meaning | in SI |
    |---|---|---|
    | 0 | steering, left positive | times ``vehicle.steer_max`` [rad] |
    | 1 | drive (positive), brake (negative) | times ``drive_torque_max`` or ``brake_torque_max`` [N m] |

    Values outside [-1, 1] are clipped; NaN or infinity raises `InvalidParameter`. With
    ``model="paper"`` steering acts at once and index 1 is a body force of up to 3 m [N] either way.

    ## Observation: Dict, float32
    | key | shape | content |
    |---|---|---|
    | ``imu`` | (5,) | a_x, a_y, a_z [m/s^2], pitch rate, yaw rate [rad/s]: mean of the period's two samples |
    | ``motion`` | (5,) | speed [m/s], rim speed front, rear [m/s], last steering [rad], last drive [-] |
    | ``path`` | (12,) | cross-track error [m] (left positive), heading error [rad], target speed [m/s] |
    | | | (0 = as fast as possible), curvature [1/m] at 0, 3, 6, 10, 15, 20, 30, 40 m ahead, |
    | | | way to the end of the path [m] |
    | ``terrain`` | (3,) | n, its standard deviation, valid (0/1); absent with ``terrain_info="none"`` |

    The estimator believes in the nominal vehicle and in flat ground; only of the hill of "climb" it
    has a map, without the roughness.
    Everything comes from simulated sensors (IMU 100 Hz, wheel speeds 50 Hz, GNSS 10 Hz, with the
    paper's IMU noise) through a navigation filter, never from the simulator's state; ``terrain`` with
    ``terrain_info="truth"``, n under the front wheels, is the exception it says it is. Values are
    clipped to the space.

    ## Reward
    0.1 per metre of progress along the path, less the cost of time, of distance from the path, of
    missing the target speed and of restless actions; 10 on arrival. A failure costs all that an
    episode could cost otherwise, so that nobody gains by ending it. ``info["reward_terms"]`` names the
    terms, which add up to the reward. "climb" has weights of its own (`offroad_env.scenarios`).

    ## Start and end
    Settled on the soil, on the path, rolling. n is drawn uniformly from ``n_range``;
    ``reset(options={"n": 0.7})`` sets it. Terminates at the goal (``info["success"]``) or with
    ``info["failure"]``: "left_corridor", "rollover" (the lateral acceleration holds the inner wheels off
    the ground for 0.2 s), "immobilised" (no motion for 4 s of drive, or sunk beyond the wheel),
    "overran" (the line of "brake"), "too_rough" (the limit of "ride"), "diverged". Truncates after the
    task's time limit (120 s, "brake" 40 s).

    ## Arguments
    scenario : "track", "speed", "climb", "brake", "ride" or "patches" (`offroad_env.SCENARIOS`)
    terrain_info : "none", "estimate" or "truth"
    model : "full" (wheel spin, slopes) or "paper" (Buzhardt & Tallapragada, ACC 2021)
    vehicle_model : "half_car" or "bicycle"
    estimator : "parameter" or "none"; None runs the parameter UKF when ``terrain_info="estimate"``
    n_range : (low, high) of the sinkage exponent, default the scenario's
    soil, vehicle : names in `SOILS` and `VEHICLES`, default the scenario's

    ## Info
    The same keys at every step: true soil (``n, n_front, n_rear``), ``sinkage`` [m] and ``slip`` (front,
    rear), ``cross_track_error`` [m], ``heading_error`` [rad], ``progress`` and ``path_length`` [m],
    ``speed`` [m/s], ``shake`` (running r.m.s. of the vertical acceleration) [m/s^2], ``time`` [s], the
    estimator's ``n_estimate``, ``n_estimate_sd``, ``nis`` and ``filter_repairs`` (the prior and zeros
    when none runs), ``reward_terms``, ``success``, ``failure``.

    ## Versions
    v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012 - Gymnasium's form

    def __init__(  # noqa: PLR0913 - the environment's arguments are its interface
        self,
        *,
        scenario: str = "track",
        terrain_info: str = "none",
        model: str = "full",
        vehicle_model: str = "half_car",
        estimator: str | None = None,
        n_range: tuple[float, float] | None = None,
        soil: str | None = None,
        vehicle: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.scenario: Scenario = find_scenario(scenario)
        if estimator is None:
            estimator = "parameter" if terrain_info == "estimate" else "none"
        for name, value, allowed in (
            ("terrain_info", terrain_info, TERRAIN_INFO),
            ("model", model, MODELS),
            ("vehicle_model", vehicle_model, VEHICLE_MODELS),
            ("estimator", estimator, ESTIMATORS),
            ("render_mode", render_mode, (None, *self.metadata["render_modes"])),
        ):
            if value not in allowed:
                raise InvalidParameter(f"{name} must be one of {', '.join(map(str, allowed))}, got {value!r}")
        if terrain_info == "estimate" and estimator == "none":
            raise InvalidParameter('terrain_info="estimate" needs an estimator, got estimator="none"')
        self.terrain_info, self.model, self.vehicle_model = terrain_info, model, vehicle_model
        self.render_mode = render_mode
        self.soil_name = self.scenario.soil if soil is None else soil
        self.n_range = self._checked_range(self.scenario.n_range if n_range is None else n_range)
        self.vehicle: Vehicle = VEHICLES[self.scenario.vehicle if vehicle is None else vehicle]
        low, high = self.n_range
        self.prior = (0.5 * (low + high), max((high - low) / math.sqrt(12.0), 1e-3))
        self._believed_soil = make_soil(SOILS[self.soil_name], n=self.prior[0])
        if estimator != "none" and self._believed_soil.rigid:
            raise InvalidParameter(f'estimator="{estimator}" needs a deformable soil, got {self.soil_name!r}')
        self._require_bearing()
        self.weights = self.scenario.weights
        self.sensors = SensorSuite(
            imu=ImuConfig(body_axes=model == "full"), wheel=WheelSpeedConfig(), gnss=GnssConfig()
        )
        self._navigation = NavigationFilter(self.vehicle)
        self._estimator_name = estimator
        self.estimator: EmbeddedParameterUKF | None = None
        self._layout = Layout(self.vehicle.steer_max, terrain=terrain_info != "none")
        self._flat = self._layout.empty()
        self._renderer: Any = None
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = self._layout.space()

    def _checked_range(self, limits: tuple[float, float]) -> tuple[float, float]:
        try:
            low, high = (float(value) for value in limits)
        except (TypeError, ValueError) as error:
            raise InvalidParameter(f"n_range must be (low, high), got {limits!r}") from error
        if not low <= high:
            raise InvalidParameter(f"n_range must be (low, high) with low <= high, got {limits!r}")
        for n in (low, high):
            make_soil(SOILS[self.soil_name], n=n)
        return low, high

    def _require_bearing(self) -> None:
        """Refuse a range of soils in which the standing vehicle drowns: a reset would fail much later."""
        for n in self.n_range:
            soil = make_soil(self._believed_soil, n=n)
            try:
                settled_state(make_plant(self.vehicle, soil, flat(), model=self.model))
            except SolverFailure as error:
                raise InvalidParameter(
                    f"n_range {self.n_range} of {self.soil_name!r} reaches soil that drowns it: {error}"
                ) from error

    def _believed_range(self) -> tuple[float, float]:
        """``n_range``, widened to 0.1 where it holds a single soil: a filter needs something to estimate."""
        low, high = self.n_range
        widen = max(0.05 - 0.5 * (high - low), 0.0)
        return max(low - widen, 0.06), high + widen

    @property
    def briefing(self) -> Briefing:
        """What a controller may know before it starts."""
        return Briefing(
            scenario=self.scenario.name,
            vehicle=self.vehicle,
            soil=self._believed_soil,
            n_range=self.n_range,
            corridor=self.scenario.corridor,
            target_speed=self.scenario.target_speed,
            time_limit=self.scenario.time_limit,
            stop_zone=self.scenario.stop_zone,
            shake_limit=self.scenario.shake_limit,
            shear="resultant" if self.model == "full" else "independent",
        )

    # ------------------------------------------------------------------ episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode. ``options={"n": value}`` sets the sinkage exponent of the true soil.

        ``options={"mismatch": (mass, k_phi, lag)}`` multiplies the true vehicle's mass and torque lag and
        the true soil's k_phi by these factors; what estimator and briefing hold stays nominal. The draws
        happen in the same order whatever is observed: same seed, same episode.
        """
        super().reset(seed=seed)
        options = self._checked_options(options)
        n = self._chosen_exponent(options, drawn=float(self.np_random.uniform(*self.n_range)))
        self.course: Course = self.scenario.draw(self.np_random)
        self._path_length = self.course.path.length
        self.sensors.reset(self.np_random)
        self._sensor_errors = self.sensors.errors
        slip = PAPER_SLIP.get(self.soil_name, 0.0)
        kinds = {"model": self.model, "vehicle_model": self.vehicle_model, "slip": slip}
        vehicle, truth = self._true_parts(n, options.get("mismatch"))
        self.plant = make_plant(vehicle, truth, self.course.ground, soil_map=self._soil_map(), **kinds)
        self._packed = pack(self.plant)
        X, Y, yaw = (float(value) for value in self.course.path.nodes[0, :3])
        start = self.scenario.start_speed
        self.state, self.warm = settled_state(self.plant, x=X, y=Y, yaw=yaw, v_x=start)
        self.readings = np.zeros(at.READINGS_SIZE)
        self._time = 0.0
        self._last_action = np.zeros(2)
        self._stuck_for = self._tilting_for = self._mean_square = 0.0
        self._navigation.reset(X, Y, yaw, start)
        self._rims = np.full(2, start)
        self._true_index = nearest_index(self.course.path, X, Y)
        self._seen_index = self._true_index
        self._estimate = Estimate(*self.prior, 0.0, False, 0)
        if self._estimator_name == "parameter":
            belief = make_plant(self.vehicle, self._believed_soil, self.course.known_ground, **kinds)
            self.estimator = EmbeddedParameterUKF(
                belief, self._believed_range(), dt=CONTROL_PERIOD / _SAMPLES, imu=self.sensors.imu
            )
            self.estimator.reset(*self.prior, self._navigation.pose)
        # The start is a state, not an interval: readings of the state itself, one sample of the sensors.
        self._drive((0.0, 0.0), 1, 0)
        self._progress = self._locate_truth()[0]
        terms = dict.fromkeys(self._terms(0.0, 0.0, False, False), 0.0)
        observation = self._observe()
        info = self._info(terms, success=False, failure="")
        if self.render_mode == "human":
            self.render()
        return observation, info

    def _soil_map(self) -> SoilMap:
        """Stretches of the course where n is another, by their places in ``n_range``."""
        low, high = self.n_range
        sections = [(start, end, low + place * (high - low)) for start, end, place in self.course.sections]
        return soil_patches_along(self.course.path, sections) if sections else soil_map()

    def _checked_options(self, options: dict[str, Any] | None) -> dict[str, Any]:
        unknown = set(options or {}) - {"n", "mismatch"}
        if unknown:
            raise InvalidParameter(f'options may hold "n" and "mismatch", got {", ".join(sorted(unknown))}')
        return options or {}

    def _chosen_exponent(self, options: dict[str, Any], drawn: float) -> float:
        return drawn if options.get("n") is None else make_soil(self._believed_soil, n=options["n"]).n

    def _true_parts(self, n: float, mismatch: tuple[float, float, float] | None) -> tuple[Vehicle, Soil]:
        """The true vehicle and soil: nominal, but for n and the factors of a mismatch."""
        if mismatch is None:
            return self.vehicle, make_soil(self._believed_soil, n=n)
        mass, k_phi, lag = (float(factor) for factor in mismatch)
        vehicle, soil = self.vehicle, self._believed_soil
        return (
            make_vehicle(vehicle, m=mass * vehicle.m, torque_lag=lag * vehicle.torque_lag),
            make_soil(soil, n=n, k_phi=k_phi * soil.k_phi),
        )

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Hold ``action`` for 0.02 s. See the class for its meaning and the results."""
        steer, drive = self._checked_action(action)
        status = self._drive((steer, drive), _SAMPLES, _STEPS)
        self._time += CONTROL_PERIOD
        progress = self._progress if status >= NO_ROOT else self._locate_truth()[0]
        self._mean_square += CONTROL_PERIOD / SHAKE_TIME * (self.readings[at.A_Z] ** 2 - self._mean_square)
        moment = Moment(progress, self._path_length, self._where[1], self._speed(), self._shake())
        failure = self._failure(status, drive, moment)
        success = not failure and reached_goal(self.scenario.rules, moment)
        change = float((steer - self._last_action[0]) ** 2 + (drive - self._last_action[1]) ** 2)
        self._last_action[:] = steer, drive
        failed = bool(failure) and not (failure == "immobilised" and self.scenario.stalling)
        terms = self._terms(progress - self._progress, change, success, failed)
        self._progress = progress
        observation = self._layout.split(self._flat) if status >= SUNK else self._observe()
        info = self._info(terms, success=success, failure=failure)
        if self.render_mode == "human":
            self.render()
        over = success or bool(failure)
        late = not over and self._time > self.scenario.time_limit - 0.5 * CONTROL_PERIOD
        return observation, float(sum(terms.values())), over, late, info

    def _checked_action(self, action: np.ndarray) -> tuple[float, float]:
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (2,) or not np.isfinite(values).all():
            raise InvalidParameter(f"action must be 2 finite numbers (steer, drive), got {action!r}")
        return min(max(float(values[0]), -1.0), 1.0), min(max(float(values[1]), -1.0), 1.0)

    # ------------------------------------------------------------------ physics and sensors

    def _command(self, action: tuple[float, float]) -> tuple[float, float, float]:
        steer, drive = action
        angle = steer * self.vehicle.steer_max
        if self.model == "paper":
            return angle, drive * _PAPER_FORCE * self.vehicle.m, math.nan
        return (
            angle,
            max(drive, 0.0) * self.vehicle.drive_torque_max,
            max(-drive, 0.0) * self.vehicle.brake_torque_max,
        )

    def _drive(self, action: tuple[float, float], samples: int, steps: int) -> float:
        """Advance the truth and everything that watches it; returns the worst contact status.

        The estimator sees the samples and the command, as navigation does, and nothing of the truth.
        """
        command = self._command(action)
        self._samples = np.zeros((samples, CHANNELS))
        drive = drive_full if self.model == "full" else drive_paper
        status = drive(
            (self.state, self.warm, self._packed, self.readings),
            command,
            (
                self.sensors.mount,
                self._sensor_errors,
                *self.sensors.draw(samples),
                self._rims,
                self._samples,
            ),
            self._navigation.arguments,
            (FULL_STEP, steps, CONTROL_PERIOD / _SAMPLES if steps else 0.0),
        )
        if status >= NO_ROOT:
            # What is reported of a diverged episode is its last sound state, never a NaN.
            self.state[:], self.readings[:] = self._sound
            return status
        self._sound = self.state.copy(), self.readings.copy()
        if status < SUNK and self.estimator is not None:
            for sample in self._samples:
                self._estimate = self.estimator.update(command, sample[IMU], sample[WHEEL], sample[GNSS])
        return status

    def _locate_truth(self) -> tuple[float, float, float]:
        """(distance along the path, cross-track error, heading error) of the true vehicle."""
        X, Y, yaw = float(self.state[at.X]), float(self.state[at.Y]), float(self.state[at.YAW])
        s, error, path_yaw, _, self._true_index = project(self.course.path, X, Y, self._true_index)
        self._where = (s, error, _wrapped(yaw - path_yaw))
        return self._where

    def _shake(self) -> float:
        """Running r.m.s. of the vertical acceleration [m/s^2]."""
        return math.sqrt(self._mean_square)

    def _failure(self, status: float, drive: float, moment: Moment) -> str:
        if status >= NO_ROOT:
            return "diverged"
        if status >= SUNK:
            return "immobilised"
        broken = broken_rule(self.scenario.rules, moment)
        if broken:
            return broken
        lateral = abs(self.readings[at.A_Y]) * self.vehicle.h_cg
        tilting = lateral > 0.5 * GRAVITY * self.vehicle.track
        self._tilting_for = self._tilting_for + CONTROL_PERIOD if tilting else 0.0
        if self._tilting_for > _ROLLOVER_TIME:
            return "rollover"
        pushing = drive > _STUCK_DRIVE or self.scenario.stalling
        stuck = pushing and self._speed() < STANDING
        self._stuck_for = self._stuck_for + CONTROL_PERIOD if stuck else 0.0
        return "immobilised" if self._stuck_for > _STUCK_TIME else ""

    def _speed(self) -> float:
        return math.hypot(self.state[at.V_X], self.state[at.V_Y])

    # ------------------------------------------------------------------ what is returned

    def _terms(self, advance: float, change: float, success: bool, failed: bool) -> dict[str, float]:
        outcome = Outcome(advance, self._where[1], self._speed(), change, success, failed)
        return reward_terms(
            self.scenario.rules, self.weights, self.scenario.target_speed, outcome, CONTROL_PERIOD
        )

    def _observe(self) -> dict[str, np.ndarray]:
        terrain = (float(self._estimate.mean), float(self._estimate.sd), float(self._estimate.valid))
        if self.terrain_info == "truth":
            terrain = (float(self.readings[at.EXPONENT]), 0.0, 1.0)
        steer, drive = float(self._last_action[0]), float(self._last_action[1])
        rims = (float(self._rims[0]), float(self._rims[1]))
        self._seen_index = write_observation(
            self.course.path,
            (*self._navigation.pose, self._seen_index),
            self._samples,
            (*rims, steer * self.vehicle.steer_max, drive, self.scenario.target_speed, *terrain),
            (*self._layout.shown, self._path_length),
            self._flat,
        )
        return self._layout.split(self._flat)

    def _info(self, terms: dict[str, float], *, success: bool, failure: str) -> dict[str, Any]:
        self._ending = "goal" if success else failure
        s, error, heading_error = self._where
        front, rear = self.readings[: at.AXLE], self.readings[at.AXLE : at.MOTION]
        return {
            "n": self.plant.soil.n,
            "n_front": float(front[at.EXPONENT]),
            "n_rear": float(rear[at.EXPONENT]),
            "sinkage": np.array([front[at.SINKAGE], rear[at.SINKAGE]]),
            "slip": np.array([front[at.SLIP], rear[at.SLIP]]),
            "cross_track_error": error,
            "heading_error": heading_error,
            "progress": s,
            "path_length": self._path_length,
            "speed": self._speed(),
            "shake": self._shake(),
            "time": self._time,
            "n_estimate": self._estimate.mean,
            "n_estimate_sd": self._estimate.sd,
            "nis": self._estimate.nis if math.isfinite(self._estimate.nis) else 0.0,
            "filter_repairs": self._estimate.repairs,
            "reward_terms": terms,
            "success": success,
            "failure": failure,
        }

    # ------------------------------------------------------------------ pictures

    def snapshot(self) -> Snapshot:
        """The truth at this moment, in copies; needs a `reset` before."""
        return Snapshot(
            scenario=self.scenario,
            course=self.course,
            plant=self.plant,
            model=self.model,
            terrain_info=self.terrain_info,
            time=self._time,
            state=self.state.copy(),
            readings=self.readings.copy(),
            command=(float(self._last_action[0]), float(self._last_action[1])),
            progress=self._where[0],
            cross_track_error=self._where[1],
            n_range=self.n_range,
            estimate=None if self.estimator is None else self._estimate,
            ending=self._ending,
        )

    def render(self) -> np.ndarray | None:
        """Draw the vehicle from above and from the side, and n over time; needs the extra ``view``."""
        if self.render_mode is None:
            gym.logger.warn('render() does nothing without render_mode="human" or "rgb_array"')
            return None
        if self._renderer is None:
            from offroad_env.rendering import Renderer

            self._renderer = Renderer(self.render_mode, fps=self.metadata["render_fps"])
        return self._renderer.draw(self)

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def _wrapped(angle: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)
