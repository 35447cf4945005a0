"""What every filter on board does, whatever it estimates n by."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from on_board import PRIOR, estimates_of, joint_bank, joint_filter, parameter_filter, pose_of

from estimators.filters.protocol import Estimator, Pose
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat, grade
from offroad_env.world.vehicles import VEHICLES

MAKERS = [parameter_filter, joint_filter]


@pytest.fixture(params=MAKERS, ids=lambda maker: maker.__name__)
def make(request):
    return request.param


def test_it_is_an_estimator(make):
    assert isinstance(make(), Estimator)


def test_sensors_of_another_mounting_are_understood(drive, make):
    imu = ImuConfig(kind="specific_force", lever_arm=(0.4, 0.2, 0.3))
    # A steep grade that the map knows: gravity along it is part of the reading.
    ground = grade(0.1)
    drive = drive(0.6, seed=7, unit=imu, ground=ground)
    assert estimates_of(drive, make(imu=imu, ground=ground))[-1].mean == pytest.approx(0.6, abs=0.03)


def test_a_grossly_wrong_sensor_takes_the_flag_down(drive, make):
    drive = drive(0.6, seed=8)
    drive.imu[:, 1] += 2.0  # the lateral accelerometer lies
    assert not estimates_of(drive, make())[-1].valid


@pytest.mark.parametrize("make", [parameter_filter, joint_bank])
def test_nothing_of_the_samples_is_kept(drive, make):
    # What the simulator does to its arrays after a sample was taken must not reach the estimate.
    drive = drive(0.6, seed=10, duration=2.0)
    clean = estimates_of(drive, make())
    estimator = make()
    estimator.reset(*PRIOR, pose_of(drive.states[0]))
    for k, (command, *sample) in enumerate(drive.samples()):
        arrays = [array.copy() for array in sample]
        estimate = estimator.update(command, *arrays)
        for array in arrays:
            array[:] = 1e9
        assert repr(estimate) == repr(clean[k])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
@pytest.mark.parametrize("make", [parameter_filter, joint_bank])
def test_a_copy_goes_its_own_way(drive, make, duplicate):
    samples = list(drive(0.6, seed=11, duration=2.0).samples())
    estimator = make()
    estimator.reset(*PRIOR, Pose(0.0, 0.0, 0.0, 3.0))
    for sample in samples[:60]:
        estimator.update(*sample)
    twin = duplicate(estimator)
    here = [estimator.update(*sample) for sample in samples[60:]]
    there = [twin.update(*sample) for sample in samples[60:]]
    assert repr(here) == repr(there)


@pytest.mark.parametrize("make", [parameter_filter, joint_bank])
def test_a_reset_forgets_everything(drive, make):
    drive = drive(0.6, seed=12, duration=2.0)
    estimator = make()
    first = estimates_of(drive, estimator)
    assert repr(estimates_of(drive, estimator)) == repr(first)


def test_a_belief_that_cannot_carry_the_vehicle_is_not_valid(drive, make):
    drive = drive(0.6, seed=14, duration=0.5)
    bog = make_soil("dry_sand", k_phi=2e4, k_c=0.0)
    estimator = make(plant=make_plant(VEHICLES["mrzr"], bog, flat()))
    estimates = estimates_of(drive, estimator)
    assert estimator.held
    assert not estimates[-1].valid
    assert estimates[-1].sd > PRIOR[1]


def test_a_lost_inertial_unit_holds_the_estimate(drive, make):
    drive = drive(0.6, seed=13, duration=4.0)
    drive.imu[200:250] = np.nan
    estimates = estimates_of(drive, make())
    assert estimates[245].sd > estimates[198].sd
    assert estimates[-1].sd < estimates[245].sd
    assert np.isfinite([e.mean for e in estimates]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [({"n_range": (1.0, 0.5)}, "n_range must be"), ({"soil": "hard_ground"}, "hard ground has no n")],
)
def test_what_cannot_work_is_refused(make, change, message):
    with pytest.raises(InvalidParameter, match=message):
        make(**change)


def test_a_prior_outside_the_range_is_refused(make):
    with pytest.raises(InvalidParameter, match="n_prior must be in"):
        make().reset(1.5, 0.1, Pose(0.0, 0.0, 0.0, 0.0))
