"""Intervals that cover what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest

from agents.benchmark.learned import seed_interval
from agents.benchmark.statistics import (
    effect_size,
    headroom,
    interquartile_mean,
    mean_interval,
    paired_difference,
    probability_of_improvement,
    recovered_share,
    wilson_interval,
)
from offroad_env.errors import InvalidParameter


@pytest.mark.peer
@pytest.mark.parametrize(("k", "n"), [(0, 30), (13, 30), (30, 30)])
def test_wilson_agrees_with_scipy(k, n):
    ours, theirs = wilson_interval(k, n), binomtest(k, n).proportion_ci(method="wilson")
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)
    assert ours.value == k / n


def test_one_training_has_no_interval_and_two_have_one():
    assert f"{seed_interval([44.512]):.1f}" == "44.5 (one sample: no interval)"
    assert f"{seed_interval([1.0, 2.0]):.1f}" == "1.5 [-4.9, 7.9]"


def test_the_bootstrap_covers_a_skewed_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(4)
    hits = 0
    for trial in range(60):
        interval = mean_interval(rng.exponential(1.0, 30), seed=trial)
        hits += interval.low <= 1.0 <= interval.high
    # 95 % nominal; 60 trials of a skewed law with 30 samples: 5 sigma below 0.93.
    assert hits >= 46


def test_pairing_removes_what_the_episodes_share():
    rng = np.random.default_rng(0)
    course, noise = rng.normal(50.0, 10.0, 40), rng.normal(0.0, 0.5, 40)
    difference = paired_difference(course + noise, course + 2.0)
    assert difference.high < -1.5
    assert difference.high - difference.low < 0.5


def test_equal_samples_have_an_interval_without_width():
    same = np.full(10, 3.0)
    assert mean_interval(same).low == mean_interval(same).high == 3.0
    shifted = paired_difference(np.arange(10.0) + 1.0, np.arange(10.0))
    assert (shifted.low, shifted.value, shifted.high) == (1.0, 1.0, 1.0)


def test_the_headroom_is_measured_against_the_best_of_the_uninformed():
    rng = np.random.default_rng(1)
    base = rng.normal(50.0, 5.0, 40)
    room = headroom(base - 3.0, (base, base + 4.0))
    assert room.value == pytest.approx(3.0)
    # Two equal arms: the minimum takes the luck of the draw into account.
    twins = headroom(base, (base + rng.normal(0, 3.0, 40), base + rng.normal(0, 3.0, 40)))
    assert twins.low < 0.0


def test_the_interquartile_mean_ignores_the_tails():
    assert interquartile_mean(np.array([-1e9, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1e9])) == pytest.approx(3.5)


def test_a_tie_counts_half_for_each():
    a, b = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 2.0, 2.0, 5.0])
    assert probability_of_improvement(a, b).value == pytest.approx(0.625)
    assert probability_of_improvement(b, a).value == pytest.approx(0.375)


@pytest.mark.parametrize(
    ("samples", "message"),
    [((np.zeros(3), np.zeros(4)), "one shape"), ((np.zeros(1), np.zeros(1)), ">= 2")],
)
def test_samples_that_are_no_pairs_are_refused(samples, message):
    with pytest.raises(InvalidParameter, match=message):
        paired_difference(*samples)


def test_a_missing_score_is_refused():
    with pytest.raises(InvalidParameter, match="finite"):
        mean_interval(np.array([1.0, np.nan]))


def test_the_headroom_keeps_episodes_together():
    """Episodes differ by ten seconds, arms on the same one by a tenth: the interval is that of the latter."""
    rng = np.random.default_rng(7)
    course = rng.normal(60.0, 10.0, 100)
    oracle, nominal = (course + shift + rng.normal(0.0, 0.1, 100) for shift in (0.0, 1.0))
    found = headroom(oracle, (nominal,))
    assert found.high - found.low < 0.1
    assert found.low < 1.0 < found.high


def test_the_effect_size_is_the_mean_difference_over_its_standard_deviation():
    assert effect_size(np.array([3.0, 5.0]), np.array([1.0, 1.0])) == pytest.approx(3.0 / np.sqrt(2.0))
    assert effect_size(np.array([2.0, 2.0]), np.array([1.0, 1.0])) == 0.0


def test_the_recovered_share_is_measured_from_the_best_of_the_uninformed():
    base = np.random.default_rng(8).normal(60.0, 5.0, 50)
    found = recovered_share(base - 3.0, base - 4.0, (base, base + 6.0))
    assert found.value == pytest.approx(0.75)
    assert (found.low, found.high) == pytest.approx((0.75, 0.75))


def test_a_lower_level_has_a_narrower_interval():
    values = np.random.default_rng(9).normal(0.0, 1.0, 200)
    wide, narrow = (mean_interval(values, level=level) for level in (0.95, 0.5))
    half = 1.96 * values.std(ddof=1) / np.sqrt(200)
    assert wide.high - wide.low == pytest.approx(2.0 * half, rel=0.08)
    assert narrow.high - narrow.low == pytest.approx(2.0 * half * 0.6745 / 1.96, rel=0.1)
