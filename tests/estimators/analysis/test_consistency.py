"""Consistency: chi-square bands, normalised errors, coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.analysis.consistency import chi_square_band, coverage, nees, nees_test, nis_test, surprise
from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.simulated_rows import row_model, simulate_row
from estimators.filters.joint_ukf import run_joint_filter
from estimators.models.half_car_on_map import JointSettings, prior
from offroad_env.errors import InvalidParameter


def test_band_is_that_of_the_chi_square_table():
    # chi-square with 5 degrees of freedom: 2.5 % below 0.831, 2.5 % above 12.833 (any table).
    band = chi_square_band(5, 1)
    assert band == pytest.approx((0.8312, 12.8325), abs=1e-4)
    assert band.holds(5.0)
    assert not band.holds(13.0)


def test_band_narrows_with_the_root_of_the_count():
    wide, narrow = chi_square_band(5, 400), chi_square_band(5, 40_000)
    assert (wide.high - wide.low) / (narrow.high - narrow.low) == pytest.approx(10.0, rel=1e-2)


def test_consistent_errors_pass_and_doubled_ones_fail():
    rng = np.random.default_rng(3)
    L = rng.normal(size=(4, 4))
    cov = L @ L.T
    errors = rng.multivariate_normal(np.zeros(4), cov, size=300)
    covs = np.broadcast_to(cov, (300, 4, 4))
    assert nees_test(errors, covs, 0.999).consistent
    assert not nees_test(1.3 * errors, covs, 0.999).consistent
    assert not nees_test(0.7 * errors, covs, 0.999).consistent


def test_nees_does_not_depend_on_units():
    rng = np.random.default_rng(4)
    cov = np.diag([1e-8, 1.0, 1e6]) + 1e-5 * np.outer([1e-4, 1.0, 1e3], [1e-4, 1.0, 1e3])
    errors = rng.multivariate_normal(np.zeros(3), cov, size=5)
    scale = np.array([1e3, 1.0, 1e-3])
    covs = np.broadcast_to(cov, (5, 3, 3))
    np.testing.assert_allclose(
        nees(errors, covs), nees(errors * scale, covs * np.outer(scale, scale)), rtol=1e-10
    )


def test_nis_leaves_out_what_was_not_measured():
    rng = np.random.default_rng(5)
    nis = rng.chisquare(5, size=2000)
    nis[::3] = math.nan
    result = nis_test(nis, 5, 0.999)
    assert result.updates == np.isfinite(nis).sum()
    assert result.consistent
    with pytest.raises(InvalidParameter, match="no update"):
        nis_test(np.full(3, math.nan), 5)


def test_coverage_counts_only_what_the_validity_flag_allows():
    low, high = np.array([0.0, 0.0, 0.6, 0.6]), np.ones(4)
    assert coverage(low, high, 0.5) == 0.5
    assert coverage(low, high, 0.5, np.array([True, True, True, False])) == pytest.approx(2 / 3)
    assert math.isnan(coverage(low, high, 0.5, np.zeros(4, bool)))


def test_wrong_arguments_are_refused():
    with pytest.raises(InvalidParameter, match="percent"):
        chi_square_band(5, 10, 95)
    with pytest.raises(InvalidParameter, match="covariances"):
        nees(np.zeros((3, 2)), np.zeros((3, 3)))


def test_surprise_is_zero_in_the_mean_and_of_unit_spread():
    rng = np.random.default_rng(6)
    calm = surprise(rng.chisquare(5, size=200_000), 5, 0.01, 2.0)[2000:]
    # An exponential mean over 2 s: 2,000 s hold some 500 independent values.
    assert calm.mean() == pytest.approx(0.0, abs=0.25)
    assert calm.std() == pytest.approx(1.0, abs=0.15)
    assert (np.abs(calm) < 6.0).all()


def test_surprise_sees_innovations_that_are_too_large_and_keeps_still_without_any():
    nis = np.full(1000, 5.0)
    nis[500:] = 8.0
    excess = surprise(nis, 5, 0.01, 2.0)
    assert (excess[:500] == 0.0).all()
    assert excess[-1] > 10.0
    nis[:] = math.nan
    assert (surprise(nis, 5, 0.01) == 0.0).all()


def test_errors_of_the_joint_filter_over_runs_are_as_large_as_it_says():
    """NEES of all eleven states after a second, with the truth drawn from the filter's own prior."""
    settings, row = JointSettings(), ROWS[2]
    model, errors, covariances = row_model(row, settings), [], []
    rng = np.random.default_rng(7)
    for seed in range(101, 125):
        twin = simulate_row(row, seed, settings, duration=1.0)
        start = prior(model, settings, float(rng.normal(0.5, 0.01)), 0.01, (0.0, 0.0, 0.0), 5.0)
        run = run_joint_filter(model, start, twin.inputs, twin.readings())
        errors.append(run.means[-1] - twin.truth[-1])
        covariances.append(run.covariances[-1])
    assert nees_test(np.array(errors), np.array(covariances), 0.999).consistent
    # And the test would notice a filter that is surer than it may be.
    assert not nees_test(np.array(errors), 0.5 * np.array(covariances), 0.999).consistent
