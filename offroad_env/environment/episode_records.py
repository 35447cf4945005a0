"""The memory of any number of episodes: the records that the compiled control period works on.

An episode is one record of fixed size: truth, sensors, beliefs, counters and the report. What has no fixed
size (path, waves of the ground, patches of soil) lies in a table beside it.
"""

from __future__ import annotations

import math
import operator
from functools import cache
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from estimators.filters.navigation import SIZE as NAVIGATION
from estimators.filters.navigation import NavigationFilter
from estimators.filters.online_parameter_step import ASSUMPTIONS, MEMORY
from estimators.filters.protocol import Estimate
from offroad_env.environment.observation import PREVIEW, SHOWN, Layout
from offroad_env.environment.rewards import TERMS, RewardWeights, Rules
from offroad_env.physics import state as at
from offroad_env.physics.imu import CHANNELS
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.sensor_errors import NOISE_COLUMNS, SENSING
from offroad_env.simulation.simulator import FULL_STEP

if TYPE_CHECKING:
    from offroad_env.environment.scenarios import Scenario
    from offroad_env.physics.axle import Plant
    from offroad_env.physics.path_geometry import PathTable
    from offroad_env.physics.records import FourWheel, Ground, SoilField, Structure, Vehicle
    from offroad_env.simulation.sensors import SensorSuite

__all__ = [
    "CONTROL_PERIOD",
    "LAST_ROW",
    "NOISE_ROWS",
    "PAPER_FORCE",
    "REPORTED",
    "REPORTED_TERMS",
    "RULES",
    "SAMPLES",
    "SOIL_WAVES",
    "Memory",
    "PeriodArguments",
    "PeriodOptions",
    "PlantSizes",
    "episode_type",
    "info_of",
]

CONTROL_PERIOD = 0.02  #: time between actions [s]
SAMPLES = 2  #: samples of the sensors in a period
#: Body force at full drive, per unit of mass [m/s^2]: above the paper's largest, 2.4.
PAPER_FORCE = 3.0

#: Periods for which sensor noise is drawn at a time.
_NOISE_PERIODS = 32
#: Samples for which sensor noise is drawn at a time.
NOISE_ROWS = _NOISE_PERIODS * SAMPLES
#: Last row from which there is enough for a period.
LAST_ROW = NOISE_ROWS - SAMPLES

# Columns of the report.
(N_FRONT, N_REAR, SINKAGE_F, SINKAGE_R, SLIP_F, SLIP_R, CROSS_TRACK_ERROR, HEADING_ERROR) = range(8)
(PROGRESS, SPEED, TIME, N_ESTIMATE, N_ESTIMATE_SD, NIS, FILTER_REPAIRS, SHAKE) = range(8, 16)
_SINKAGE, _SLIP = slice(SINKAGE_F, SINKAGE_R + 1), slice(SLIP_F, SLIP_R + 1)
_FIRST_TERM = 16
#: The reward terms, in the order of `TERMS`.
REPORTED_TERMS = slice(_FIRST_TERM, _FIRST_TERM + len(TERMS))

#: Keys of `info` besides the reward terms: name -> columns of the report.
REPORTED: dict[str, int | slice] = {
    "n_front": N_FRONT,
    "n_rear": N_REAR,
    "sinkage": _SINKAGE,
    "slip": _SLIP,
    "cross_track_error": CROSS_TRACK_ERROR,
    "heading_error": HEADING_ERROR,
    "progress": PROGRESS,
    "speed": SPEED,
    "time": TIME,
    "n_estimate": N_ESTIMATE,
    "n_estimate_sd": N_ESTIMATE_SD,
    "nis": NIS,
    "filter_repairs": FILTER_REPAIRS,
    "shake": SHAKE,
}


class PlantSizes(NamedTuple):
    """Lengths of the arrays that depend on the plant; by default of the half-car on rigid rims."""

    wheels: int = 2  #: rows of the contact state
    contact: int = at.CONTACT_SIZE  #: its columns
    state: int = at.STATE_SIZE
    readings: int = at.READINGS_SIZE


