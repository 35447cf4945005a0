"""Which estimator a vehicle carries, at what rate, and what it believes."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.filters.online import OnBoard, Thinned, make_estimator
from estimators.filters.online_joint_ukf import OnlineJointUKF
from estimators.filters.online_parameter_ukf import OnlineParameterUKF
from estimators.filters.protocol import Estimate, Estimator, Pose
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat, grade
from offroad_env.world.vehicles import VEHICLES, make_vehicle

PLANT = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=0.7), flat())


def carried(choice):
    return make_estimator(choice, PLANT, (0.3, 1.1), ImuConfig(), GnssConfig())


class Listening:
    """Writes down what it is told."""

    def __init__(self):
        self.heard = []

    def reset(self, n_prior, sd, pose):
        self.heard.clear()
        return Estimate(n_prior, sd, np.nan, True, 0)

    def update(self, *sample):
        self.heard.append(sample)
        return Estimate(0.1 * len(self.heard), 0.1, 1.0, True, 0)


def test_a_slower_estimator_gets_the_mean_of_the_inertial_samples_and_the_last_of_the_others():
    inner = Listening()
    thinned = Thinned(inner, 2)
    thinned.reset(0.5, 0.1, Pose(0.0, 0.0, 0.0, 3.0))
    rims, fix, nothing = np.array([3.0, 3.1]), np.arange(4.0), np.full(4, np.nan)
    assert thinned.update((0.1, 1.0, 0.0), np.full(5, 1.0), rims, fix).mean == 0.5
    assert thinned.update((0.1, 1.0, 0.0), np.full(5, 2.0), nothing[:2], nothing).mean == 0.1
    thinned.update((0.1, 1.0, 0.0), np.full(5, 7.0), nothing[:2], nothing)
    thinned.update((0.1, 1.0, 0.0), np.full(5, 9.0), nothing[:2], nothing)
    (_, imu, wheel, gnss), (_, imu_2, wheel_2, gnss_2) = inner.heard
    assert np.array_equal(imu, np.full(5, 1.5))
    assert np.array_equal(wheel, rims)
    assert np.array_equal(gnss, fix)
    assert np.array_equal(imu_2, np.full(5, 8.0))
    assert np.isnan(wheel_2).all()
    assert np.isnan(gnss_2).all()


@pytest.mark.parametrize("kind", ["parameter", "joint", "bank"])
@pytest.mark.parametrize("rate", [100.0, 50.0])
def test_every_kind_runs_at_every_rate(kind, rate, drive):
    estimator = carried(OnBoard(kind=kind, rate=rate))
    assert isinstance(estimator, Estimator)
    drive = drive(0.55, seed=21, duration=8.0)
    estimator.reset(0.7, 0.2, Pose(0.0, 0.0, 0.0, 3.0))
    for sample in drive.samples():
        estimate = estimator.update(*sample)
    assert estimate.mean == pytest.approx(0.55, abs=0.06)
    assert estimate.valid


def test_what_is_believed_otherwise_is_believed():
    heavier, clay, slope = make_vehicle("mrzr", m=1500.0), make_soil("clay"), grade(0.1)
    choice = OnBoard(vehicle=heavier, soil=clay, ground=slope, vehicle_model="bicycle")
    belief = choice.belief(PLANT)
    assert (belief.vehicle, belief.soil, belief.ground, belief.half_car) == (heavier, clay, slope, 0.0)
    assert OnBoard().belief(PLANT)[:2] == PLANT[:2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "oracle"}, "kind must be one of"),
        ({"rate": 0.01}, "a period in s"),
        ({"vehicle_model": "unicycle"}, "vehicle_model must be one of"),
        ({"kind": "joint", "changing": True}, 'changing needs kind "online_parameter_ukf"'),
    ],
)
def test_a_choice_that_means_nothing_is_refused(change, message):
    with pytest.raises(InvalidParameter, match=message):
        OnBoard(**change)


def test_a_rate_that_does_not_divide_the_sensors_is_refused():
    with pytest.raises(InvalidParameter, match="rate must divide the 100 Hz"):
        carried(OnBoard(rate=70.0))


def test_a_filter_of_n_alone_has_rigid_rims_and_says_so():
    structured = make_plant(VEHICLES["mrzr"], make_soil("dry_sand", n=0.7), flat(), structure="field")
    assert OnBoard(kind="joint").belief(structured).structure is None
    assert OnBoard(kind="belief").belief(structured).structure is not None
    for kind in (OnlineParameterUKF, OnlineJointUKF):
        with pytest.raises(InvalidParameter, match=r"plant\.structure must be None.*online_soil_belief"):
            kind(structured, (0.3, 1.1))


def test_samples_that_are_missing_do_not_count_in_a_mean():
    inner = Listening()
    thinned = Thinned(inner, 2)
    thinned.reset(0.5, 0.1, Pose(0.0, 0.0, 0.0, 3.0))
    nothing = np.full(5, np.nan)
    for imu in (nothing, np.ones(5), nothing, nothing):
        thinned.update((0.1, 1.0, 0.0), imu, nothing[:2], nothing[:4])
    assert (inner.heard[0][1] == 1.0).all()
    assert np.isnan(inner.heard[1][1]).all()
