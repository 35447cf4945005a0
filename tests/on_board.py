"""Filters on board, and what they estimate on a drive."""

from __future__ import annotations

from estimators.filters.online_joint_ukf import OnlineJointSettings, OnlineJointUKF
from estimators.filters.online_parameter_ukf import OnlineParameterUKF
from estimators.filters.protocol import Pose
from offroad_env.physics import state as at
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

N_RANGE = (0.3, 1.1)
PRIOR = (0.7, 0.2)
BANK = OnlineJointSettings(components=5)


def believed(soil="dry_sand", vehicle="mrzr", ground=None):
    """What a filter takes for its plant: level ground, unless it has a map."""
    vehicle = VEHICLES[vehicle] if isinstance(vehicle, str) else vehicle
    return make_plant(vehicle, make_soil(soil, n=0.7), ground or flat())


def joint_filter(
    soil="dry_sand", *, vehicle="mrzr", imu=None, n_range=N_RANGE, ground=None, settings=None, plant=None
):
    """The joint filter, or with `BANK` several of it."""
    plant = believed(soil, vehicle, ground) if plant is None else plant
    return OnlineJointUKF(plant, n_range, imu=imu, settings=settings)


def joint_bank(soil="dry_sand", **options):
    """Five joint filters."""
    return joint_filter(soil, settings=BANK, **options)


def parameter_filter(
    soil="dry_sand", *, vehicle="mrzr", imu=None, n_range=N_RANGE, ground=None, settings=None, plant=None
):
    """The parameter filter."""
    plant = believed(soil, vehicle, ground) if plant is None else plant
    return OnlineParameterUKF(plant, n_range, imu=imu, settings=settings)


def pose_of(state):
    """Pose of a state (15,)."""
    return Pose(*(float(value) for value in state[[at.X, at.Y, at.YAW, at.V_X]]))


def estimates_of(drive, estimator, prior=PRIOR):
    """The estimate after every sample of a drive."""
    estimator.reset(*prior, pose_of(drive.states[0]))
    return [estimator.update(*sample) for sample in drive.samples()]