#: Those of the half-car on rigid rims.
PLAIN = PlantSizes()


@cache
def episode_type(sizes: PlantSizes) -> np.dtype[np.void]:
    """Type of the record of one episode."""
    return np.dtype([*_truth_fields(sizes), *_OTHER_FIELDS])


def _truth_fields(sizes: PlantSizes) -> list[tuple[Any, ...]]:
    """The state of the truth in the record of an episode."""
    return [
        # the truth
        ("state", "f8", sizes.state),
        ("warm", "f8", (sizes.wheels, sizes.contact)),
        ("readings", "f8", sizes.readings),
        ("sound_state", "f8", sizes.state),  # before a step that diverged
        ("sound_readings", "f8", sizes.readings),
        ("slope", "f8", sizes.state),  # time derivative of the sound state, full model
    ]


_OTHER_FIELDS: list[tuple[Any, ...]] = [
    ("plant", "f8", ASSUMPTIONS["plant"].shape[0]),
    ("n", "f8"),  # of the base soil
    ("status", "f8"),  # worst contact status of the period
    # where its path, waves, patches and the waves that a map shows end in its table
    ("ds", "f8"),
    ("path_end", "i8"),
    ("waves_end", "i8"),
    ("patches_end", "i8"),
    ("known_end", "i8"),
    # the sensors
    ("errors", "f8", (3, CHANNELS)),
    ("lever", "f8", 3),
    ("rotation", "f8", (3, 3)),
    ("body_axes", "f8"),
    ("gravity", "f8"),
    ("wheel_every", "i8"),  # IMU samples from one sample of the wheel speeds to the next
    ("gnss_every", "i8"),
    ("tick", "i8"),
    ("noise_row", "i8"),
    ("samples", "f8", (SAMPLES, CHANNELS)),
    ("rims", "f8", 2),
    # beliefs
    ("navigation", "f8", NAVIGATION),
    ("covariance", "f8", (NAVIGATION, NAVIGATION)),
    ("filter", MEMORY),
    ("estimate", [(name, "f8") for name in Estimate._fields]),
    # the episode
    ("phases", "i8"),  # what the next call shall do; 0: nothing
    ("count", "i8"),  # samples of the period, 1 at the start
    ("steps", "i8"),  # steps of the plant per sample, 0 at the start
    ("time", "f8"),
    ("action", "f8", 2),  # the last one
    ("change", "f8"),  # what it differs by from the one before, squared and summed
    ("true_index", "i8"),
    ("seen_index", "i8"),
    ("progress", "f8"),  # of the true vehicle along the path [m]
    ("cross_track_error", "f8"),  # of the true vehicle, left positive [m]
    ("heading_error", "f8"),  # of the true vehicle [rad]
    ("tilting_for", "f8"),
    ("stuck_for", "f8"),
    ("mean_square", "f8"),  # running, of the vertical acceleration [m^2/s^4]
    ("report", "f8", REPORTED_TERMS.stop),
    ("ending", "i8"),
]

#: What holds for the whole of an episode.
RULES = np.dtype(
    [
        ("dt", "f8"),  # step of the plant [s]
        ("steer_max", "f8"),  # road-wheel angle of action 1 [rad]
        ("steer_stated", "f8"),  # the same by the data sheet: what is observed
        ("drive_max", "f8"),  # drive torque of action 1 [N m]
        ("brake_max", "f8"),  # brake torque of action -1 [N m]
        ("mass", "f8"),
        ("tilt", "f8"),  # lateral acceleration that lifts the inner wheels [m/s^2]
        ("axles", "f8", 2),
        ("navigation", "f8", 13),  # `NavigationNoise`
        *((name, "f8") for name in Rules._fields),
        ("target_speed", "f8"),
        ("weights", "f8", len(TERMS)),
        ("distances", "f8", len(PREVIEW)),
        ("bounds", "f4", (2, SHOWN)),
        ("truth_shown", "i8"),
    ]
)


