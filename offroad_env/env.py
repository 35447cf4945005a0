"""The environment ``OffroadBekker-v0``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from estimators.carried import KINDS, OnBoard, make_estimator
from estimators.embedded import CHANGING_SOIL, EmbeddedParameterUKF
from estimators.navigation import NavigationFilter
from estimators.protocol import Estimate, Estimator
from offroad_env.effects import Extension, read_extension
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.extended import ExtendedTruth
from offroad_env.memory import LAST_ROW, NOISE_ROWS, Memory
from offroad_env.observation import PREVIEW, Layout
from offroad_env.period import (
    BELIEVE,
    CONTROL_PERIOD,
    DRIVE,
    FIRST_TERM,
    PAPER_FORCE,
    REPORT,
    REPORTED,
    SAMPLES,
    announce_compilation,
    period_full,
    period_paper,
)
from offroad_env.physics.contact import SUNK
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.packing import pack
from offroad_env.physics.path_kernels import nearest_index
from offroad_env.physics.records import Soil, SoilMap, Vehicle
from offroad_env.physics.sensor_kernels import GNSS, IMU, WHEEL
from offroad_env.rewards import ENDINGS, TERMS
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

__all__ = [
    "CONTROL_PERIOD",
    "PREVIEW",
    "TERRAIN_INFO",
    "Briefing",
    "Measurements",
    "OffroadBekkerEnv",
    "Snapshot",
]

TERRAIN_INFO = ("none", "estimate", "truth")
ESTIMATORS = (*KINDS, "none")

_STEPS = round(CONTROL_PERIOD / SAMPLES / FULL_STEP)  # steps of the plant per IMU sample
_EVERYTHING = DRIVE | BELIEVE | REPORT
_SINKAGE, _SLIP = REPORTED["sinkage"], REPORTED["slip"]


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
class Measurements:
    """What was commanded and what the sensors said in the last control period, in copies."""

    command: tuple[float, float, float]  #: as the kernels take it, see `OffroadBekkerEnv.command`
    samples: np.ndarray  #: (S, 11) of every sensor, `physics.sensor_kernels`; none where the period broke off
    period: float  #: time between samples [s]


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
    has a map, without the roughness. On "patches" the parameter UKF is told that n changes on the way.
    Everything comes from simulated sensors (IMU 100 Hz, wheel speeds 50 Hz, GNSS 10 Hz, with the
    paper's IMU noise) through a navigation filter, never from the simulator's state; ``terrain`` with
    ``terrain_info="truth"``, n under the front wheels, is the exception it says it is. Values are
    clipped to the space.

    ## Reward
    0.1 per metre of progress along the path, less the cost of time, of distance from the path, of
    missing the target speed and of restless actions; 10 on arrival. A failure costs all that an
    episode could cost otherwise, so that nobody gains by ending it. ``info["reward_terms"]`` names the
    terms, which add up to the reward. "climb" and "brake" have weights of their own.

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
    model : "full" (wheel spin, slopes) or "paper" (Buzhardt & Tallapragada, ACC 2021), or the file of an
        extended model that ``offroad diagnose`` has written: the truth then has its effects
    vehicle_model : "half_car" or "bicycle"
    estimator : "parameter", "joint", "bank" or "none"; None runs the parameter UKF when
        ``terrain_info="estimate"``. An `estimators.carried.OnBoard` also says at what rate, and which
        vehicle, soil and ground it believes in, rightly or wrongly
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
        estimator: str | OnBoard | None = None,
        n_range: tuple[float, float] | None = None,
        soil: str | None = None,
        vehicle: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.scenario: Scenario = find_scenario(scenario)
        if estimator is None:
            estimator = "parameter" if terrain_info == "estimate" else "none"
        self.extension: Extension | None = read_extension(model) if model.endswith(".json") else None
        model = model if self.extension is None else self.extension.model
        for name, value, allowed in (
            ("terrain_info", terrain_info, TERRAIN_INFO),
            ("model", model, MODELS),
            ("vehicle_model", vehicle_model, VEHICLE_MODELS),
            ("estimator", estimator.kind if isinstance(estimator, OnBoard) else estimator, ESTIMATORS),
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
            raise InvalidParameter(f"estimator={estimator!r} needs a deformable soil, got {self.soil_name!r}")
        announce_compilation()
        self._require_bearing()
        self.weights = self.scenario.weights
        self.sensors = SensorSuite(
            imu=ImuConfig(body_axes=model == "full"), wheel=WheelSpeedConfig(), gnss=GnssConfig()
        )
        self._navigation = NavigationFilter(self.vehicle)
        #: "parameter" runs inside the compiled period; whatever else is carried stands beside it.
        self._choice = OnBoard(kind=estimator) if estimator in ("joint", "bank") else estimator
        self.estimator: Estimator | None = None
        self._extended: ExtendedTruth | None = None  # drives where the compiled period knows no effects
        self._layout = Layout(self.vehicle.steer_max, terrain=terrain_info != "none")
        self._renderer: Any = None
        self._learner: EmbeddedParameterUKF | None = None  # the estimator that the compiled period carries
        self.join(Memory(1), 0)
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
        X, Y, yaw = (float(value) for value in self.course.path.nodes[0, :3])
        start = self.scenario.start_speed
        if self.extension is not None:
            self._extended = ExtendedTruth(self.extension, self.plant, self.sensors.mount)
            self.plant = self._extended.setup.plant
        self.state[:], self.warm[:] = settled_state(self.plant, x=X, y=Y, yaw=yaw, v_x=start)
        self._start(X, Y, start)
        self._navigation.reset(X, Y, yaw, start)
        self.estimator = None
        self._learner = None
        belief = make_plant(self.vehicle, self._believed_soil, self.course.known_ground, **kinds)
        if isinstance(self._choice, OnBoard):
            imu, gnss = self.sensors.imu, self.sensors.gnss
            self.estimator = make_estimator(self._choice, belief, self._believed_range(), imu, gnss)
            self.estimator.reset(*self.prior, self._navigation.pose)
        elif self._choice == "parameter":
            self.estimator = self._learner = EmbeddedParameterUKF(
                belief,
                self._believed_range(),
                dt=CONTROL_PERIOD / SAMPLES,
                imu=self.sensors.imu,
                settings=CHANGING_SOIL if self.scenario.changing else None,
                navigation=self._navigation,
            )
            self._learner.reset(*self.prior, self._navigation.pose)
        self._lay_down_rules()
        self._bind()
        # The start is a state, not an interval: readings of the state itself, one sample of the sensors.
        self._episode["count"], self._episode["steps"] = 1, 0
        self._advance()
        self._episode["count"], self._episode["steps"] = SAMPLES, _STEPS
        info = self.result()[0]
        if self.render_mode == "human":
            self.render()
        return self._layout.split(self._shown), info

    def _start(self, X: float, Y: float, speed: float) -> None:
        """Write into the record what an episode starts with."""
        self.readings[:] = 0.0
        self._rims[:] = speed
        self._memory.lay_out(self._row, self.course.path, self.plant, self.course.known_ground)
        nearest = nearest_index(self.course.path, X, Y)
        mount, episode = self.sensors.mount, self._episode
        for name, value in (
            ("plant", pack(self.plant).numbers),
            ("n", self.plant.soil.n),
            ("errors", self.sensors.errors),
            ("lever", mount.lever),
            ("rotation", mount.rotation),
            ("mount", (mount.body_axes, mount.gravity)),
            ("every", self.sensors.every),
            ("tick", 0),
            ("noise_row", NOISE_ROWS - 1),
            ("estimate", (*self.prior, 0.0, 0.0, 0.0)),
            ("time", 0.0),
            ("action", 0.0),
            ("true_index", nearest),
            ("seen_index", nearest),
            ("tilting_for", 0.0),
            ("stuck_for", 0.0),
            ("mean_square", 0.0),
            ("ending", 0),
        ):
            episode[name] = value
        if self._extended is not None:
            episode["errors"] = self._extended.imperfect(self.sensors.errors)
        self.sensors.draw_noise(self._memory.noise[self._row, -1:])
        self._actions[:] = 0.0

    def _lay_down_rules(self) -> None:
        """Write down what holds for the whole episode."""
        v, rules = self.vehicle, self._memory.rules[0]
        for name, value in (
            ("dt", FULL_STEP),
            ("limits", (v.steer_max, v.drive_torque_max, v.brake_torque_max)),
            ("mass", v.m),
            ("tilt", 0.5 * GRAVITY * v.track / v.h_cg if v.h_cg > 0.0 else math.inf),
            ("axles", self._navigation.axles),
            ("navigation", self._navigation.constants),
            ("rules", self.scenario.rules),
            ("target_speed", self.scenario.target_speed),
            ("weights", self.weights.row(self.scenario.time_limit)),
            ("distances", PREVIEW),
            ("bounds", self._layout.bounds),
            ("truth_shown", self.terrain_info == "truth"),
        ):
            rules[name] = value
        self._memory.assumptions = None if self._learner is None else self._learner.assumptions

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
        values = np.asarray(action, dtype=np.float64)
        if values.shape != (2,) or not all(map(math.isfinite, values.tolist())):
            raise InvalidParameter(f"action must be 2 finite numbers (steer, drive), got {action!r}")
        self._actions[:] = values
        if self._episode["noise_row"] > LAST_ROW:
            self.draw_noise()
        self._advance()
        info, reward = self.result()
        if self.render_mode == "human":
            self.render()
        terminated = info["success"] or info["failure"] != ""
        late = not terminated and info["time"] > self.scenario.time_limit - 0.5 * CONTROL_PERIOD
        return self._layout.split(self._shown), reward, terminated, late, info

    # ------------------------------------------------------------------ memory

    def join(self, memory: Memory, row: int) -> None:
        """Live in that row of a memory from the next reset on."""
        self._memory, self._row = memory, row
        self._bind()

    def _bind(self) -> None:
        """Point at the own row: a copy of an array that was a view is none any more."""
        rows = slice(self._row, self._row + 1)
        self._arguments = self._memory.part(rows)
        self._episode = self._memory.episodes[self._row]
        self.state, self.warm = self._episode["state"], self._episode["warm"]
        self.readings, self._rims = self._episode["readings"], self._episode["rims"]
        self._samples, self._report = self._episode["samples"], self._episode["report"]
        self._actions, self._shown = self._memory.actions[self._row], self._memory.shown[self._row]
        self._navigation.lodge(self._episode["navigation"], self._episode["covariance"])
        if self._learner is not None:
            self._learner.lodge(self._memory.episodes["filter"][rows])

    @property
    def memory_size(self) -> int:
        """Bytes of the record that an episode lives in; its course and the noise lie beside it."""
        return self._memory.episodes.itemsize

    def __getstate__(self) -> dict[str, Any]:
        """Without the tuple of views, which would be stored once more."""
        return {key: value for key, value in self.__dict__.items() if key != "_arguments"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Views were copied as arrays of their own: look at the memory again."""
        self.__dict__.update(state)
        self._bind()

    def draw_noise(self) -> None:
        """Sensor noise of the next periods, for whoever runs the compiled period."""
        self.sensors.draw_noise(self._memory.noise[self._row])
        self._episode["noise_row"] = 0

    # ------------------------------------------------------------------ one period

    @property
    def is_compiled(self) -> bool:
        """Whether a period is one compiled call: no estimator, or the one that it carries."""
        return self.estimator is self._learner

    def _advance(self) -> None:
        """Move on by one period: the truth, everything that watches it, and what is reported of it."""
        phases = _EVERYTHING
        if self._extended is not None:
            self.drive_extended()
            phases = BELIEVE | REPORT
        if self.is_compiled:
            self._run(phases)
            return
        if self._memory.assumptions is not None:  # somebody has put another estimator in place of ours
            self._memory.assumptions = None
            self._bind()
        self._run(phases & ~REPORT)
        self.ask_estimator()
        self._run(REPORT)

    def drive_extended(self) -> None:
        """Move the truth of an extended model, which the compiled period cannot, by one period."""
        self._extended.drive(
            self._episode, self._actions, lambda: self.command, self._memory.noise[self._row]
        )

    def ask_estimator(self) -> None:
        """Show the period's samples to an estimator that the compiled period does not carry.

        It sees them and the command, and nothing of the truth.
        """
        if self._episode["status"] >= SUNK:
            return
        for sample in self._samples[: self._episode["count"]]:
            mean, sd, nis, valid, repairs = self.estimator.update(
                self.command, sample[IMU], sample[WHEEL], sample[GNSS]
            )
        self._episode["estimate"] = mean, sd, nis, float(valid), repairs

    def _run(self, phases: int) -> None:
        self._episode["phases"] = phases
        (period_full if self.model == "full" else period_paper)(*self._arguments)

    @property
    def command(self) -> tuple[float, float, float]:
        """The last action as a command: steering [rad], drive and brake torque [N m] (paper: force, NaN)."""
        steer, drive = self._episode["action"].tolist()
        angle = steer * self.vehicle.steer_max
        if self.model == "paper":
            return angle, drive * PAPER_FORCE * self.vehicle.m, math.nan
        return (
            angle,
            max(drive, 0.0) * self.vehicle.drive_torque_max,
            max(-drive, 0.0) * self.vehicle.brake_torque_max,
        )

    def result(self) -> tuple[dict[str, Any], float]:
        """``info`` and the reward, from the report of the period."""
        report = self._report
        numbers = report.tolist()
        terms = numbers[FIRST_TERM:]
        ending = ENDINGS[self._episode["ending"]]
        return {
            "n": self.plant.soil.n,
            "n_front": numbers[0],
            "n_rear": numbers[1],
            "sinkage": report[_SINKAGE].copy(),
            "slip": report[_SLIP].copy(),
            "cross_track_error": numbers[6],
            "heading_error": numbers[7],
            "progress": numbers[8],
            "path_length": self._path_length,
            "speed": numbers[9],
            "shake": numbers[15],
            "time": numbers[10],
            "n_estimate": numbers[11],
            "n_estimate_sd": numbers[12],
            "nis": numbers[13],
            "filter_repairs": int(numbers[14]),
            "reward_terms": dict(zip(TERMS, terms, strict=True)),
            "success": ending == "goal",
            "failure": "" if ending == "goal" else ending,
        }, sum(terms)

    # ------------------------------------------------------------------ logs and pictures

    def measurements(self) -> Measurements:
        """Command and samples of the last control period, or the one sample at the start after a reset."""
        episode = self._episode
        count = 0 if episode["status"] >= SUNK else SAMPLES if episode["time"] > 0.0 else 1
        return Measurements(
            command=self.command, samples=self._samples[:count].copy(), period=CONTROL_PERIOD / SAMPLES
        )

    def snapshot(self) -> Snapshot:
        """The truth at this moment, in copies; needs a `reset` before."""
        episode = self._episode
        estimate = Estimate(*episode["estimate"][:3].tolist(), *map(int, episode["estimate"][3:]))
        return Snapshot(
            scenario=self.scenario,
            course=self.course,
            plant=self.plant,
            model=self.model,
            terrain_info=self.terrain_info,
            time=float(episode["time"]),
            state=self.state.copy(),
            readings=self.readings.copy(),
            command=tuple(episode["action"].tolist()),
            progress=float(episode["where"][0]),
            cross_track_error=float(episode["where"][1]),
            n_range=self.n_range,
            estimate=None if self.estimator is None else estimate,
            ending=ENDINGS[episode["ending"]],
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
