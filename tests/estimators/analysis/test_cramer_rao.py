"""The Cramer-Rao bound: the Kalman filter's covariance where the problem is linear."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.cramer_rao import linear_step, mean_bound, posterior_bound
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_ukf import run_joint_filter
from estimators.models.half_car_on_map import ETA, JointSettings, only_imu, prior
from offroad_env.errors import InvalidParameter

pytestmark = pytest.mark.check

SETTINGS = JointSettings()
ROW = ROWS[2]


def _linear_problem():
    rng = np.random.default_rng(11)
    F = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
    H = rng.normal(size=(2, 4))
    return F, H, np.array([0.0, 0.0, 0.02, 0.01]), np.array([0.3, 0.1])


def test_bound_is_the_kalman_covariance_on_a_linear_problem():
    F, H, Q, R = _linear_problem()
    cov, kalman = np.eye(4), np.eye(4)
    for _ in range(50):
        linear_step(cov, F, H, Q, R)
        predicted = F @ kalman @ F.T + np.diag(Q)
        gain = predicted @ H.T @ np.linalg.inv(H @ predicted @ H.T + np.diag(R))
        kalman = (np.eye(4) - gain @ H) @ predicted
    np.testing.assert_allclose(cov, kalman, rtol=1e-10, atol=1e-14)


def test_bound_is_the_information_recursion_of_the_paper():
    """Tichavsky et al. (1998), eq. 34 with D11 = F^T Q^-1 F and so on, where Q has an inverse."""
    F, H, _, R = _linear_problem()
    Q = np.array([0.03, 0.01, 0.02, 0.01])
    cov, J, Qi = np.eye(4), np.eye(4), np.diag(1.0 / Q)
    for _ in range(50):
        linear_step(cov, F, H, Q, R)
        J = Qi + H.T @ np.diag(1.0 / R) @ H - Qi @ F @ np.linalg.inv(J + F.T @ Qi @ F) @ F.T @ Qi
    np.testing.assert_allclose(cov, np.linalg.inv(J), rtol=1e-9)


@pytest.fixture(scope="module")
def steered():
    model = row_model(ROW, SETTINGS)
    twin = simulate_row(ROW, 101, SETTINGS, duration=4.0)
    z = only_imu(twin.z[:, :5])
    return model, twin, z


def test_bound_falls_while_steering_and_is_what_the_filter_claims(steered):
    model, twin, z = steered
    start = prior(model, SETTINGS, 0.5, 0.02, (0.0, 0.0, 0.0), 5.0)
    bound = posterior_bound(model, start, twin.truth, twin.inputs, z)
    assert bound[0] == pytest.approx(0.02, rel=1e-6)
    # Without noise in eta information about a constant never gets lost.
    assert (np.diff(bound) <= 1e-12).all()
    assert bound[-1] < 0.2 * bound[0]
    run = run_joint_filter(model, start, twin.inputs, z)
    # The filter linearises at its own estimate, the bound at the truth.
    np.testing.assert_allclose(run.belief.sd[100:], bound[100:], rtol=0.25)


def test_more_sensors_and_less_noise_lower_the_bound(steered):
    model, twin, z = steered
    start = prior(model, SETTINGS, 0.5, 0.02, (0.0, 0.0, 0.0), 5.0)
    bound = posterior_bound(model, start, twin.truth, twin.inputs, z)
    assert posterior_bound(model, start, twin.truth, twin.inputs, twin.z)[-1] < bound[-1]
    quiet = model._replace(R=0.25 * model.R)
    assert posterior_bound(quiet, start, twin.truth, twin.inputs, z)[-1] < bound[-1]
    nothing = np.full_like(z, math.nan)
    blind = posterior_bound(model, start, twin.truth, twin.inputs, nothing)
    # The difference quotient of an eta that stays as it is: 1 to rounding, times 400 steps.
    np.testing.assert_allclose(blind, blind[0], rtol=1e-9)


def test_information_is_averaged_over_truths():
    assert mean_bound([np.array([1.0]), np.array([1.0])]) == pytest.approx(1.0)
    assert mean_bound([np.array([0.1]), np.array([10.0])])[0] == pytest.approx(0.1 * math.sqrt(2.0), rel=1e-3)


def test_wrong_shapes_are_refused(steered):
    model, twin, z = steered
    start = prior(model, SETTINGS, 0.5, 0.02, (0.0, 0.0, 0.0), 5.0)
    with pytest.raises(InvalidParameter, match="truth must be"):
        posterior_bound(model, start, twin.truth[:-1], twin.inputs, z)
    with pytest.raises(InvalidParameter, match="half steps"):
        posterior_bound(model, start, twin.truth, twin.inputs[:-1], z)
    assert twin.truth.shape[1] == ETA + 1
