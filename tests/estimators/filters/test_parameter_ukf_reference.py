"""The unscented filter: a Kalman filter where it must be one, and the same in both implementations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from estimators.experiments.buzhardt_tallapragada import (
    KNOWN_SETTINGS,
    ROWS,
    SETTINGS,
    noisy_imu,
    row_truth,
    run_row,
)
from estimators.filters.parameter_ukf_reference import ReferenceUKF, run_reference_filter
from estimators.numerics.unscented import (
    check_alpha,
    guarded_cholesky,
    merwe_weights,
    sigma_points,
    unscented_update,
)
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import paper_terrain
from offroad_env.world.vehicles import VEHICLES


class CompiledUKF:
    """The compiled kernels behind the interface of the reference."""

    def __init__(self, w, P, R_n, R_e, alpha):
        check_alpha(alpha)
        self.mean, self.covariance = np.array(w), np.array(P)
        self.R_n, self.R_e = R_n, np.diag(R_e).copy()
        self.weights = merwe_weights(float(len(w)), alpha, 0.0)
        self.repairs = 0

    def update(self, z, observe):
        L = len(self.mean)
        points, factor = np.empty((2 * L + 1, L)), np.empty((L, L))
        self.covariance += self.R_n
        self.repairs += sigma_points(self.mean, self.covariance, self.weights.scale, factor, points)
        predicted = np.array([observe(point) for point in points])
        update = unscented_update(
            self.mean, self.covariance, points, predicted, z, self.R_e, self.weights, np.empty(len(z))
        )
        self.nis = update.nis
        self.repairs += update.repairs


FILTERS = [ReferenceUKF, CompiledUKF]
R_N = np.array([[0.1, 0.02, 0.0], [0.02, 0.05, 0.01], [0.0, 0.01, 0.2]])
R_E = np.diag([0.3, 0.2, 0.5, 1.0])


def kalman_step(w, P, H, z):
    P = P + R_N
    S = H @ P @ H.T + R_E
    K = P @ H.T @ np.linalg.inv(S)
    return w + K @ (z - H @ w), P - K @ S @ K.T


class RecipeOf145(ReferenceUKF):
    """filterpy 1.4.5: the update reuses the sigma points from before the process noise."""

    def update(self, z, observe):
        self.filter.predict()
        spread = self.filter.P - self.filter.Q
        self.filter.sigmas_f = self.filter.points_fn.sigma_points(self.filter.x, spread)
        self.filter.update(z, hx=observe)


def distance_from_kalman(filter_class, alpha):
    """Largest difference of mean and covariance from the Kalman filter's over 300 updates."""
    rng = np.random.default_rng(0)
    w, P = rng.normal(size=3), np.diag([1.0, 2.0, 0.5])
    ukf, apart = filter_class(w, P, R_N, R_E, alpha), 0.0
    for _ in range(300):
        H, z = rng.normal(size=(4, 3)), rng.normal(size=4)
        w, P = kalman_step(w, P, H, z)
        ukf.update(z, lambda point, H=H: H @ point)
        apart = max(apart, np.abs(ukf.mean - w).max(), np.abs(ukf.covariance - P).max())
    return apart


@pytest.mark.peer
@pytest.mark.parametrize("filter_class", FILTERS)
@pytest.mark.parametrize("alpha", [0.1, 1.0])
def test_on_a_linear_problem_the_unscented_filter_is_the_kalman_filter(filter_class, alpha):
    assert distance_from_kalman(filter_class, alpha) < 1e-10


def test_without_the_process_noise_in_the_gain_it_is_not():
    # What makes the test before this one fail with filterpy 1.4.5.
    assert distance_from_kalman(RecipeOf145, 1.0) > 1e-3


def test_weights_are_the_papers():
    L, alpha, kappa = 2.0, 0.3, 0.5
    lam = alpha**2 * (L + kappa) - L
    assert tuple(merwe_weights(L, alpha, kappa)) == pytest.approx(
        (lam / (L + lam), lam / (L + lam) - alpha**2 + 3.0, 0.5 / (L + lam), L + lam), rel=1e-14
    )


