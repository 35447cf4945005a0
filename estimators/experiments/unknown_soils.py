"""Simulated drives over soils that nobody knows.

A case says what is known and what is not. In "nuisances" the soil is drawn from the population of measured
ones, and vehicle, sensors, start, road, slope of the ground and scatter of the soil are drawn with it. The
others take a soil of the catalogue and change one thing. Soils of tuning, test and training come from
disjoint streams of random numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, TypedDict

import numpy as np

from estimators.filters.protocol import Pose
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Ground, Soil, Tyre, Vehicle
from offroad_env.simulation.drive import Command, DriveRecord, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.simulation.soil_holds import SoilHolds, what_soil_holds
from offroad_env.world.natural_soil import SoilSpread, natural_soil
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import add, flat, paper_terrain, rough_terrain
from offroad_env.world.tyres import TYRES, make_tyre
from offroad_env.world.vehicles import VEHICLES, make_vehicle

__all__ = ["CASES", "SPLITS", "TEST_CASES", "VEHICLE", "Case", "SoilRun", "draw_run", "sloping"]

#: Streams of random numbers: no soil of one is in another.
SPLITS = ("tuning", "test", "training")
#: The vehicle of all drives.
VEHICLE = "mrzr"
_TRIES = 1000
#: Soils that nobody would start on: wheels deeper than this share of the radius, or less net pull per weight.
_DEEPEST, _LEAST_PULL = 0.5, 0.03
_START_SPEED = 5.0
#: Scatter of the soil in space, standard deviations of `SoilSpread`.
_SPREAD = {"pressure": 0.05, "n": 0.03, "c": 0.05, "tan_phi": 0.05, "K": 0.05}
#: Standard deviation of the ground's slope towards each of two axes [-].
_SLOPE = 0.03
#: Net pull per weight of soft soils: about half of them stop the vehicle.
_SOFT = (-0.12, 0.08)


@dataclass(frozen=True, kw_only=True)
class Case:
    """What a drive has that its filter does not know."""

    title: str
    soil: str | None = None  #: of the catalogue; None: drawn from the population
    phi: float = 0.0  #: change of the friction angle, either way [rad]
    c: float = 0.0  #: relative change of the cohesion, either way
    K: float = 1.0  #: factor of the shear moduli
    exit: float = 0.0  #: change of b_0
    heading: float = 0.0  #: error of the start heading, either way [rad]
    structure: str | None = None  #: of the truth; the filter assumes "full"
    soft: bool = False  #: soils on which the vehicle hardly gets on
    nuisances: bool = False  #: vehicle, sensors, start, road and scatter of the soil differ too
    width: float = 1.0  #: factor of the wheels' width, or one over it
    drag: float = 1.0  #: factor of the drag: four is a head wind as fast as the vehicle
    grade: float = 0.0  #: slope of the ground along the start heading, either way [-]
    level: bool = False  #: the ground does not slope, and the filter knows it
    latency: float = 0.0  #: age of the receiver's fixes, which are taken for new [s]
    scatter: float = 0.0  #: of the soil in space, over that of the nuisances
    start: float = 0.0  #: error of the start, either way, along both axes [m]
    waves: float = 0.0  #: height of the paper's field of waves on the ground [m]
    shift: float | None = None  #: by which a map of these waves is off along both axes [m]; None: no map
    inflation: float | None = None  #: factor of the tyres' pressure, or one over it; None: rigid rims
    random: bool = False  #: what only tests have, of a random size up to that of the second case of each

    @property
    def is_modelled(self) -> bool:
        """Whether some soil and vehicle of the belief's population make the same drive."""
        same_laws = self.structure is None and self.width == 1.0 and self.inflation is None
        return same_laws and self.latency == 0.0 and self.waves == 0.0 and not self.random


