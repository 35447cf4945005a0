"""The least standard deviations with which a drive can tell what the soil holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.belief.drive_fit import drive_bound
from estimators.belief.drive_limits import limit_slopes
from estimators.belief.drive_numbers import numbers_of
from estimators.belief.drive_problem import Surroundings
from estimators.experiments.adaptation import nominal_plant, samples_until
from estimators.experiments.unknown_soils import CASES, SoilRun, sloping
from estimators.filters.online_soil_belief import SoilBeliefSettings
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.soil_holds import SoilHolds
from offroad_env.world.natural_soil import SoilSpread

__all__ = ["limit_bounds"]


def limit_bounds(run: SoilRun, end: float) -> FloatArray:
    """(2, 6) bounds after a drive until ``end`` [s]: of the limits but the best slip, then of n.

    The unknowns and their prior are those of the belief over whole soils, with lag and drag; so is the
    slope of the ground unless it is known. First row: the model is exact, sensors err; second row: road and
    scatter are unknown, too, of the usual size. The bound of these numbers (`drive_bound`) is carried over to
    the limits by draws (`limit_slopes`): slopes at the truth would promise too much where a limit bends
    within it. On the scale of `BeliefHistory`.

    Raises
    ------
    SolverFailure
        Where the soil does not carry the vehicle.
    """
    nominal = nominal_plant("population")._replace(ground=sloping(run.slopes))
    truth = numbers_of(run.record.plant, nominal)
    grade = 0.0 if CASES[run.case].level else SoilBeliefSettings().grade
    samples = samples_until(run, end)
    if not CASES[run.case].nuisances:
        samples = replace(samples, unit=ImuConfig())
    kept = [i for i, name in enumerate((*SoilHolds._fields, "n")) if name != "pull_slip"]
    rows = []
    for scatter in (None, SoilSpread()):
        surroundings = Surroundings(grade=grade, scatter=scatter)
        covariance = drive_bound(nominal, samples, truth, surroundings)
        slopes = limit_slopes(nominal, truth, covariance)[kept]
        rows.append(np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes)))
    return np.array(rows)
