"""The tests that filters make on themselves: calm where their model is right, loud where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.filters.change_test import WINDOW, add_update, has_changed
from estimators.filters.innovation_test import (
    chi_square_excess,
    fading_share,
    mean_innovation_test,
    nis_excess,
)

DT, TIME = 0.01, 1.0
STEPS = 20_000


def _chi_squares(offset):
    rng, mean, share = np.random.default_rng(0), np.zeros(3), fading_share(DT, TIME)
    variance = np.full(3, DT / (2.0 * TIME))
    values = [mean_innovation_test(mean, offset + rng.normal(size=3), variance, share) for _ in range(STEPS)]
    return np.array(values[1000:])


def test_the_mean_of_white_innovations_is_chi_square():
    values = _chi_squares(0.0)
    # 190 independent windows of three degrees of freedom: the mean is 3 +- 0.18.
    assert values.mean() == pytest.approx(3.0, abs=0.6)
    assert np.mean(values > 25.0) < 1e-3


def test_innovations_with_a_mean_are_found():
    assert np.median(_chi_squares(0.5)) > 25.0


def test_an_excess_counts_in_standard_deviations_of_a_chi_square():
    values = np.random.default_rng(1).chisquare(5, size=50_000)
    for excess in (nis_excess, chi_square_excess):
        scores = np.array([excess(value, 5.0) for value in values])
        assert (scores.mean(), scores.std()) == pytest.approx((0.0, 1.0), abs=0.03)


def _alarms(shifts, variance):
    window, found = np.zeros(WINDOW), 0
    for shift in shifts:
        add_update(window, shift, variance, TIME, DT)
        found += has_changed(window, TIME, 6.0)
    return found


def test_white_updates_are_no_change():
    rng = np.random.default_rng(2)
    assert _alarms(0.01 * rng.normal(size=STEPS), 1e-4) == 0


def test_updates_to_one_side_are_a_change():
    rng = np.random.default_rng(3)
    # Over a window of 100 samples: a sum of 0.7, of a standard deviation of 0.07.
    assert _alarms(0.007 + 0.01 * rng.normal(size=300), 1e-4) > 50


def test_a_window_that_has_just_been_opened_gives_no_alarm():
    assert _alarms(np.full(90, 1.0), 1e-4) == 0