_DEGREE = math.radians(1.0)
CASES: dict[str, Case] = {
    "nuisances": Case(title="whole soils, all nuisances", nuisances=True),
    "level": Case(title="whole soils, all nuisances, known ground", nuisances=True, level=True),
    "soft": Case(title="soft soils, all nuisances", nuisances=True, soft=True),
    "soft_level": Case(
        title="soft soils, all nuisances, known ground", nuisances=True, soft=True, level=True
    ),
    "matched": Case(title="nothing differs", soil="clay"),
    "phi_1": Case(title="phi ±1°", soil="clay", phi=_DEGREE),
    "phi_2": Case(title="phi ±2°", soil="clay", phi=2.0 * _DEGREE),
    "c": Case(title="c ±20 %", soil="clay", c=0.2),
    "K_low": Case(title="K x 0.75", soil="clay", K=0.75),
    "K_high": Case(title="K x 1.25", soil="clay", K=1.25),
    "exit": Case(title="exit angle -0.1", soil="clay", exit=-0.1),
    "heading_0.6": Case(title="start heading ±0.6°", soil="clay", heading=0.6 * _DEGREE),
    "heading_1.7": Case(title="start heading ±1.7°", soil="clay", heading=1.7 * _DEGREE),
    "grid": Case(title="wheels of structure grid", soil="clay", structure="grid"),
    "width_1": Case(title="wheels 10 % wider or narrower", soil="clay", width=1.1),
    "width_2": Case(title="wheels 20 % wider or narrower", soil="clay", width=1.2),
    "wind_1": Case(title="drag x 2", soil="clay", drag=2.0),
    "wind_2": Case(title="drag x 4", soil="clay", drag=4.0),
    "grade_1": Case(title="grade ±2 %", soil="clay", grade=0.02),
    "grade_2": Case(title="grade ±5 %", soil="clay", grade=0.05),
    "clock_1": Case(title="fixes 0.1 s late", soil="clay", latency=0.1),
    "clock_2": Case(title="fixes 0.3 s late", soil="clay", latency=0.3),
    "scatter_1": Case(title="soil scatters as usual", soil="clay", scatter=1.0),
    "scatter_2": Case(title="soil scatters twice as much", soil="clay", scatter=2.0),
    "soil_phi": Case(title="phi ±4°", soil="clay", phi=4.0 * _DEGREE),
    "soil_c": Case(title="c ±50 %", soil="clay", c=0.5),
    "soil_K_low": Case(title="K x 0.5", soil="clay", K=0.5),
    "soil_K_high": Case(title="K x 2", soil="clay", K=2.0),
    "soil_exit": Case(title="exit angle -0.2", soil="clay", exit=-0.2),
    "start_1": Case(title="start off by 0.5 m", soil="clay", start=0.5),
    "start_2": Case(title="start off by 1.5 m", soil="clay", start=1.5),
    "waves_1": Case(title="waves of 2 cm, no map", soil="clay", waves=0.02),
    "waves_2": Case(title="waves of 5 cm, no map", soil="clay", waves=0.05),
    "map_1": Case(title="map of waves of 5 cm, off by 0.3 m", soil="clay", waves=0.05, shift=0.3),
    "map_2": Case(title="the same, off by 1 m", soil="clay", waves=0.05, shift=1.0),
    "tyre_0": Case(title="tyres, structure grid, nothing differs", soil="clay", inflation=1.0),
    "tyre_1": Case(title="their pressure 15 % higher or lower", soil="clay", inflation=1.15),
    "tyre_2": Case(title="their pressure 40 % higher or lower", soil="clay", inflation=1.4),
    "random": Case(title="whole soils, all nuisances, all of these at random", nuisances=True, random=True),
    "together": Case(
        title="whole soils, all nuisances, and these at the smaller size",
        nuisances=True,
        width=1.1,
        drag=2.0,
        grade=0.02,
        latency=0.1,
    ),
}
#: Cases that nothing was chosen on: they have no drives for tuning.
TEST_CASES = tuple(CASES)[list(CASES).index("width_1") :]


class SoilRun(NamedTuple):
    """A simulated drive."""

    case: str
    record: DriveRecord
    holds: SoilHolds  #: what the soil truly holds for the true vehicle
    pose: Pose  #: start that the filter is given
    stated: Plant  #: what it is given of vehicle, wheels and ground; not of the soil
    slopes: tuple[float, float]  #: of the ground towards X and Y [-]


def _drawn_soil(case: Case, rng: np.random.Generator, prior: SoilPrior) -> Soil:
    if case.soil is None:
        return prior.sample(rng)
    base, side = SOILS[case.soil], float(rng.choice([-1.0, 1.0]))
    return make_soil(
        base,
        phi=base.phi + side * case.phi,
        c=base.c * (1.0 + side * case.c),
        k_x=base.k_x * case.K,
        k_y=base.k_y * case.K,
        b_0=base.b_0 + case.exit,
    )