def info_of(report: np.ndarray, n: float, path_length: float, ending: str) -> tuple[dict[str, Any], float]:
    """``info`` and the reward of one episode, from its report and what does not change while it goes on."""
    numbers = report.tolist()
    terms = numbers[REPORTED_TERMS]
    return {
        "n": n,
        "n_front": numbers[N_FRONT],
        "n_rear": numbers[N_REAR],
        "sinkage": report[_SINKAGE].copy(),
        "slip": report[_SLIP].copy(),
        "cross_track_error": numbers[CROSS_TRACK_ERROR],
        "heading_error": numbers[HEADING_ERROR],
        "progress": numbers[PROGRESS],
        "path_length": path_length,
        "speed": numbers[SPEED],
        "shake": numbers[SHAKE],
        "time": numbers[TIME],
        "n_estimate": numbers[N_ESTIMATE],
        "n_estimate_sd": numbers[N_ESTIMATE_SD],
        "nis": numbers[NIS],
        "filter_repairs": int(numbers[FILTER_REPAIRS]),
        "reward_terms": dict(zip(TERMS, terms, strict=True)),
        "success": ending == "goal",
        "failure": "" if ending == "goal" else ending,
    }, sum(terms)


#: Waves of the natural soil of an episode.
SOIL_WAVES = 64


class PeriodOptions(NamedTuple):
    """What episodes have beyond the plain half-car; None is compiled away, so each choice is an edition."""

    sensing: np.ndarray | None = None  #: (N,) of the type `SENSING`: what sensors remember
    structure: Structure | None = None  #: laws of the wheels
    four_wheel: FourWheel | None = None  #: what four wheels have beyond two axles
    soil_field: SoilField | None = None  #: natural soil, ``SOIL_WAVES`` rows of waves an episode


class PeriodArguments(NamedTuple):
    """Arguments of `period_full` and `period_paper` for N episodes."""

    episodes: np.ndarray  #: (N,) of an `episode_type`
    rules: np.ndarray  #: (N,) of the type `RULES`
    tables: np.ndarray  #: (N, rows, 4)
    noise: np.ndarray  #: (N, NOISE_ROWS, NOISE_COLUMNS)
    actions: np.ndarray  #: (N, 2)
    shown: np.ndarray  #: (N, SHOWN) float32
    assumptions: np.ndarray | None  #: (1,) of the type `ASSUMPTIONS`
    options: PeriodOptions


def lifting_acceleration(vehicle: Vehicle) -> float:
    """Lateral acceleration at which the inner wheels of a rigid vehicle lift: g track / (2 h) [m/s^2]."""
    return 0.5 * GRAVITY * vehicle.track / vehicle.h_cg if vehicle.h_cg > 0.0 else math.inf


