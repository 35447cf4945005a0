"""The information gate: where the motion says nothing, estimates hold and no filter grows surer."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.cramer_rao import posterior_bound
from estimators.experiments.buzhardt_tallapragada import ROWS, row_plant
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_bank import BankSettings, run_bank
from estimators.filters.joint_ukf import run_joint_filter
from estimators.filters.online import OnBoard, make_estimator
from estimators.filters.protocol import Pose
from estimators.filters.registry import ONLINE_FILTERS
from estimators.models.half_car_on_map import JointSettings, prior
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import flat
from offroad_env.world.vehicles import VEHICLES

LEVEL = ROWS[2]._replace(H0=0.0)
DRIFT = 0.05


@pytest.fixture(scope="module")
def straight_on():
    """Level clay, straight on at constant speed for 5 s: joint filter, bank, bound, twin."""
    plant = row_plant(LEVEL)
    run = simulate(plant, *settled_state(plant, v_x=5.0), duration=0.02)
    hold = -float(run.readings[0, at.A_X]) * plant.vehicle.m
    inputs = np.tile([0.0, hold, math.nan], (1001, 1))
    settings = JointSettings(drift=DRIFT)
    twin, model = simulate_row(LEVEL, 101, settings, inputs=inputs), row_model(LEVEL, settings)
    start = prior(model, settings, 0.5, 0.003, (0.0, 0.0, 0.0), 5.0)
    z = twin.readings()
    bank = BankSettings(
        joint=settings, n_prior=0.5, n_prior_sd=0.003, n_fan=(0.49, 0.51), components=5, overlap=0.6
    )
    return (
        run_joint_filter(model, start, inputs, z),
        run_bank(model, bank, inputs, z, v_x=5.0),
        posterior_bound(model, start, twin.truth, inputs, z),
        twin,
    )


@pytest.mark.check
def test_straight_on_at_constant_speed_the_band_grows(straight_on):
    joint, bank, bound, twin = straight_on
    # Without a measurement 5 s of random walk would add this much: dn/deta is 0.225 at n = 0.5.
    walk = 0.225 * DRIFT * math.sqrt(5.0)
    for run in (joint, bank):
        assert 0.5 * walk < run.belief.sd[-1] < 1.2 * walk
        assert run.belief.sd[-1] > 3.0 * run.belief.sd[0]
        # Nothing is learnt that is not there: never surer than the bound (its slopes are the truth's).
        assert (run.belief.sd[50:] > 0.9 * bound[50:]).all()
        assert (np.abs(run.belief.n - twin.n) < 3.0 * run.belief.sd).mean() > 0.95


@pytest.fixture(scope="module")
def stop_and_stand(drive):
    """5 s of driving on sand of n = 0.8, then 6 s of braking and standing."""
    vehicle = VEHICLES["mrzr"]

    def driver(t, v):
        if t >= 5.0:
            return 0.0, 0.0, 0.4 * vehicle.brake_torque_max
        pedal = 0.25 + 0.35 * (4.0 + math.sin(1.3 * t) - v)
        return 0.1 * math.sin(1.5 * t), min(max(pedal, 0.0), 1.0) * vehicle.drive_torque_max, 0.0

    return drive(0.8, seed=1, duration=11.0, driver=driver, ground=flat())


@pytest.mark.parametrize("kind", ONLINE_FILTERS)
def test_standing_on_board_the_estimate_holds_and_its_band_grows(stop_and_stand, kind):
    record = stop_and_stand
    belief = make_plant(VEHICLES["mrzr"], make_soil("dry_sand"), flat())
    estimator = make_estimator(OnBoard(kind=kind), belief, (0.4, 1.2), ImuConfig(), GnssConfig())
    estimator.reset(0.9, 0.1, Pose(*record.states[0, [at.X, at.Y, at.YAW, at.V_X]]))
    beliefs = [estimator.update(*sample) for sample in record.samples()]
    assert record.states[700, at.V_X] < 0.1, "it stands after 7 s"
    standing, end = beliefs[800], beliefs[-1]
    assert end.mean == pytest.approx(standing.mean, abs=0.05 * standing.sd)
    assert end.sd > 1.03 * standing.sd
    assert end.valid
    # It had learnt something to hold.
    assert standing.sd < 0.06
