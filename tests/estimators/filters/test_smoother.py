"""The batch smoother: the most probable trajectory, and never less certain than a filter."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.analysis.consistency import nees
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_ukf import run_joint_filter
from estimators.filters.smoother import run_smoother
from estimators.models.half_car_on_map import JointSettings, only_imu, prior
from offroad_env.errors import InvalidParameter

SETTINGS = JointSettings()
ROW = ROWS[2]


@pytest.fixture(scope="module")
def problem():
    twin = simulate_row(ROW, 103, SETTINGS, duration=4.0)
    model, z = row_model(ROW, SETTINGS), only_imu(twin.z[:, :5])
    start = prior(model, SETTINGS, 0.53, 0.03, (0.0, 0.0, 0.0), 5.0)
    return model, start, twin, z, run_joint_filter(model, start, twin.inputs, z)


@pytest.fixture(scope="module")
def smoothed(problem):
    model, start, twin, z, filtered = problem
    return run_smoother(model, start, twin.inputs, z, filtered.means)


def test_it_converges_and_n_is_one_number(problem, smoothed):
    model, *_ = problem
    assert smoothed.converged
    assert smoothed.joint.belief.repairs == 0
    assert model.Q[10] == 0.0
    # A soil that does not change has one exponent for the whole run.
    assert np.ptp(smoothed.joint.belief.n) < 1e-6
    assert np.ptp(smoothed.joint.belief.sd) < 1e-4 * smoothed.joint.belief.sd[0]


def test_result_does_not_depend_on_the_first_guess(problem, smoothed):
    model, start, twin, z, _ = problem
    again = run_smoother(model, start, twin.inputs, z, twin.truth)
    sd = np.sqrt(np.diagonal(again.joint.covariances, axis1=1, axis2=2))
    # Both searches end within 1e-3 of a standard deviation.
    assert (np.abs(again.joint.means - smoothed.joint.means) / sd).max() < 0.01


def test_it_knows_more_than_the_filter_and_is_honest(problem, smoothed):
    _, _, twin, _, filtered = problem
    early = slice(20, 200)
    filter_sd = np.sqrt(np.diagonal(filtered.covariances, axis1=1, axis2=2))[early]
    sd = np.sqrt(np.diagonal(smoothed.joint.covariances, axis1=1, axis2=2))[early]
    # The unscented filter's variances bend with its own estimate: a margin of 5 %.
    assert (sd < 1.05 * filter_sd).all()
    assert smoothed.joint.belief.sd[0] < 0.25 * filtered.belief.sd[20]
    error = smoothed.joint.means[::50] - twin.truth[::50]
    # 11 degrees of freedom: 99.9 % lie below 31.
    assert (nees(error, smoothed.joint.covariances[::50]) < 31.3).all()


def test_wrong_arguments_are_refused(problem):
    model, start, twin, z, filtered = problem
    with pytest.raises(InvalidParameter, match="guess"):
        run_smoother(model, start, twin.inputs, z, filtered.means[:-1])
    with pytest.raises(InvalidParameter, match="iterations"):
        run_smoother(model, start, twin.inputs, z, filtered.means, iterations=0)
