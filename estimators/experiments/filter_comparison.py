"""Every filter for n under one protocol: the same simulated rows, prior, noise and score.

A simulated row (`estimators.experiments.simulated_rows.simulate_row`) is a true drive with noise in start,
motion and sensors. All filters start from the same prior of n, N(1.0, 0.3^2), settled on the soil of their
own hypothesis. Only the paper's parameter filter keeps its own narrower prior, with which its settings were
found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.analysis.cramer_rao import posterior_bound
from estimators.analysis.scores import Score, failed_score, score
from estimators.experiments.buzhardt_tallapragada import CHOICES, KNOWN_SETTINGS, SETTINGS, row_plant
from estimators.experiments.simulated_rows import SimulatedRow, row_model
from estimators.filters.belief_history import BeliefHistory
from estimators.filters.protocol import Pose
from estimators.filters.registry import FILTERS, SENSORS, filter_id
from estimators.filters.whole_run import FilterRun
from estimators.filters.whole_run import run_filter as run_whole
from estimators.models.half_car_on_map import ETA, IMU_CHANNELS, JointSettings, prior
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics import state as at

__all__ = ["COMPARED", "row_bound", "row_run", "run_filter", "scored"]

#: Ids of the filters that are compared: those over a whole run that take their model for exact.
COMPARED = tuple(entry.id for entry in FILTERS.values() if entry.make is None and entry.exact_model)


def row_run(drive: SimulatedRow, *, sensors: str = "imu", settings: JointSettings | None = None) -> FilterRun:
    """A simulated row as the filters get it: settled start, common prior, the settings for all rows.

    Parameters
    ----------
    drive : SimulatedRow
        Made with the same ``settings``.
    sensors : str
        One of `estimators.filters.registry.SENSORS`.
    settings : JointSettings, optional
        Noise in the filters' model; default: the one setting for all rows.
    """
    return FilterRun(
        plant=row_plant(drive.row),
        dt=drive.dt,
        inputs=drive.inputs,
        z=drive.readings(sensors),
        pose=Pose(0.0, 0.0, 0.0, CHOICES["start_speed"].value),
        joint=settings or JointSettings(),
        parameter=SETTINGS["half_car"],
        seed=drive.seed,
    )


def run_filter(
    name: str, drive: SimulatedRow, *, sensors: str = "imu", settings: JointSettings | None = None
) -> BeliefHistory:
    """Run one of the `COMPARED` filters on a simulated row.

    Parameters
    ----------
    name : str
        An id of `COMPARED`, or a short name.
    drive, sensors, settings
        As in `row_run`; the parameter filter uses the inertial unit only.

    Raises
    ------
    InvalidParameter
        For another filter, or sensors that it cannot use.
    SolverFailure
        Where the filter finds no contact solution any more.
    """
    known = filter_id(name, COMPARED)
    entry = FILTERS[known]
    if sensors not in SENSORS or (sensors != entry.sensors and not entry.more_sensors):
        raise InvalidParameter(f"the filter {known} cannot use the sensors {sensors!r}")
    run = row_run(drive, sensors=sensors, settings=settings)
    if known == "parameter_ukf_known_state":
        states = np.zeros((len(drive.z), at.STATE_SIZE))
        states[:, :ETA] = drive.truth[:, :ETA]
        run = replace(run, parameter=KNOWN_SETTINGS["half_car"], known=states)
    return run_whole(known, run)


def row_bound(
    drive: SimulatedRow, *, sensors: str = "imu", settings: JointSettings | None = None
) -> np.ndarray:
    """Posterior Cramer-Rao bound on sd(n) along a simulated row, with the filters' Q and P0, (T,) [-]."""
    settings = settings or JointSettings()
    run, model = row_run(drive, sensors=sensors, settings=settings), row_model(drive.row, settings)
    start = prior(model, settings, float(drive.n[0]), run.sd, run.place(), run.pose.v)
    return posterior_bound(model, start, drive.truth, drive.inputs, run.z)


def scored(name: str, drive: SimulatedRow, *, sensors: str = "imu") -> Score:
    """Run a filter and score it; one that finds no solution any more counts as failed."""
    try:
        return score(run_filter(name, drive, sensors=sensors), drive.n)
    except SolverFailure:
        return failed_score(drive.n, IMU_CHANNELS)
