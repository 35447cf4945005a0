"""Simulated drives over soils that nobody knows: what the online belief over whole soils is tested on.

A case says what is known and what is not. In "nuisances" the soil is drawn from the population of measured
ones, and vehicle, sensors, start, road and scatter of the soil are drawn with it. The others take a soil of
the catalogue and change one thing; the belief always starts from the whole population. Soils of tuning and
test come from disjoint streams of random numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.experiments.model_mismatch import excited
from estimators.filters.online import OnBoard, Thinned, make_estimator
from estimators.filters.online_soil_belief import POPULATION_RANGE, OnlineSoilBelief, population_n
from estimators.filters.protocol import Estimator, Pose
from estimators.filters.soil_belief_holds import LIMITS, SHIFT, transform_limits
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Soil, Vehicle
from offroad_env.simulation.drive import Command, DriveRecord, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.simulation.soil_holds import SoilHolds, what_soil_holds
from offroad_env.world.natural_soil import SoilSpread, natural_soil
from offroad_env.world.soil_prior import SoilPrior
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.terrain import flat, rough_terrain
from offroad_env.world.vehicles import VEHICLES, make_vehicle

__all__ = [
    "CASES",
    "SPLITS",
    "BeliefHistory",
    "Case",
    "LimitErrors",
    "SoilRun",
    "believe",
    "draw_run",
    "limit_errors",
]

#: Streams of random numbers: no soil of one is in the other.
SPLITS = ("tuning", "test")
_VEHICLE = "mrzr"
#: Quantile of a normal distribution that a 95 % interval ends at.
_Z95 = 1.959964
_TRIES = 1000
#: Soils that nobody would start on: wheels deeper than this share of the radius, or less net pull per weight.
_DEEPEST, _LEAST_PULL = 0.5, 0.03
_START_SPEED = 5.0
#: Net pull per weight of soft soils: about half of them stop the vehicle.
_SOFT = (-0.12, 0.08)
#: A vehicle that is slower is stuck [m/s].
_STUCK = 0.5


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


_DEGREE = math.radians(1.0)
CASES: dict[str, Case] = {
    "nuisances": Case(title="whole soils, all nuisances", nuisances=True),
    "soft": Case(title="soft soils, all nuisances", nuisances=True, soft=True),
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
}


class SoilRun(NamedTuple):
    """A simulated drive."""

    case: str
    record: DriveRecord
    holds: SoilHolds  #: what the soil truly holds for the true vehicle
    pose: Pose  #: start that the filter is given


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


def _drawn_vehicle(case: Case, rng: np.random.Generator) -> Vehicle:
    vehicle = VEHICLES[_VEHICLE]
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
        return SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=GnssConfig())
    unit = ImuConfig(
        kind="specific_force",
        accel_bias_sd=0.1,
        gyro_bias_sd=0.005,
        misalignment_sd=(2.0 * _DEGREE,) * 3,
    )
    return SensorSuite(
        imu=unit, wheel=WheelSpeedConfig(), gnss=GnssConfig(position_sd=1.5 if coarse else 0.03)
    )


def _drawn_plant(case: Case, rng: np.random.Generator, prior: SoilPrior) -> Plant:
    """Truth; what is drawn does not depend on the case, so cases of one seed differ in one thing."""
    soil, vehicle = _drawn_soil(case, rng, prior), _drawn_vehicle(case, rng)
    road, seed = 10.0 ** rng.uniform(-6.0, -4.5), int(rng.integers(2**31))
    if not case.nuisances:
        return make_plant(vehicle, soil, flat(), structure=case.structure)
    ground = rough_terrain(None, np.random.default_rng(seed), roughness=road, waves=32)
    spread = SoilSpread(pressure=0.05, n=0.03, c=0.05, tan_phi=0.05, K=0.05)
    field = natural_soil(soil, seed + 1, spread=spread, waves=32)
    return make_plant(vehicle, soil, ground, structure=case.structure, soil_field=field)


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
    split : {"tuning", "test"}
    duration : float
        [s]

    Raises
    ------
    InvalidParameter
        For an unknown case or split.
    SolverFailure
        When no drawn soil lets the vehicle drive.
    """
    if case not in CASES or split not in SPLITS:
        raise InvalidParameter(f"case must be one of {', '.join(CASES)}, split of {', '.join(SPLITS)}")
    rng, prior, chosen = np.random.default_rng([SPLITS.index(split), seed]), SoilPrior.fitted(), CASES[case]
    for _ in range(_TRIES):
        try:
            plant = _drawn_plant(chosen, rng, prior)
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
        return SoilRun(case, record, held, Pose(0.0, 0.0, wrong, _START_SPEED))
    raise SolverFailure(f"{_TRIES} draws of {case!r} gave no drive")