def _drawn_vehicle(case: Case, width: float, rng: np.random.Generator) -> Vehicle:
    vehicle = VEHICLES[VEHICLE]
    vehicle = make_vehicle(vehicle, b=vehicle.b * width, drag_area=vehicle.drag_area * case.drag)
    mass, lag, drag = rng.standard_normal(3)
    if not case.nuisances:
        return vehicle
    return make_vehicle(
        vehicle,
        m=vehicle.m * math.exp(0.05 * mass),
        torque_lag=vehicle.torque_lag * math.exp(0.2 * lag),
        drag_area=vehicle.drag_area * math.exp(0.2 * drag),
    )


def _sensors(case: Case, rng: np.random.Generator) -> SensorSuite:
    coarse = bool(rng.random() < 0.5)
    if not case.nuisances:
        receiver = GnssConfig(latency=case.latency)
        return SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=receiver)
    unit = ImuConfig(
        kind="specific_force",
        accel_bias_sd=0.1,
        gyro_bias_sd=0.005,
        misalignment_sd=(2.0 * _DEGREE,) * 3,
    )
    receiver = GnssConfig(position_sd=1.5 if coarse else 0.03, latency=case.latency)
    return SensorSuite(imu=unit, wheel=WheelSpeedConfig(), gnss=receiver)


def sloping(slopes: tuple[float, float]) -> Ground:
    """A plane through the origin with these slopes towards X and Y [-]."""
    return flat()._replace(S_x=slopes[0], S_y=slopes[1])


class _Laws(TypedDict):
    """Laws of the wheels as `make_plant` takes them."""

    structure: str | None
    tyre: Tyre | None


class _Apart(NamedTuple):
    """What is drawn from a stream of its own: whether it acts changes nothing else."""

    wide: float  #: 1.0 or -1.0
    up: float
    slopes: tuple[float, float]  #: standard normal numbers


def _drawn_apart(split: int, seed: int) -> _Apart:
    rng = np.random.default_rng([split, seed, 1])
    wide, up = rng.choice([-1.0, 1.0], 2).tolist()
    first, second = rng.standard_normal(2).tolist()
    return _Apart(wide, up, (first, second))


def _with_sizes(case: Case, split: int, seed: int) -> Case:
    """The case itself, or one whose sizes are drawn up to those of the second case of each."""
    if not case.random:
        return case
    size = np.random.default_rng([split, seed, 2]).random(6).tolist()
    return replace(
        case,
        width=1.2 ** size[0],
        drag=4.0 ** size[1],
        grade=0.05 * size[2],
        latency=0.1 * round(3.0 * size[3]),
        start=1.5 * size[4],
        waves=0.05 * size[5],
    )


def _stated(case: Case) -> Plant:
    """The nominal vehicle, its wheels as they are believed to be, and the map of the ground."""
    laws, ground = _laws(case, 0.0), flat()
    if case.shift is not None:
        ground = _moved(paper_terrain(case.waves), case.shift)
    return make_plant(VEHICLES[VEHICLE], SOILS["dry_sand"], ground, **laws)


def _moved(ground: Ground, shift: float) -> Ground:
    """The waves of a ground moved by ``shift`` [m] along both axes."""
    waves = ground.waves.copy()
    waves[:, 3] -= shift * (waves[:, 1] + waves[:, 2])
    return ground._replace(waves=waves)


def _laws(case: Case, side: float) -> _Laws:
    """Structure and tyres; their pressure is off towards ``side``, 0: as stated."""
    if case.inflation is None:
        return {"structure": case.structure if side else None, "tyre": None}
    tyre = TYRES[VEHICLE]
    return {
        "structure": "grid",
        "tyre": make_tyre(tyre, inflation=tyre.inflation * case.inflation**side),
    }


def _slopes(case: Case, apart: _Apart) -> tuple[float, float]:
    """Slopes of the ground towards X and Y [-]."""
    drawn = _SLOPE * (case.nuisances and not case.level and case.grade == 0.0)
    along, across = apart.slopes
    return case.grade * apart.up + drawn * along, drawn * across


