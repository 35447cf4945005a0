"""A vehicle of the full model driven by a rule, its sensors, and online filters on what they measure."""

from __future__ import annotations

import numpy as np

from estimators.filters.belief_history import BeliefHistory
from estimators.filters.protocol import Pose
from estimators.filters.registry import ONLINE_FILTERS, filter_id
from estimators.filters.whole_run import FilterRun, run_filter
from offroad_env.physics import state as at
from offroad_env.simulation.drive import Driver, DriveRecord, Timing, simulate_drive
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import Plant, make_plant
from offroad_env.world.terrain import flat

__all__ = ["PERIOD", "record", "run_online"]

#: Time between samples of the sensors [s].
PERIOD = Timing().period


def record(plant: Plant, driver: Driver, duration: float, *, seed: int, speed: float = 3.0) -> DriveRecord:
    """Drive and record what inertial unit, wheels and satellite receiver measure.

    Parameters
    ----------
    plant
        Truth, of the full model.
    driver
        Asked at 50 Hz, as in the environment.
    duration
        [s]
    seed
        Of the sensors.
    speed
        At the start [m/s].

    Raises
    ------
    SolverFailure
        When the vehicle leaves the range of the model.
    """
    sensors = SensorSuite(imu=ImuConfig(), wheel=WheelSpeedConfig(), gnss=GnssConfig())
    return simulate_drive(plant, driver, sensors, seed, duration=duration, speed=speed)


def run_online(
    name: str, drive: DriveRecord, *, n_range: tuple[float, float], n_prior: float, sd: float
) -> BeliefHistory:
    """Run an online filter on a recorded drive, with the nominal vehicle on level ground as its model.

    Parameters
    ----------
    name
        One of `estimators.filters.registry.ONLINE_FILTERS`, or a short name.
    drive
    n_range
        Bounds of n [-].
    n_prior, sd
        Prior of n [-].
    """
    x = drive.states[0]
    run = FilterRun(
        plant=make_plant(drive.plant.vehicle, drive.plant.soil, flat()),
        dt=PERIOD,
        inputs=np.repeat(drive.commands, 2, axis=0)[1:],  # held over the sample that ends at their row
        z=np.column_stack([drive.imu, drive.wheel, drive.gnss]),
        pose=Pose(float(x[at.X]), float(x[at.Y]), float(x[at.YAW]), float(x[at.V_X])),
        n_prior=n_prior,
        sd=sd,
        n_range=n_range,
        imu=ImuConfig(),
    )
    return run_filter(filter_id(name, ONLINE_FILTERS), run)
