"""The batch smoother: the most probable trajectory, and never less certain than a filter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from estimators.analysis.consistency import nees
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_ukf import run_joint_filter
from estimators.filters.smoother import run_smoother
from estimators.models.half_car_on_map import JointSettings, only_imu, prior
from offroad_env.errors import InvalidParameter

pytestmark = pytest.mark.check

SETTINGS = JointSettings()
ROW = ROWS[2]


class Problem(NamedTuple):
    """A drive to be smoothed."""

    model: Any
    start: Any
    twin: Any
    z: np.ndarray  #: measurements
    filtered: Any  #: by the joint filter

    def smoothed(self, guess, **options):
        """By the smoother, from a first guess of the means."""
        return run_smoother(self.model, self.start, self.twin.inputs, self.z, guess, **options)


@pytest.fixture(scope="module")
def problem():
    twin = simulate_row(ROW, 103, SETTINGS, duration=4.0)
    model, z = row_model(ROW, SETTINGS), only_imu(twin.z[:, :5])
    start = prior(model, SETTINGS, 0.53, 0.03, (0.0, 0.0, 0.0), 5.0)
    return Problem(model, start, twin, z, run_joint_filter(model, start, twin.inputs, z))


@pytest.fixture(scope="module")
def smoothed(problem):
    return problem.smoothed(problem.filtered.means)


def test_it_converges_and_n_is_one_number(problem, smoothed):
    assert smoothed.converged
    assert smoothed.joint.belief.repairs == 0
    assert problem.model.Q[10] == 0.0
    # A soil that does not change has one exponent for the whole run.
    assert np.ptp(smoothed.joint.belief.n) < 1e-6
    assert np.ptp(smoothed.joint.belief.sd) < 1e-4 * smoothed.joint.belief.sd[0]


def test_result_does_not_depend_on_the_first_guess(problem, smoothed):
    again = problem.smoothed(problem.twin.truth)
    sd = np.sqrt(np.diagonal(again.joint.covariances, axis1=1, axis2=2))
    # Both searches end within 1e-3 of a standard deviation.
    assert (np.abs(again.joint.means - smoothed.joint.means) / sd).max() < 0.01


def test_it_knows_more_than_the_filter_and_is_honest(problem, smoothed):
    twin, filtered = problem.twin, problem.filtered
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
    means = problem.filtered.means
    with pytest.raises(InvalidParameter, match="guess"):
        problem.smoothed(means[:-1])
    with pytest.raises(InvalidParameter, match="iterations"):
        problem.smoothed(means, iterations=0)