def _drawn_plant(case: Case, rng: np.random.Generator, prior: SoilPrior, apart: _Apart) -> Plant:
    """Truth; what is drawn does not depend on the case, so cases of one seed differ in one thing."""
    soil = _drawn_soil(case, rng, prior)
    vehicle = _drawn_vehicle(case, case.width**apart.wide, rng)
    road, seed = 10.0 ** rng.uniform(-6.0, -4.5), int(rng.integers(2**31))
    ground = sloping(_slopes(case, apart))
    if case.waves > 0.0:
        ground = add(ground, paper_terrain(case.waves))
    if case.nuisances:
        ground = add(ground, rough_terrain(None, np.random.default_rng(seed), roughness=road, waves=32))
    scatter = 1.0 if case.nuisances else case.scatter
    if scatter == 0.0:
        return make_plant(vehicle, soil, ground, **_laws(case, apart.up))
    spread = SoilSpread(**{name: scatter * sd for name, sd in _SPREAD.items()})
    field = natural_soil(soil, seed + 1, spread=spread, waves=32)
    return make_plant(vehicle, soil, ground, soil_field=field, **_laws(case, apart.up))


class _Manoeuvre:
    """Bends in turn to both sides, at speeds that rise and fall: how hard is drawn."""

    def __init__(self, vehicle: Vehicle, rng: np.random.Generator) -> None:
        self.vehicle = vehicle
        self.steer = rng.uniform(0.05, 0.9) * vehicle.steer_max
        self.period, self.beat = rng.uniform(3.0, 7.0), rng.uniform(3.0, 8.0)
        self.phase = rng.uniform(0.0, 2.0 * math.pi)
        self.fast, self.swing = rng.uniform(3.5, 8.0), rng.uniform(0.0, 2.5)

    def __call__(self, t: float, v: float) -> Command:
        """Command at a time [s] and speed [m/s]."""
        wish = self.fast + self.swing * math.sin(2.0 * math.pi * t / self.beat + self.phase)
        push = (
            1.5 * (wish - v) * self.vehicle.m * self.vehicle.r
            + 0.12 * self.vehicle.m * GRAVITY * self.vehicle.r
        )
        drive = min(max(push, 0.0), 0.9 * self.vehicle.drive_torque_max)
        brake = min(max(-push, 0.0), 0.5 * self.vehicle.brake_torque_max)
        # Steering in proportion to 1/v beyond a walk keeps the bends as tight as the soil allows.
        turn = self.steer * math.sin(2.0 * math.pi * t / self.period) * min(1.0, 4.0 / max(v, 1.0))
        return turn, drive, brake


def draw_run(case: str, seed: int, *, split: str = "test", duration: float = 12.0) -> SoilRun:
    """A drive of a case.

    Parameters
    ----------
    case : str
        Name in `CASES`.
    seed : int
        Of all that is drawn.
    split : {"tuning", "test", "training"}
    duration : float
        [s]

    Raises
    ------
    InvalidParameter
        For an unknown case or split, or drives for tuning of a case that is for tests only.
    SolverFailure
        When no drawn soil lets the vehicle drive.
    """
    if case not in CASES or split not in SPLITS:
        raise InvalidParameter(f"case must be one of {', '.join(CASES)}, split of {', '.join(SPLITS)}")
    if case in TEST_CASES and split != "test":
        raise InvalidParameter(f"case {case!r} is for tests only: nothing may be chosen on it")
    stream = SPLITS.index(split)
    apart, chosen = _drawn_apart(stream, seed), _with_sizes(CASES[case], stream, seed)
    rng, prior = np.random.default_rng([stream, seed]), SoilPrior.fitted()
    for _ in range(_TRIES):
        try:
            plant = _drawn_plant(chosen, rng, prior, apart)
        except InvalidParameter:  # no natural soil spreads around so small an exponent
            continue
        manoeuvre, sensors = _Manoeuvre(plant.vehicle, rng), _sensors(chosen, rng)
        wrong = float(rng.choice([-1.0, 1.0])) * chosen.heading
        wrong += _DEGREE * float(rng.standard_normal()) * chosen.nuisances
        held = what_soil_holds(plant._replace(soil_field=None))
        if not held.carried or held.sinkage > _DEEPEST * plant.vehicle.r:
            continue
        low, high = _SOFT if chosen.soft else (_LEAST_PULL, math.inf)
        if chosen.soil is None and not low < held.pull / (plant.vehicle.m * GRAVITY) < high:
            continue
        try:
            record = simulate_drive(plant, manoeuvre, sensors, rng, duration=duration, speed=_START_SPEED)
        except SolverFailure:
            continue
        off = chosen.start * apart.wide
        pose = Pose(off, off, wrong, _START_SPEED)
        return SoilRun(case, record, held, pose, _stated(chosen), _slopes(chosen, apart))
    raise SolverFailure(f"{_TRIES} draws of {case!r} gave no drive")