@dataclass(frozen=True, kw_only=True)
class BeliefHistory:
    """The belief along a run, a row per update of the filter."""

    t: np.ndarray  #: (T,) [s]
    centre: np.ndarray  #: (T, 6) means of the limits, of the logarithm of positive ones, see `LOGARITHMIC`
    sd: np.ndarray  #: (T, 6)
    n: np.ndarray  #: (T, 2) mean and standard deviation
    valid: np.ndarray  #: (T,) bool
    excited: np.ndarray  #: (T,) bool: steering or roughness acts
    used: np.ndarray  #: (T, 2) largest lateral acceleration and pull so far, over the limits
    announced: np.ndarray  #: (T,) bool: the vehicle is about to get stuck
    stuck: np.ndarray  #: (T,) bool: it is
    distance: float  #: driven until the end [m]


def believe(run: SoilRun, filter_: Estimator | None = None) -> BeliefHistory:
    """Run the belief over a drive; its model is the nominal vehicle on level ground, structure "full"."""
    record = run.record
    nominal = make_plant(VEHICLES[_VEHICLE], SOILS["dry_sand"], flat())
    unit = ImuConfig(kind="specific_force") if CASES[run.case].nuisances else ImuConfig()
    if filter_ is None:
        receiver = GnssConfig(position_sd=1.5) if CASES[run.case].nuisances else GnssConfig()
        choice = OnBoard(kind="online_soil_belief", rate=50.0)
        filter_ = make_estimator(choice, nominal, POPULATION_RANGE, unit, receiver)
    inner = filter_.inner if isinstance(filter_, Thinned) else filter_
    if not isinstance(inner, OnlineSoilBelief):
        raise InvalidParameter("filter_ must be a belief over whole soils")
    filter_.reset(*population_n(), run.pose)
    rows: list[tuple[float, ...]] = []
    centres, sds = [], []
    for k in range(1, len(record.t)):
        steer, drive, brake = record.commands[k].tolist()
        found = filter_.update((steer, drive, brake), record.imu[k], record.wheel[k], record.gnss[k])
        if k % 2 == 0:
            warned = float(inner.immobilisation.announced)
            rows.append((record.t[k], found.mean, found.sd, float(found.valid), warned))
            centre, sd = inner.limits
            centres.append(centre)
            sds.append(sd)
    table, every = np.array(rows), slice(2, None, 2)
    acting = excited(record.readings[:, [at.A_Y, at.A_Z]], record.timing.period)
    return BeliefHistory(
        t=table[:, 0],
        centre=np.array(centres),
        sd=np.array(sds),
        n=table[:, 1:3],
        valid=table[:, 3] > 0.5,
        excited=acting[every][: len(table)],
        used=_used(run)[every][: len(table)],
        announced=table[:, 4] > 0.5,
        stuck=record.states[every, at.V_X][: len(table)] < _STUCK,
        distance=float(np.hypot(*np.diff(record.states[:, [at.X, at.Y]], axis=0).T).sum()),
    )


class LimitErrors(NamedTuple):
    """Errors of a belief along a run: the limits but the best slip, then n, a row per update."""

    z: np.ndarray  #: (T, 6) in standard deviations, on the scale where the belief is normal
    relative: np.ndarray  #: (T, 6) size of the error over the true limit; of n the size itself
    width: (
        np.ndarray
    )  #: (T, 6) half width of the 95 % interval over the believed limit; of n the width itself


def limit_errors(run: SoilRun, history: BeliefHistory) -> LimitErrors:
    """Errors of what is believed along a run."""
    truth, weight = np.zeros(LIMITS), VEHICLES[_VEHICLE].m * GRAVITY
    transform_limits(run.holds, weight, truth)
    kept = [i for i, name in enumerate(SoilHolds._fields) if name != "pull_slip"]
    shift = weight * np.array(SHIFT)[kept]
    centre, sd, true = history.centre[:, kept], history.sd[:, kept], np.array(run.holds)[kept]
    believed, reach = np.exp(centre) - shift, _Z95 * sd
    half = 0.5 * (np.exp(centre + reach) - np.exp(centre - reach))
    off, n_sd = history.n[:, 0] - run.record.plant.soil.n, history.n[:, 1]
    return LimitErrors(
        z=np.column_stack([(centre - truth[kept]) / sd, off / n_sd]),
        relative=np.column_stack([np.abs(believed / true - 1.0), np.abs(off)]),
        width=np.column_stack([half / np.maximum(np.abs(believed), 1e-6), _Z95 * n_sd]),
    )


def _used(run: SoilRun) -> np.ndarray:
    """(T, 2) shares of the limits that the drive has used so far: lateral, pull."""
    readings, vehicle = run.record.readings, run.record.plant.vehicle
    forces = readings[:, at.F_L] + readings[:, at.AXLE + at.F_L]
    lateral = np.abs(readings[:, at.A_Y]) / run.holds.lateral
    pull = forces / max(run.holds.pull, 0.03 * vehicle.m * GRAVITY)
    shares = np.stack([lateral, pull], axis=1)
    return np.maximum.accumulate(shares, axis=0)
