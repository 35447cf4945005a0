"""The environment ``OffroadBekker-v0``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from estimators.filters.navigation import NavigationFilter, NavigationNoise
from estimators.filters.online import OnBoard, make_estimator
from estimators.filters.online_parameter_ukf import CHANGING_SOIL, OnlineParameterUKF
from estimators.filters.online_soil_belief import POPULATION_RANGE, population_n
from estimators.filters.protocol import Estimate, Estimator
from offroad_env.effects import Extension, read_extension
from offroad_env.environment.arguments import (
    COMPILED,
    SOIL_BELIEF,
    ResetOptions,
    believed_range,
    checked_actions,
    checked_estimator,
    command_of,
    require_choice,
    require_rate,
    require_seed,
)
from offroad_env.environment.choices import Choices, PlainSpec
from offroad_env.environment.control_period import BELIEVE, DRIVE, REPORT, announce_compilation
from offroad_env.environment.episode_records import (
    CONTROL_PERIOD,
    LAST_ROW,
    NOISE_ROWS,
    SAMPLES,
    Memory,
    PlantSizes,
    info_of,
)
from offroad_env.environment.episode_row import EpisodeRow
from offroad_env.environment.extended import ExtendedTruth
from offroad_env.environment.observation import PREVIEW, SHOWN, Layout
from offroad_env.environment.plants import PlantChoice
from offroad_env.environment.randomisation import Randomisation, Truth, apply_context
from offroad_env.environment.rewards import ENDINGS, RewardWeights
from offroad_env.environment.scenarios import Scenario
from offroad_env.environment.snapshot import Briefing, Measurements, Snapshot
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.contact import SUNK
from offroad_env.physics.imu import GNSS, IMU, WHEEL
from offroad_env.physics.packing import pack
from offroad_env.physics.records import Soil, Structure, Tyre, Vehicle
from offroad_env.simulation.drive import Command
from offroad_env.simulation.sensor_descriptions import SensorsLike, read_sensors
from offroad_env.simulation.sensors import GnssConfig, SensorSuite
from offroad_env.simulation.simulator import FULL_STEP, settled_state
from offroad_env.world.descriptions import Description, choose_structure, choose_tyre
from offroad_env.world.four_wheel_vehicles import FourWheelVehicle
from offroad_env.world.natural_soil import SoilSpread, spread_of
from offroad_env.world.soils import make_soil

if TYPE_CHECKING:
    from offroad_env.rendering import Renderer

__all__ = ["CONTROL_PERIOD", "PREVIEW", "TERRAIN_INFO", "Briefing", "Measurements"]
__all__ += ["OffroadBekkerEnv", "Snapshot"]

TERRAIN_INFO = ("none", "estimate", "truth", "belief", "limits")
_STEPS = round(CONTROL_PERIOD / SAMPLES / FULL_STEP)  # steps of the plant per IMU sample
_EVERYTHING = DRIVE | BELIEVE | REPORT
_VALID = SHOWN - 1  # where the flat observation has the flag of n
_DRAWS = 20  # most soils that are drawn for an episode until one carries the vehicle


class OffroadBekkerEnv(PlainSpec, EpisodeRow, gym.Env[dict[str, Any], np.ndarray]):
    """A vehicle follows a path over soil whose sinkage exponent n it does not know.

    ## Description
    A vehicle of the full model (wheel spin, suspension, slopes) or of Buzhardt & Tallapragada (ACC 2021)
    drives on deformable soil by Bekker and Wong. Its sensors are simulated: by default an IMU at 100 Hz with
    the paper's noise, wheel speeds at 50 Hz, GNSS at 10 Hz. A navigation filter makes the observed pose from
    them, and an estimator, where one runs, n and its standard deviation. Both assume the nominal vehicle and
    flat ground; of the hill of "climb" they have a map without the roughness. On "patches" the parameter UKF
    allows for an n that changes on the way. One action is held for 0.02 s.

    ## Action Space
    ``Box(-1, 1, (2,), float32)``; values outside are clipped, NaN or infinity raises `InvalidParameter`.

    | index | meaning | in SI |
    |---|---|---|
    | 0 | steering, left positive | times ``vehicle.steer_max`` [rad] |
    | 1 | drive (positive), brake (negative) | times ``drive_torque_max`` or ``brake_torque_max`` [N m] |

    With ``model="paper"`` steering acts at once and index 1 is a body force of up to 3 m [N] either way.

    ## Observation Space
    ``Dict`` of float32 arrays. Everything comes from the sensors, never from the simulator's state; the only
    exception is ``terrain`` with ``terrain_info="truth"``, n under the front wheels, or "limits". Values are
    clipped to the space.

    | key | shape | content |
    |---|---|---|
    | ``imu`` | (5,) | a_x, a_y, a_z [m/s^2], pitch rate, yaw rate [rad/s]: mean of the period's two samples |
    | ``motion`` | (5,) | speed [m/s], rim speed front, rear [m/s], last steering [rad], last drive [-] |
    | ``path`` | (12,) | cross-track error [m] (left positive), heading error [rad], target speed [m/s] |
    | | | (0 = as fast as possible), curvature [1/m] at 0, 3, 6, 10, 15, 20, 30, 40 m ahead, |
    | | | distance to the end of the path [m] |
    | ``terrain`` | (3,) | n, its sd, valid (0/1; 0 on hard ground); absent with ``terrain_info="none"`` |
    | | or (17,) | "belief": docs/details/what_the_soil_holds.md; "limits": the truth |

    ## Rewards
    0.1 per metre of progress along the path, less the cost of time, of distance from the path, of
    missing the target speed and of changes of the action; 10 on arrival. A failure costs all that an
    episode could cost otherwise, so that ending it early never pays. ``info["reward_terms"]`` names the
    terms, which add up to the reward. "climb" and "brake" have weights of their own.

    ## Starting State
    Settled on the soil, on the path, rolling. n is drawn uniformly from ``n_range``, but for own soils;
    ``reset(options={"n": 0.7})`` sets it, ``options={"context": {...}}`` any key of ``randomise``.
    ``options={"mismatch": (mass, k_phi, lag)}`` multiplies these properties. All of this changes the truth;
    the nominal vehicle, soil and sensors, which estimator and briefing hold, stay.

    ## Episode End
    Termination: the goal is reached (``info["success"]``), or ``info["failure"]`` is "left_corridor",
    "rollover" (the lateral acceleration holds the inner wheels off the ground for 0.2 s), "immobilised" (no
    motion for 4 s of drive, or sunk beyond the wheel), "overran" (the line of "brake"), "too_rough" (the
    limit of "ride") or "diverged". Truncation: the time limit of the task (120 s, "brake" 40 s).

    ## Arguments
    scenario : "track", "speed", "climb", "brake", "ride" or "patches" (`offroad_env.SCENARIOS`). Scenario,
        soil, vehicle, weights, sensors, structure, tyre: a name, an object, a mapping or YAML (docs/own.md)
    terrain_info : "none", "estimate", "truth", "belief" or "limits"
    model : "full", "paper", or the file of an extended model that ``offroad diagnose`` has written: the truth
        then has its effects
    vehicle_model : "half_car", "bicycle", or "four_wheel" with roll and a contact for every wheel
    estimator : "online_parameter_ukf", "online_joint_ukf", "online_ukf_bank" (in short "parameter", "joint",
        "bank") or "none"; None runs the parameter UKF when ``terrain_info="estimate"``. An
        `estimators.filters.online.OnBoard` also holds the rate, and vehicle, soil and ground of the filter's
        model, rightly or wrongly
    n_range : (low, high) of the sinkage exponent, default the scenario's: n is drawn from it, and it is the
        prior of the estimators
    soil, vehicle, weights : default the scenario's. A soil of your own keeps its n, unless ``n_range`` is
        given or ``randomise`` has n; of one named in the catalogue n is drawn
    sensors : one of `offroad_env.SENSORS` ("paper", "ideal", "automotive", "consumer"), or `make_sensors`
    structure : laws of the wheels, "full", "grid", "field" or departures from them ("grid,ruts=none"); None
        is "full". Estimators go on to assume "full"
    tyre : flexible tyres, a name in `offroad_env.TYRES`; they need structure "grid" or "field"
    natural_soil : True, or a `world.natural_soil.SoilSpread`: pressure, n, cohesion and friction angle vary
        over metres around the drawn soil
    randomise : what differs from episode to episode, ``{"vehicle.m": (1200.0, 1500.0)}`` or YAML: docs/own.md
    render_mode : None, "human" or "rgb_array"

    ## Info
    The same keys at every step: true soil (``n, n_front, n_rear``), ``sinkage`` [m] and ``slip`` (front,
    rear), ``cross_track_error`` [m], ``heading_error`` [rad], ``progress`` and ``path_length`` [m],
    ``speed`` [m/s], ``shake`` (running r.m.s. of the vertical acceleration) [m/s^2], ``time`` [s], the
    estimator's ``n_estimate``, ``n_estimate_sd``, ``nis`` and ``filter_repairs`` (the prior and zeros
    when none runs), ``reward_terms``, ``success``, ``failure``; ``context`` where anything is randomised.

    ## Version History
    v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 50}  # noqa: RUF012 - Gymnasium's form

    def __init__(  # noqa: PLR0913 - the environment's arguments are its interface
        self,
        *,
        scenario: Scenario | Description = "track",
        terrain_info: str = "none",
        model: str = "full",
        vehicle_model: str = "half_car",
        estimator: str | OnBoard | Mapping[str, Any] | None = None,
        n_range: tuple[float, float] | None = None,
        soil: Soil | Description | None = None,
        vehicle: Vehicle | FourWheelVehicle | Description | None = None,
        weights: RewardWeights | Description | None = None,
        sensors: SensorsLike = "paper",
        structure: Structure | Description | None = None,
        tyre: Tyre | Description | None = None,
        natural_soil: bool | SoilSpread | Mapping[str, float] = False,
        randomise: Randomisation | Description | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._choices = chosen = Choices.read(
            scenario, soil=soil, vehicle=vehicle, weights=weights, n_range=n_range, randomise=randomise
        )
        self.scenario, self.weights, self.n_range = chosen.scenario, chosen.weights, chosen.n_range
        require_choice("terrain_info", terrain_info, TERRAIN_INFO)
        estimator = checked_estimator(estimator, terrain_info, model)
        own = isinstance(model, str) and model.endswith(".json")
        self.extension: Extension | None = read_extension(model) if own else None
        if self.extension is not None:
            model, structure, vehicle_model = self.extension.choices(structure, vehicle_model)
            self.extension = self.extension if self.extension.effects else None  # what is left is the plant's
        require_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        self.terrain_info, self.model, self.vehicle_model = terrain_info, model, vehicle_model  #: as given
        self.render_mode = render_mode
        self.soil_name, self.vehicle = chosen.soil.name, chosen.vehicle.record
        self._plants = PlantChoice(
            soil_name=self.soil_name,
            vehicle=self.vehicle,
            four_wheel=chosen.vehicle.four_wheel,
            model=model,
            vehicle_model=vehicle_model,
            structure=choose_structure(structure),
            tyre=choose_tyre(tyre),
            natural_soil=spread_of(natural_soil),
        )
        low, high = self.n_range
        self.prior = (0.5 * (low + high), max((high - low) / math.sqrt(12.0), 1e-3))
        self._believed_soil = make_soil(chosen.soil.record, n=self.prior[0])
        if estimator != "none" and self._believed_soil.rigid:
            raise InvalidParameter(f"estimator={estimator!r} needs a deformable soil, got {self.soil_name!r}")
        announce_compilation()
        self.sensors: SensorSuite = read_sensors(sensors).anew(body_axes=model == "full")
        require_rate(self.sensors.imu.rate)
        chosen.require_bearing(self.sensors, self._plants)
        self._sensing, self._driven = self.sensors, self.vehicle  #: sensors and true vehicle of the episode
        self._context: dict[str, Any] | None = None  #: what was drawn or set for the episode
        noise = NavigationNoise.of(self.sensors.gnss, self.sensors.imu)
        self._navigation = NavigationFilter(self.vehicle, noise)
        #: The parameter UKF runs inside the compiled period, the others beside it.
        self._choice = estimator
        self.estimator: Estimator | None = None  #: the filter for the soil; None where none runs
        self._extended: ExtendedTruth | None = None  # of an extended model; moves outside the compiled period
        self._layout = Layout(self.vehicle.steer_max, terrain_info=terrain_info)
        self._renderer: Renderer | None = None
        self._begun = self._terminated = self._warned = False  # an episode; its end; steps beyond that
        self._learner: OnlineParameterUKF | None = None  # the estimator inside the compiled period
        self.join(Memory(1, self.sizes), 0)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)  #: steering and drive
        self.observation_space = self._layout.space()  #: see above

    @property
    def context(self) -> dict[str, Any] | None:
        """What was drawn or set for this episode; None where nothing is randomised."""
        return self._context

    @property
    def briefing(self) -> Briefing:
        """What a controller may know before it starts."""
        return Briefing.of(self.scenario, self.vehicle, self._believed_soil, self.n_range, self.model)

    # ------------------------------------------------------------------ episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode. ``options={"n": value}`` sets the sinkage exponent of the true soil.

        ``options={"mismatch": (mass, k_phi, lag)}`` multiplies the true vehicle's mass and torque lag and
        the true soil's k_phi by these factors; what estimator and briefing hold stays nominal. The draws
        happen in the same order whatever is observed: same seed, same episode. Of soils that are drawn whole
        one in some hundred does not carry the vehicle where it is softest: such an episode is drawn again.
        """
        chosen = ResetOptions.read(options)
        super().reset(seed=require_seed(seed))
        for left in reversed(range(_DRAWS)):
            try:
                self._draw(chosen)
                break
            except SolverFailure:
                if not left or "soil" in chosen.context or "soil" not in (self._context or {}):
                    raise
        start, (X, Y, yaw) = self.scenario.start_speed, self.course.path.nodes[0, :3].tolist()
        self._start(start)
        self._navigation.reset(X, Y, yaw, start)
        self._choose_estimator()
        self._memory.set_rules(
            self._row, self._driven, self._navigation, self.scenario, self.weights, self._layout
        )
        rules = self._memory.rules[self._row]
        rules["truth_shown"] = self.terrain_info == "truth"
        # On hard ground no n acts, so none is valid; what is observed is clipped to its bounds.
        rules["bounds"][1, _VALID] = 0.0 if self.plant.soil.rigid > 0.5 else 1.0
        self._memory.assumptions = None if self._learner is None else self._learner.assumptions
        self._bind()
        # The start is a state, not an interval: readings of the state itself, one sample of the sensors.
        self._episode["count"], self._episode["steps"] = 1, 0
        self._advance()
        self._episode["count"], self._episode["steps"] = SAMPLES, _STEPS
        self._begun, self._terminated, self._warned = True, False, False
        info = self.result()[0]
        if self.render_mode == "human":
            self.render()
        return self.observation, info

    def _draw(self, chosen: ResetOptions) -> None:
        """Draw the truth of an episode and settle the vehicle on it; `SolverFailure` if it is not carried."""
        randomisation = self._choices.randomisation
        context = chosen.drawn(randomisation, self.np_random)
        self._context = context if context or randomisation is not None else None
        drawn: float | None = float(self.np_random.uniform(*self.n_range))
        drawn = drawn if self._choices.own_n is None else self._choices.own_n
        self.course = self.scenario.draw_course(self.np_random)
        self._path_length = self.course.path.length
        truth = Truth(self.vehicle, self._believed_soil, self.course.ground, self.sensors)
        if context:
            truth = apply_context(context, truth)
            require_rate(truth.sensors.imu.rate)
            if not {"n", "soil.n", "soil"}.isdisjoint(context):
                drawn = None
        self._sensing, self._driven = truth.sensors, truth.vehicle
        self._sensing.reset(self.np_random, radius=self._driven.r)
        self._sensor_errors = self._sensing.errors
        vehicle, soil = chosen.truth(truth.vehicle, truth.soil, drawn)
        soils, field = self.course.soil_map(self.n_range), None
        if self._plants.is_natural:
            field = self._plants.soil_field(soil, int(self.np_random.integers(2**63)))
        self.plant = self._plants.truth(vehicle, soil, truth.ground, soils, field)  #: the true one
        (X, Y, yaw), start = self.course.path.nodes[0, :3].tolist(), self.scenario.start_speed
        if self.extension is not None:
            self._extended = ExtendedTruth(self.extension, self.plant, self._sensing.mount)
            self.plant = self._extended.setup.plant
        self.state[:], self.warm[:] = settled_state(self.plant, x=X, y=Y, yaw=yaw, v_x=start)

    def _choose_estimator(self) -> None:
        """A new estimator at the start of the course, if one runs."""
        self.estimator = self._learner = None
        if self._choice == "none":
            return
        whole = isinstance(self._choice, OnBoard) and self._choice.kind == SOIL_BELIEF
        known = self.course.known_ground
        belief = self._plants.belief(self.vehicle, self._believed_soil, known, wheels=whole)
        if isinstance(self._choice, OnBoard):
            imu, gnss = self.sensors.imu, self.sensors.gnss or GnssConfig()
            n_range, prior = believed_range(self.n_range), self.prior
            if whole and self._choices.draws_soils:
                n_range, prior = POPULATION_RANGE, population_n()
            self.estimator = make_estimator(self._choice, belief, n_range, imu, gnss)
            self.estimator.reset(*prior, self._navigation.pose)
        elif self._choice == COMPILED:
            self.estimator = self._learner = OnlineParameterUKF(
                belief,
                believed_range(self.n_range),
                dt=CONTROL_PERIOD / SAMPLES,
                imu=self.sensors.imu,
                settings=CHANGING_SOIL if self.scenario.changing else None,
                navigation=self._navigation,
            )
            self._learner.reset(*self.prior, self._navigation.pose)

    def _start(self, speed: float) -> None:
        """Write into the record what an episode starts with."""
        self.readings[:] = 0.0
        self._rims[:] = speed
        self._memory.lay_out(self._row, self.course.path, self.plant, self.course.known_ground)
        episode = self._episode
        for name, value in (
            ("plant", pack(self.plant).numbers),
            ("n", self.plant.soil.n),
            ("noise_row", NOISE_ROWS - 1),
            ("estimate", (*self.prior, 0.0, 0.0, 0.0)),
            ("time", 0.0),
            ("action", 0.0),
            ("true_index", 0),  # it starts at the first node
            ("seen_index", 0),
            ("tilting_for", 0.0),
            ("stuck_for", 0.0),
            ("mean_square", 0.0),
            ("ending", 0),
        ):
            episode[name] = value
        self._memory.mount(self._row, self._sensing)
        if self._extended is not None:
            episode["errors"] = self._extended.imperfect(self._sensing.errors)
        self._sensing.draw_noise(self._memory.noise[self._row, -1:])
        self._actions[:] = 0.0

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Hold ``action`` for 0.02 s. See the class for its meaning and the results."""
        values = checked_actions("action", action, (2,))
        self._require_begun("step")
        self._actions[:] = values
        if self._episode["noise_row"] > LAST_ROW:
            self.draw_noise()
        self._advance()
        info, reward = self.result()
        if self._terminated:
            reward = self._beyond_the_end(info)
        if self.render_mode == "human":
            self.render()
        terminated = info["success"] or info["failure"] != ""
        late = not terminated and info["time"] > self.scenario.time_limit - 0.5 * CONTROL_PERIOD
        self._terminated |= terminated
        return self.observation, reward, terminated, late, info

    # ------------------------------------------------------------------ one period

    @property
    def sizes(self) -> PlantSizes:
        """Lengths of the arrays of its episodes."""
        return self._plants.sizes(self._believed_soil)

    @property
    def is_compiled(self) -> bool:
        """Whether a period is one compiled call: no estimator, or the one inside it."""
        return self.estimator is self._learner

    def _advance(self) -> None:
        """Move on by one period: the truth, the filters and the report."""
        phases = _EVERYTHING
        if self._extended is not None:
            self.drive_extended()
            phases = BELIEVE | REPORT
        if self.is_compiled:
            self._run(phases)
            return
        if self._memory.assumptions is not None:  # a caller has replaced the estimator
            self._memory.assumptions = None
            self._bind()
        self._run(phases & ~REPORT)
        self.ask_estimator()
        self._run(REPORT)

    def drive_extended(self) -> None:
        """Move the truth of an extended model, which the compiled period cannot, by one period."""
        if self._extended is not None:
            noise, sensing = self._memory.noise[self._row], None
            if self._memory.sensing is not None and self._sensing.has_memory:
                sensing = self._memory.sensing[self._row : self._row + 1]
            self._extended.drive(self._episode, self._actions, lambda: self.command, noise, sensing)

    def ask_estimator(self) -> None:
        """Give the period's samples and the command to an estimator outside the compiled period."""
        if self.estimator is None or self._episode["status"] >= SUNK:
            return
        for sample in self._samples[: self._episode["count"]]:
            found = self.estimator.update(self.command, sample[IMU], sample[WHEEL], sample[GNSS])
        self._episode["estimate"] = found

    @property
    def command(self) -> Command:
        """The last action as a command: steering [rad], drive and brake torque [N m] (paper: force, NaN)."""
        return command_of(self._driven, self.model, self._episode["action"].tolist())

    def result(self) -> tuple[dict[str, Any], float]:
        """``info`` and the reward, from the report of the period."""
        ending = ENDINGS[self._episode["ending"]]
        info, reward = info_of(self._report, self.plant.soil.n, self._path_length, ending)
        if self._context is not None:
            info["context"] = dict(self._context)
        return info, reward

    # ------------------------------------------------------------------ logs and pictures

    def measurements(self) -> Measurements:
        """Command and samples of the last control period, or the one sample at the start after a reset."""
        self._require_begun("measurements")
        episode = self._episode
        count = 0 if episode["status"] >= SUNK else SAMPLES if episode["time"] > 0.0 else 1
        return Measurements(
            command=self.command, samples=self._samples[:count].copy(), period=CONTROL_PERIOD / SAMPLES
        )

    def snapshot(self) -> Snapshot:
        """The truth at this moment, in copies; needs a `reset` before."""
        self._require_begun("snapshot")
        episode = self._episode
        mean, sd, nis, valid, repairs = episode["estimate"].item()
        estimate = Estimate(mean, sd, nis, valid > 0.5, int(repairs))
        steer, drive = episode["action"].tolist()
        return Snapshot(
            scenario=self.scenario,
            course=self.course,
            plant=self.plant,
            model=self.model,
            terrain_info=self.terrain_info,
            time=float(episode["time"]),
            state=self.state.copy(),
            readings=self.readings.copy(),
            contact=self.warm.copy(),
            command=(steer, drive),
            progress=float(episode["progress"]),
            cross_track_error=float(episode["cross_track_error"]),
            n_range=self.n_range,
            estimate=None if self.estimator is None else estimate,
            ending=ENDINGS[episode["ending"]],
        )

    def render(self) -> np.ndarray | None:
        """Draw the vehicle from above and from the side, and n over time; needs the extra ``view``."""
        if self.render_mode is None:
            gym.logger.warn('render() does nothing without render_mode="human" or "rgb_array"')
            return None
        self._require_begun("render")
        if self._renderer is None:
            from offroad_env.rendering import Renderer

            self._renderer = Renderer(self.render_mode, fps=self.metadata["render_fps"])
        return self._renderer.draw(self.snapshot())

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