class Memory:
    """Arrays with one row per episode; `period_full` states what they hold.

    Parameters
    ----------
    count : episodes
    sizes : of their plants
    """

    def __init__(self, count: int, sizes: PlantSizes = PLAIN) -> None:
        self.episodes = np.zeros(count, episode_type(sizes))
        self.rules = np.zeros(count, RULES)
        self.tables = np.zeros((count, 1, 4))
        self.noise = np.zeros((count, NOISE_ROWS, NOISE_COLUMNS))
        self.actions = np.zeros((count, 2))
        self.shown = np.zeros((count, SHOWN), np.float32)
        #: What the filter in the compiled period assumes (1,); None where none runs there.
        self.assumptions: np.ndarray | None = None
        #: Memories of the sensors (count,), of the type `SENSING`; None where no sensor has any.
        self.sensing: np.ndarray | None = None
        #: Laws of the wheels, the same in all episodes.
        self.structure: Structure | None = None
        #: What four wheels have beyond two axles, the same in all episodes.
        self.four_wheel: FourWheel | None = None
        #: What the rules of each row were made from.
        self._ruled: dict[int, tuple[object, ...]] = {}
        #: Natural soil with the waves of all episodes, one after the other; None where soil is uniform.
        self.soil_field: SoilField | None = None

    def mount(self, row: int, sensors: SensorSuite) -> None:
        """Write the sensors of an episode, as they have been reset, into its row."""
        mount, episode = sensors.mount, self.episodes[row]
        for name, value in (
            ("errors", sensors.errors),
            ("lever", mount.lever),
            ("rotation", mount.rotation),
            ("body_axes", mount.body_axes),
            ("gravity", mount.gravity),
            ("wheel_every", sensors.wheel_every),
            ("gnss_every", sensors.gnss_every),
            ("tick", 0),
        ):
            episode[name] = value
        # `imu.sense` knows no roll.
        remembering = sensors.has_memory or self.four_wheel is not None
        if remembering and self.sensing is None:
            self.sensing = np.zeros(len(self.episodes), SENSING)
        if self.sensing is not None:
            self.sensing[row] = sensors.memory[0] if remembering else np.zeros((), SENSING)

    def lay_out(self, row: int, path: PathTable, plant: Plant, known: Ground) -> None:
        """Write the course of an episode into its table; all tables grow where it is longer.

        ``known`` is what a map shows of the ground.
        """
        parts = (path.nodes, plant.ground.waves, plant.soil_map.patches, known.waves)
        ends = list(accumulate(map(len, parts)))
        if ends[-1] > self.tables.shape[1]:
            grown = np.zeros((len(self.tables), ends[-1], 4))
            grown[:, : self.tables.shape[1]] = self.tables
            self.tables = grown
        table = self.tables[row]
        for part, end in zip(parts, ends, strict=True):
            table[end - len(part) : end] = part
        self.structure, self.four_wheel, episode = plant.structure, plant.four_wheel, self.episodes[row]
        if plant.soil_field is not None:
            if self.soil_field is None:
                waves = np.zeros((len(self.episodes) * SOIL_WAVES, plant.soil_field.waves.shape[1]))
                self.soil_field = plant.soil_field._replace(waves=waves)
            self.soil_field.waves[row * SOIL_WAVES : (row + 1) * SOIL_WAVES] = plant.soil_field.waves
        episode["ds"] = path.ds
        for name, end in zip(("path_end", "waves_end", "patches_end", "known_end"), ends, strict=True):
            episode[name] = end

    def set_rules(
        self,
        row: int,
        vehicle: Vehicle,
        navigation: NavigationFilter,
        scenario: Scenario,
        weights: RewardWeights,
        layout: Layout,
    ) -> None:
        """Write down what holds for the whole of an episode of ``vehicle``, unless it stands there."""
        origin = (vehicle, navigation, scenario, weights, layout)
        if all(map(operator.is_, origin, self._ruled.get(row, (None,)))):
            return
        self._ruled[row] = origin
        rules = self.rules[row]
        for name, value in (
            ("dt", FULL_STEP),
            ("steer_max", vehicle.steer_max),
            ("steer_stated", layout.steer_max),
            ("drive_max", vehicle.drive_torque_max),
            ("brake_max", vehicle.brake_torque_max),
            ("mass", vehicle.m),
            ("tilt", lifting_acceleration(vehicle)),
            ("axles", navigation.axles),
            ("navigation", navigation.constants),
            *scenario.rules._asdict().items(),
            ("target_speed", scenario.target_speed),
            ("weights", weights.row(scenario.time_limit)),
            ("distances", PREVIEW),
            ("bounds", layout.bounds),
        ):
            rules[name] = value

    def _fields(self, rows: slice) -> SoilField | None:
        """Natural soil of some of the episodes."""
        if self.soil_field is None:
            return None
        part = slice(rows.start * SOIL_WAVES, rows.stop * SOIL_WAVES)
        return self.soil_field._replace(waves=self.soil_field.waves[part])

    def part(self, rows: slice) -> PeriodArguments:
        """What the compiled period takes, for some of the episodes."""
        return PeriodArguments(
            self.episodes[rows],
            self.rules[rows],
            self.tables[rows],
            self.noise[rows],
            self.actions[rows],
            self.shown[rows],
            self.assumptions,
            PeriodOptions(
                sensing=None if self.sensing is None else self.sensing[rows],
                structure=self.structure,
                four_wheel=self.four_wheel,
                soil_field=self._fields(rows),
            ),
        )
