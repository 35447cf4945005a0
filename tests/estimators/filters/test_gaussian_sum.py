"""A Gaussian sum: what merging keeps, what its moments and quantiles are, when two peaks are two modes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from estimators.filters.gaussian_sum import (
    check_fan,
    exponent_fan,
    merge_components,
    mixture_moments,
    mixture_quantile,
    mode_weights,
    normalise,
    weigh,
)
from estimators.numerics.bounded import to_range
from offroad_env.errors import InvalidParameter

LOW, HIGH = 0.2, 1.4


def _sum(rng, K=5):
    log_weights = rng.normal(size=K)
    normalise(log_weights)
    return log_weights, rng.normal(size=K), rng.uniform(0.01, 0.2, K)


def test_merging_keeps_weight_mean_and_covariance_of_the_pair():
    rng = np.random.default_rng(0)
    log_weights, means = np.log([0.3, 0.1, 0.6]), rng.normal(size=(3, 4))
    roots = rng.normal(size=(3, 4, 4))
    covs = roots @ roots.transpose(0, 2, 1)
    w = np.exp(log_weights[:2]) / 0.4
    mean = w @ means[:2]
    apart = means[:2] - mean
    spread = np.einsum("k,kij->ij", w, covs[:2] + apart[:, :, None] * apart[:, None, :])
    merge_components(log_weights, means, covs, 0, 1)
    assert math.exp(log_weights[0]) == pytest.approx(0.4)
    assert log_weights[1] == -math.inf
    np.testing.assert_allclose(means[0], mean)
    np.testing.assert_allclose(covs[0], spread)


def test_a_free_place_counts_for_nothing():
    log_weights, etas, variances = _sum(np.random.default_rng(1))
    free = (np.append(log_weights, -math.inf), np.append(etas, 9.0), np.append(variances, 9.0))
    assert mixture_moments(*free, LOW, HIGH) == mixture_moments(log_weights, etas, variances, LOW, HIGH)
    quantile = mixture_quantile(log_weights, etas, variances, 0.2)
    assert mixture_quantile(*free, 0.2) == quantile


def test_moments_are_those_of_drawn_numbers():
    rng = np.random.default_rng(2)
    log_weights, etas, variances = _sum(rng)
    which = rng.choice(len(etas), size=200_000, p=np.exp(log_weights))
    drawn = etas[which] + np.sqrt(variances[which]) * rng.normal(size=len(which))
    n = np.array([to_range(eta, LOW, HIGH) for eta in drawn])
    mean, sd = mixture_moments(log_weights, etas, variances, LOW, HIGH)
    # Five standard errors of 200 000 draws.
    assert mean == pytest.approx(n.mean(), abs=5.0 * n.std() / math.sqrt(len(n)))
    assert sd == pytest.approx(n.std(), rel=0.01)


@pytest.mark.parametrize("probability", [0.025, 0.5, 0.975])
def test_a_quantile_leaves_its_share_below(probability):
    log_weights, etas, variances = _sum(np.random.default_rng(3))
    eta = mixture_quantile(log_weights, etas, variances, probability)
    below = np.exp(log_weights) @ norm.cdf(eta, etas, np.sqrt(variances))
    assert below == pytest.approx(probability, abs=1e-9)


@pytest.mark.parametrize(("gap", "largest"), [(0.5, 1.0), (0.7, 0.6)])
def test_components_that_do_not_overlap_are_two_modes(gap, largest):
    # Three standard deviations of 0.1 on each side reach 0.6 in all.
    log_weights, etas, variances = np.log([0.6, 0.4]), np.array([0.0, gap]), np.full(2, 0.01)
    modes = np.empty(2, np.int64)
    assert mode_weights(log_weights, etas, variances, modes) == pytest.approx(largest)
    assert (modes[0] == modes[1]) == (largest == 1.0)


def test_a_sample_that_no_component_explains_leaves_the_weights():
    before = np.log([0.7, 0.3])
    log_weights = np.full(2, -math.inf)
    weigh(log_weights, before)
    np.testing.assert_array_equal(log_weights, before)


def test_a_fan_beyond_the_range_is_refused():
    with pytest.raises(InvalidParameter, match=r"n_fan must lie inside n_range = \(0.2, 1.4\)"):
        check_fan((0.1, 1.0), (LOW, HIGH))


def test_a_fan_is_flat_between_its_ends():
    fan = exponent_fan((0.4, 1.2), 16, 0.6, (0.8, 1e6), (LOW, HIGH))
    log_weights = fan.log_prior.copy()
    normalise(log_weights)
    edges = [mixture_quantile(log_weights, fan.etas, fan.variances, p) for p in (0.25, 0.5, 0.75)]
    n = [to_range(eta, LOW, HIGH) for eta in edges]
    assert n == pytest.approx([0.6, 0.8, 1.0], abs=0.005)
