"""Intervals of trained policies: training seeds and episodes are drawn, pairs stay pairs."""

from __future__ import annotations

import numpy as np
import pytest

from agents.benchmark.learned import (
    improvement_interval,
    improvement_verdict,
    interquartile_interval,
    ratio_interval,
)

RNG = np.random.default_rng(0)
COURSES = RNG.normal(50.0, 10.0, 80)


def test_trainings_that_differ_widen_the_interval_more_than_their_episodes_do():
    alike = np.tile(COURSES, (4, 1))
    apart = alike + np.array([[-20.0], [-5.0], [5.0], [20.0]])
    close, wide = interquartile_interval(alike), interquartile_interval(apart)
    assert close.low < close.value < close.high
    assert wide.high - wide.low > 3.0 * (close.high - close.low)


def test_the_interquartile_mean_leaves_out_a_quarter_of_failures():
    scores = COURSES[None].copy()
    scores[0, :8] = 1e6
    assert interquartile_interval(scores).value < 60.0


def test_a_policy_that_is_always_a_little_faster_beats_the_arm_on_courses_that_differ_widely():
    faster = np.tile(COURSES - 0.1, (2, 1))
    assert improvement_interval(faster, COURSES).low == 1.0
    ratio = ratio_interval(faster, COURSES)
    assert ratio.high < 1.0
    assert ratio.value == pytest.approx(1.0 - 0.1 / COURSES.mean())


def test_trainings_of_two_arms_are_compared_each_with_each():
    """One of two trainings is better than both of the other arm, one worse than both: a half."""
    own = np.stack([COURSES - 5.0, COURSES + 5.0])
    other = np.stack([COURSES - 1.0, COURSES + 1.0])
    share = improvement_interval(own, other)
    assert share.value == 0.5
    assert (share.low, share.high) == (0.0, 1.0)
    # Against the mean of the other's trainings, one that is better than one of two would count as better.
    assert improvement_interval(COURSES[None] + 0.5, other).value == 0.5


def test_soils_that_all_trainings_share_do_not_average_out_over_them():
    alone = interquartile_interval(COURSES[None])
    many = interquartile_interval(np.tile(COURSES, (10, 1)))
    assert many.high - many.low == pytest.approx(alone.high - alone.low, rel=0.15)


def test_the_interval_of_a_policy_covers_a_coin_that_is_fair():
    inside = 0
    for _ in range(8):
        scores = RNG.normal(size=(1, 60))
        share = improvement_interval(scores, np.zeros(60))
        inside += share.low <= 0.5 <= share.high
    assert inside >= 6


@pytest.mark.parametrize(
    ("shift", "words"), [(-30.0, "beats"), (30.0, "is beaten by"), (0.0, "do not differ")]
)
def test_the_sentence_follows_the_interval_whichever_way_it_falls(shift, words):
    other = COURSES + RNG.normal(0.0, 1.0, COURSES.size)
    verdict = improvement_verdict("a", "b", improvement_interval((COURSES + shift)[None], other))
    assert words in verdict
