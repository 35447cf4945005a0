"""A bounded parameter as an unbounded one."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.numerics.bounded import belief_of, from_range, interval, moments, range_slope, to_range
from offroad_env.errors import InvalidParameter

LOW, HIGH = 0.3, 1.1


@pytest.mark.parametrize("n", [0.3001, 0.5, 0.7, 1.0999])
def test_there_and_back_again(n):
    assert to_range(from_range(n, LOW, HIGH), LOW, HIGH) == pytest.approx(n, abs=1e-14)


def test_every_real_number_is_a_value_inside_the_range():
    n = [to_range(eta, LOW, HIGH) for eta in np.linspace(-1e3, 1e3, 101)]
    assert min(n) >= LOW
    assert max(n) <= HIGH
    assert np.all(np.diff(n) >= 0.0)


@pytest.mark.parametrize("eta", [-3.0, 0.0, 1.5])
def test_slope_is_the_derivative(eta):
    step = 1e-6
    difference = (to_range(eta + step, LOW, HIGH) - to_range(eta - step, LOW, HIGH)) / (2.0 * step)
    assert range_slope(eta, LOW, HIGH) == pytest.approx(difference, rel=1e-8)


@pytest.mark.parametrize(("eta", "sd"), [(0.0, 0.3), (2.0, 0.8), (-1.0, 1.5)])
def test_moments_are_those_of_the_distribution(eta, sd):
    samples = LOW + (HIGH - LOW) / (1.0 + np.exp(-np.random.default_rng(0).normal(eta, sd, 400_000)))
    mean, spread = moments(eta, sd**2, LOW, HIGH)
    # Four standard errors of the sample mean, the same for the standard deviation.
    assert mean == pytest.approx(samples.mean(), abs=4.0 * samples.std() / np.sqrt(samples.size))
    assert spread == pytest.approx(samples.std(), rel=0.01)


@pytest.mark.parametrize(("mean", "sd"), [(0.7, 0.2), (0.35, 0.03), (1.05, 0.002), (0.5, 0.15)])
def test_a_belief_has_the_moments_that_were_asked_for(mean, sd):
    eta, variance = belief_of(mean, sd, LOW, HIGH)
    assert moments(eta, variance, LOW, HIGH) == pytest.approx((mean, sd), rel=1e-9)


@pytest.mark.parametrize(("mean", "sd", "message"), [(1.2, 0.1, "mean"), (0.7, 0.0, "sd"), (0.7, 0.4, "sd")])
def test_a_belief_that_cannot_be_is_refused(mean, sd, message):
    with pytest.raises(InvalidParameter, match=f"{message} must be in"):
        belief_of(mean, sd, LOW, HIGH)


def test_the_interval_holds_its_share_and_stays_inside():
    eta, sd = 2.5, 1.0
    low, high = interval(eta, sd**2, LOW, HIGH)
    samples = to_range_array(np.random.default_rng(1).normal(eta, sd, 100_000))
    assert LOW < low < high < HIGH
    assert np.mean((samples > low) & (samples < high)) == pytest.approx(0.95, abs=0.003)


def to_range_array(eta):
    return LOW + (HIGH - LOW) / (1.0 + np.exp(-eta))
