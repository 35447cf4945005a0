"""The joint filter: Kalman's where all is linear, honest and fast on the paper's model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.consistency import nis_test
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, row_plant, simulate_row
from estimators.filters.joint_ukf import joint_step, run_joint_filter
from estimators.models.half_car_on_map import (
    CHANNELS,
    ETA,
    SIZE,
    Belief,
    JointSettings,
    joint_model,
    only_imu,
    prior,
)
from estimators.numerics.bounded import from_range
from estimators.numerics.unscented import (
    centred_weights,
    merwe_weights,
    sigma_points,
    unscented_mean_covariance,
    unscented_update,
)
from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.simulation.simulator import make_plant, settled_state

SETTINGS = JointSettings()
ROW = ROWS[2]
START = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def model():
    return row_model(ROW, SETTINGS)


@pytest.fixture(scope="module")
def twin():
    return simulate_row(ROW, 101, SETTINGS, duration=6.0)


@pytest.fixture(scope="module")
def run(model, twin):
    start = prior(model, SETTINGS, 0.7, 0.1, START, 5.0)
    return run_joint_filter(model, start, twin.inputs, only_imu(twin.z[:, :5]))


def _random_problem(rng, L=5, m=3):
    A = rng.normal(size=(L, L))
    return rng.normal(size=L), A @ A.T + np.eye(L), rng.normal(size=(m, L)), rng.uniform(0.1, 1.0, m)


def _points(mean, cov, weights):
    L = len(mean)
    points = np.empty((2 * L + 1, L))
    sigma_points(mean, cov, weights.scale, np.empty((L, L)), points)
    return points


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_predict_and_update_are_the_kalman_filter_on_a_linear_problem(alpha):
    rng = np.random.default_rng(1)
    mean, cov, H, R = _random_problem(rng)
    F, Q = np.eye(5) + 0.2 * rng.normal(size=(5, 5)), np.diag([0.0, 0.0, 0.1, 0.2, 0.3])
    weights = merwe_weights(5.0, alpha, 0.0)
    x, P = mean.copy(), cov.copy()
    for _ in range(20):
        z = rng.normal(size=3)
        points = _points(mean, cov, weights) @ F.T
        unscented_mean_covariance(points, weights, mean, cov)
        cov += Q
        points = _points(mean, cov, weights)
        density, nis, repairs = unscented_update(mean, cov, points, points @ H.T, z, R, weights, np.empty(3))
        x, P = F @ x, F @ P @ F.T + Q
        S = H @ P @ H.T + np.diag(R)
        e = z - H @ x
        assert nis == pytest.approx(e @ np.linalg.solve(S, e), rel=1e-9)
        expected = -0.5 * (nis + np.linalg.slogdet(2.0 * math.pi * S)[1])
        assert density == pytest.approx(expected, rel=1e-9)
        gain = P @ H.T @ np.linalg.inv(S)
        x, P = x + gain @ e, P - gain @ S @ gain.T
        assert repairs == 0
    # alpha = 0.1 has central weights of -500: three digits are lost by cancellation.
    np.testing.assert_allclose(mean, x, atol=1e-10)
    np.testing.assert_allclose(cov, P, atol=1e-10)


def test_innovations_are_reported_in_their_own_standard_deviations():
    rng = np.random.default_rng(2)
    mean, cov, H, R = _random_problem(rng)
    weights, z, innovation = merwe_weights(5.0, 0.7, 0.0), rng.normal(size=3), np.empty(3)
    S, e = H @ cov @ H.T + np.diag(R), z - H @ mean
    points = _points(mean, cov, weights)
    unscented_update(mean, cov, points, points @ H.T, z, R, weights, innovation)
    np.testing.assert_allclose(innovation, e / np.sqrt(np.diag(S)), rtol=1e-10)


def test_covariances_about_the_image_of_the_centre_are_positive_and_no_less_than_about_the_mean():
    rng = np.random.default_rng(3)
    mean, cov, H, _ = _random_problem(rng, L=12)
    spread = 1.7
    weights = centred_weights(12.0, spread)
    images = np.tanh(_points(mean, cov, weights) @ H.T)
    moved, about_centre = np.empty(3), np.empty((3, 3))
    unscented_mean_covariance(images, weights, moved, about_centre)
    apart = (images - images[0])[1:]
    np.testing.assert_allclose(about_centre, apart.T @ apart / (2.0 * spread**2), rtol=1e-9)
    assert np.linalg.eigvalsh(about_centre).min() > 0.0


def test_prior_ties_the_height_to_the_soil(model):
    mean, cov, _ = prior(model, SETTINGS, 0.5, 0.05, START, 5.0)
    harder, softer = (prior(model, SETTINGS, n, 0.05, START, 5.0)[0] for n in (0.49, 0.51))
    assert harder[at.Z] > mean[at.Z] > softer[at.Z], "a smaller exponent carries more at these depths"
    slope = cov[at.Z, ETA] / cov[ETA, ETA]
    assert slope == pytest.approx((softer[at.Z] - harder[at.Z]) / (softer[ETA] - harder[ETA]), rel=0.01)
    np.testing.assert_allclose(cov, cov.T)
    np.linalg.cholesky(cov)


def test_prior_is_the_settled_state(model):
    mean, _, warm = prior(model, SETTINGS, 0.5, 0.05, START, 5.0)
    state, settled_warm = settled_state(row_plant(ROW), v_x=5.0)
    np.testing.assert_allclose(mean[:ETA], state[:ETA], atol=1e-12)
    np.testing.assert_allclose(warm, settled_warm, rtol=1e-9)


def test_imu_alone_finds_the_soil(run, twin):
    assert run.belief.n[0] == pytest.approx(0.7, abs=0.01)
    # Four standard deviations of the bound there (0.002).
    assert abs(run.belief.n[-1] - 0.5) < 0.01
    assert run.belief.sd[-1] < 0.005
    assert (run.belief.repairs, run.belief.lost) == (0, 0)
    assert (run.belief.low < run.belief.n).all()
    assert (run.belief.n < run.belief.high).all()
    assert np.abs(run.means[-1, at.V_X] - twin.truth[-1, at.V_X]) < 4.0 * math.sqrt(
        run.covariances[-1, at.V_X, at.V_X]
    )


def test_innovations_are_chi_square_from_a_narrow_start(model, twin):
    start = prior(model, SETTINGS, 0.5, 0.02, START, 5.0)
    run = run_joint_filter(model, start, twin.inputs, only_imu(twin.z[:, :5]))
    assert nis_test(run.belief.nis, 5, 0.999).consistent


def test_all_sensors_help(model, twin, run):
    start = prior(model, SETTINGS, 0.7, 0.1, START, 5.0)
    every = run_joint_filter(model, start, twin.inputs, twin.z)
    variance = np.diagonal(every.covariances[-1])
    alone = np.diagonal(run.covariances[-1])
    assert variance[at.V_X] < 0.5 * alone[at.V_X]
    assert every.belief.sd[-1] < run.belief.sd[-1]


def test_course_is_compared_on_the_right_branch(model, twin):
    """A course of 2 pi more is the same course."""
    start = prior(model, SETTINGS, 0.5, 0.02, START, 5.0)
    turned = twin.z.copy()
    turned[:, CHANNELS.index("course")] -= 2.0 * math.pi
    first = run_joint_filter(model, start, twin.inputs, twin.z)
    second = run_joint_filter(model, start, twin.inputs, turned)
    np.testing.assert_allclose(first.means, second.means, atol=1e-9)


def test_without_measurements_the_belief_about_the_soil_holds(model, twin):
    settings = JointSettings(drift=0.05)
    mean, cov, warm = prior(model, settings, 0.5, 0.02, START, 5.0)
    blind = np.full((101, len(CHANNELS)), math.nan)
    run = run_joint_filter(row_model(ROW, settings), Belief(mean, cov, warm), twin.inputs[:201], blind)
    assert np.isnan(run.belief.nis).all()
    assert run.means[-1, ETA] == pytest.approx(mean[ETA], abs=1e-9)
    # One second of random walk adds drift^2 to the variance of eta.
    assert run.covariances[-1, ETA, ETA] == pytest.approx(cov[ETA, ETA] + 0.05**2, rel=1e-6)


def test_a_soil_that_carries_no_vehicle_is_no_nan(model, twin):
    mean, cov, warm = prior(model, SETTINGS, 0.5, 0.02, START, 5.0)
    warms = np.empty((2 * SIZE + 1, 2, 3))
    warms[:] = warm
    cov[at.Z, at.Z] = 100.0  # sigma points metres under the ground
    before = mean.copy(), cov.copy()
    z = only_imu(twin.z[1:2, :5])[0]
    log_likelihood, _, _, status = joint_step(mean, cov, warms, twin.inputs[:3], z, model)
    assert status == SUNK
    assert log_likelihood == -math.inf
    np.testing.assert_array_equal(mean, before[0])
    np.testing.assert_array_equal(cov, before[1])


def test_wrong_arguments_are_refused(model, twin):
    with pytest.raises(InvalidParameter, match="paper"):
        joint_model(row_plant(ROW)._replace(half_car=0.0), 0.01, SETTINGS)
    plant = row_plant(ROW)
    full = make_plant(plant.vehicle, plant.soil, plant.ground)
    with pytest.raises(InvalidParameter, match="paper"):
        joint_model(full, 0.01, SETTINGS)
    with pytest.raises(InvalidParameter, match="ms"):
        joint_model(plant, 10.0, SETTINGS)
    with pytest.raises(InvalidParameter, match="prior"):
        prior(model, SETTINGS, 1.5, 0.1, START, 5.0)
    with pytest.raises(InvalidParameter, match="start must be 10"):
        JointSettings(start=(0.1,) * 9)
    with pytest.raises(InvalidParameter, match="process"):
        JointSettings(process=(0.0,) * 5)
    with pytest.raises(InvalidParameter, match="only_imu"):
        run_joint_filter(model, prior(model, SETTINGS, 0.5, 0.1, START, 5.0), twin.inputs, twin.z[:, :5])


def test_twin_draws_start_and_noise_from_the_stated_spread(model):
    starts, readings = [], []
    for seed in range(40):
        twin = simulate_row(ROW, seed, SETTINGS, duration=0.02)
        starts.append(twin.truth[0, :ETA])
        readings.append(twin.z[0, :3])
    spread = (np.array(starts) - settled_state(row_plant(ROW), v_x=5.0)[0][:ETA]) / SETTINGS.start
    # 400 standard normal numbers: their standard deviation is 1 +- 0.035.
    assert spread.std() == pytest.approx(1.0, abs=0.14)
    # The displaced start moves a_z more than the sensor does; a_y is almost all sensor.
    assert np.array(readings)[:, 1].std() == pytest.approx(0.2, rel=0.4)
    changed = simulate_row(ROW, 0, SETTINGS, duration=0.1, change=(0.05, 0.8))
    np.testing.assert_allclose(changed.n, np.where(np.arange(11) < 5, 0.5, 0.8), atol=1e-12)
    assert changed.truth[-1, ETA] == pytest.approx(from_range(0.8, model.low, model.high))
