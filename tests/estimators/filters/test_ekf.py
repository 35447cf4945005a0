"""The extended Kalman filter: as good as the unscented one near the truth, and no better elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.consistency import nis_test
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.ekf import ekf_step, run_ekf
from estimators.filters.joint_ukf import run_joint_filter
from estimators.models.half_car_on_map import ETA, JointSettings, only_imu, prior
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK

pytestmark = pytest.mark.check

SETTINGS = JointSettings()
ROW = ROWS[2]


@pytest.fixture(scope="module")
def problem():
    twin = simulate_row(ROW, 101, SETTINGS, duration=4.0)
    return row_model(ROW, SETTINGS), twin, only_imu(twin.z[:, :5])


def _start(model, n, sd):
    return prior(model, SETTINGS, n, sd, (0.0, 0.0, 0.0), 5.0)


def test_near_the_truth_both_filters_agree(problem):
    model, twin, z = problem
    start = _start(model, 0.5, 0.02)
    ours, unscented = run_ekf(model, start, twin.inputs, z), run_joint_filter(model, start, twin.inputs, z)
    # Curvature over a belief of 0.02 is what remains: a third of a standard deviation.
    assert np.abs(ours.belief.n - unscented.belief.n).max() < 0.35 * 0.02
    np.testing.assert_allclose(ours.belief.sd, unscented.belief.sd, rtol=0.25)
    assert nis_test(ours.belief.nis, 5, 0.999).consistent
    assert (ours.belief.repairs, ours.belief.lost) == (0, 0)


def test_soil_is_found(problem):
    model, twin, z = problem
    run = run_ekf(model, _start(model, 0.55, 0.05), twin.inputs, z)
    assert abs(run.belief.n[-1] - 0.5) < 4.0 * run.belief.sd[-1]
    assert run.belief.sd[-1] < 0.006


def test_without_measurements_it_predicts(problem):
    model, twin, z = problem
    run = run_ekf(model, _start(model, 0.5, 0.02), twin.inputs, np.full_like(z, math.nan))
    assert np.isnan(run.belief.nis).all()
    assert np.ptp(run.means[:, ETA]) == 0.0
    # Speed was known to 0.05 m/s, so after 4 s the place is known to some 0.2 m.
    assert math.sqrt(run.covariances[-1, at.X, at.X]) == pytest.approx(0.2, rel=0.2)


def test_a_soil_that_carries_no_vehicle_is_no_nan(problem):
    model, twin, z = problem
    mean, cov, warm = _start(model, 0.5, 0.02)
    mean[at.Z] = -10.0
    before = mean.copy(), cov.copy()
    nis, _, status = ekf_step(mean, cov, warm, twin.inputs[:3], z[1], model)
    assert status == SUNK
    assert math.isnan(nis)
    np.testing.assert_array_equal(mean, before[0])
    np.testing.assert_array_equal(cov, before[1])
