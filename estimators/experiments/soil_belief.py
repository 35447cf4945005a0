"""The online belief over whole soils along simulated drives, and its errors.

The drives are those of `estimators.experiments.unknown_soils`; the belief always starts from the whole
population of soils.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.belief.drive_fit import DriveFit, fit_drive
from estimators.belief.drive_limits import FittedLimitSettings, fitted_limits
from estimators.belief.drive_posterior import sample_drive
from estimators.belief.drive_problem import Surroundings
from estimators.experiments.adaptation import base_soil, continued, samples_until, true_plant
from estimators.experiments.model_mismatch import excited
from estimators.experiments.unknown_soils import CASES, VEHICLE, SoilRun
from estimators.filters.online import OnBoard, Thinned, make_estimator
from estimators.filters.online_soil_belief import (
    POPULATION_RANGE,
    OnlineSoilBelief,
    SoilBeliefSettings,
    population_n,
)
from estimators.filters.protocol import Estimator
from estimators.filters.soil_belief_holds import LIMITS, SHIFT, transform_limits
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.soil_holds import SoilHolds
from offroad_env.world.natural_soil import SoilSpread
from offroad_env.world.vehicles import VEHICLES

__all__ = [
    "BeliefHistory",
    "LimitErrors",
    "believe",
    "believe_fitted",
    "foreseen",
    "limit_errors",
    "stuck_at",
]

#: Quantile of a normal distribution that a 95 % interval ends at.
_Z95 = 1.959964
#: A vehicle that is slower is stuck [m/s].
_STUCK = 0.5


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
    risk: np.ndarray  #: (T,) probability that the soil gives no pull
    distance: float  #: driven until the end [m]


def believe(run: SoilRun, filter_: Estimator | None = None, *, until: float | None = None) -> BeliefHistory:
    """Run the belief over a drive, or over its part ``until`` [s].

    Its model is what the run states.
    """
    record = run.record
    last = len(record.t) if until is None else round(until / record.timing.period) + 1
    unit = ImuConfig(kind="specific_force") if CASES[run.case].nuisances else ImuConfig()
    if filter_ is None:
        receiver = GnssConfig(position_sd=1.5) if CASES[run.case].nuisances else GnssConfig()
        known = 0.0 if CASES[run.case].level else None
        choice = OnBoard(kind="online_soil_belief", rate=50.0, grade=known)
        filter_ = make_estimator(choice, run.stated, POPULATION_RANGE, unit, receiver)
    inner = filter_.inner if isinstance(filter_, Thinned) else filter_
    if not isinstance(inner, OnlineSoilBelief):
        raise InvalidParameter("filter_ must be a belief over whole soils")
    filter_.reset(*population_n(), run.pose)
    rows: list[tuple[float, ...]] = []
    centres, sds = [], []
    for k in range(1, last):
        steer, drive, brake = record.commands[k].tolist()
        found = filter_.update((steer, drive, brake), record.imu[k], record.wheel[k], record.gnss[k])
        if k % 2 == 0:
            risk = inner.immobilisation
            rows.append(
                (
                    record.t[k],
                    found.mean,
                    found.sd,
                    float(found.valid),
                    float(risk.announced),
                    risk.probability,
                )
            )
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
        risk=table[:, 5],
        distance=_distance(run, last),
    )


#: Ends of the parts of a drive to which a belief is fitted [s]: it counts from then on. A search goes on from
#: the fit before from the third on; after the first second it is too early to bind it.
_FITS = (1.0, 1.8, 4.8, 9.8)


def believe_fitted(
    run: SoilRun, *, until: float | None = None, settings: FittedLimitSettings | None = None
) -> BeliefHistory:
    """Fit the belief to ever longer parts of a drive; between two fits the last one is believed.

    Before the first fit nothing is believed: NaN, and the flag is down, as it is where no soil of the
    population lets the vehicle drive. The ground is that of its map with an unknown slope, unless the case's
    is known. Immobilisation is not announced.
    """
    record, nominal = run.record, run.stated._replace(soil=base_soil("population"))
    last = len(record.t) if until is None else round(until / record.timing.period) + 1
    rows = np.arange(2, last, 2)
    centre, sd = np.full((2, len(rows), LIMITS), np.nan)
    n, valid = np.full((len(rows), 2), np.nan), np.zeros(len(rows), dtype=bool)
    earlier: DriveFit | None = None
    grade = 0.0 if CASES[run.case].level else SoilBeliefSettings().grade
    surroundings = Surroundings(grade=grade, scatter=SoilSpread())
    for end in _FITS:
        since = record.t[rows] >= end
        if not since.any():
            break
        samples = samples_until(run, end)
        if not CASES[run.case].nuisances:
            samples = replace(samples, unit=ImuConfig())
        try:
            earlier = fit_drive(nominal, samples, earlier if end > _FITS[1] else None, surroundings)
            posterior = sample_drive(nominal, samples, earlier, surroundings)
            found = fitted_limits(nominal, earlier, posterior, settings)
        except SolverFailure:
            valid[since] = False
            continue
        centre[since], sd[since], n[since], valid[since] = found.centre, found.sd, found.n, found.valid
    acting = excited(record.readings[:, [at.A_Y, at.A_Z]], record.timing.period)
    return BeliefHistory(
        t=record.t[rows],
        centre=centre,
        sd=sd,
        n=n,
        valid=valid,
        excited=acting[rows],
        used=_used(run)[rows],
        announced=np.zeros(len(rows), dtype=bool),
        risk=np.zeros(len(rows)),
        distance=_distance(run, last),
    )


def _distance(run: SoilRun, last: int) -> float:
    """Way that is driven in the first rows [m]."""
    return float(np.hypot(*np.diff(run.record.states[:last, [at.X, at.Y]], axis=0).T).sum())


def stuck_at(run: SoilRun) -> float:
    """When the vehicle got stuck [s]; infinite where it did not."""
    rows = np.flatnonzero(run.record.states[:, at.V_X] < _STUCK)
    return float(run.record.t[rows[0]]) if rows.size else math.inf


def foreseen(run: SoilRun, ahead: float, within: float) -> bool:
    """Whether who knows soil and vehicle foresees ``ahead`` [s] before it that the vehicle gets stuck.

    True soil and vehicle, on a level road without scatter, must get stuck ``within`` [s] of that.
    """
    start = stuck_at(run) - ahead
    if not 0.0 <= start < math.inf:
        return False
    try:
        states = continued(true_plant(run), run, start, within)
    except SolverFailure:
        return True
    return bool((states[:, at.V_X] < _STUCK).any())


class LimitErrors(NamedTuple):
    """Errors of a belief along a run: the limits but the best slip, then n, a row per update."""

    z: np.ndarray  #: (T, 6) in standard deviations, on the scale where the belief is normal
    relative: np.ndarray  #: (T, 6) size of the error over the true limit; of n the size itself
    width: (
        np.ndarray
    )  #: (T, 6) half width of the 95 % interval over the believed limit; of n the width itself


def limit_errors(run: SoilRun, history: BeliefHistory) -> LimitErrors:
    """Errors of what is believed along a run."""
    truth, weight = np.zeros(LIMITS), VEHICLES[VEHICLE].m * GRAVITY
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