def test_normalised_innovations_of_a_matched_filter_are_chi_square():
    rng = np.random.default_rng(1)
    w = rng.normal(size=3)
    ukf = CompiledUKF(w + rng.normal(size=3), np.eye(3), R_N, R_E, 0.5)
    steps, total = 400, 0.0
    for _ in range(steps):
        w = rng.multivariate_normal(w, R_N)
        H = rng.normal(size=(4, 3))
        ukf.update(rng.multivariate_normal(H @ w, R_E), lambda point, H=H: H @ point)
        total += ukf.nis
    low, high = chi2.ppf([0.001, 0.999], 4 * steps)
    assert low < total < high


@pytest.mark.parametrize("model", ["half_car", "bicycle"])
@pytest.mark.parametrize("source", ["propagated", "known"])
def test_compiled_run_is_the_references_run_on_the_real_observation_model(model, source):
    truth = row_truth(ROWS[3], duration=4.0)
    run = run_row(ROWS[3], model, truth=truth, seed=7, source=source)
    settings = (SETTINGS if source == "propagated" else KNOWN_SETTINGS)[model]
    plant = make_plant(
        VEHICLES["paper"],
        make_soil("clay", n=settings.n_prior),
        paper_terrain(ROWS[3].H0),
        model="paper",
        vehicle_model=model,
        slip=truth.slip,
    )
    start = settled_state(plant, v_x=float(run.filter.states[0, 5]))
    imu, known = noisy_imu(truth, 7), truth.run.states if source == "known" else None
    reference = run_reference_filter(plant, start, truth.inputs, imu, 0.01, settings, known=known)
    compiled = run.filter
    for name in ("n", "sd", "low", "high"):
        np.testing.assert_allclose(
            getattr(reference.belief, name), getattr(compiled.belief, name), atol=1e-10
        )
    # The nis is a sum over five channels of squares of order 10.
    np.testing.assert_allclose(reference.belief.nis[1:], compiled.belief.nis[1:], rtol=1e-8)
    np.testing.assert_allclose(reference.states[-1], compiled.states[-1], atol=1e-8)
    assert (reference.belief.lost, reference.belief.repairs) == (
        compiled.belief.lost,
        compiled.belief.repairs,
    )
    assert abs(compiled.belief.n[-1] - settings.n_prior) > 0.05, "nothing was learnt, so nothing was compared"


def test_a_repair_is_counted_and_leaves_a_factor_of_nearly_the_same_matrix():
    matrix = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-9]])
    factor = np.zeros((2, 2))
    assert guarded_cholesky(matrix, factor) > 0
    assert factor @ factor.T == pytest.approx(matrix, abs=1e-7)
    assert guarded_cholesky(np.eye(2), factor) == 0


def test_repairs_reach_the_filters_count():
    ukf = CompiledUKF(
        np.zeros(2), np.array([[1.0, 1.0], [1.0, 1.0 - 1e-9]]), np.zeros((2, 2)), np.eye(1), 1.0
    )
    ukf.update(np.zeros(1), lambda point: point[:1])
    assert ukf.repairs > 0


def test_a_matrix_beyond_repair_gives_nan_instead_of_a_wrong_factor():
    factor = np.zeros((2, 2))
    guarded_cholesky(np.full((2, 2), np.nan), factor)
    assert np.isnan(factor).all()


def test_sigma_points_have_the_mean_and_covariance_that_they_stand_for():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    mean, covariance = rng.normal(size=3), root @ root.T
    centre, _, weight, scale = merwe_weights(3.0, 0.7, 0.0)
    points = np.empty((7, 3))
    sigma_points(mean, covariance, scale, np.empty((3, 3)), points)
    weights = np.array([centre] + [weight] * 6)
    assert weights @ points == pytest.approx(mean, abs=1e-12)
    # The centre adds nothing: it lies on the mean.
    assert (points - mean).T @ np.diag(weights) @ (points - mean) == pytest.approx(covariance, abs=1e-12)


@pytest.mark.parametrize("filter_class", FILTERS)
def test_a_spread_that_loses_digits_is_refused(filter_class):
    with pytest.raises(InvalidParameter, match=r"alpha must be in \[0\.1, 2\], got 0\.001"):
        filter_class(np.zeros(1), np.eye(1), np.eye(1), np.eye(1), 1e-3)
