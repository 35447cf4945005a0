"""What the channels say about n, and where they are silent."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.experiments.buzhardt_tallapragada import ROWS
from estimators.experiments.imu_sensitivity import channel_distance, force_curve, information_rate
from estimators.models.imu_prediction import CHANNELS

LEVEL = ROWS[1]._replace(H0=0.0)
VERTICAL = [CHANNELS.index("a_z"), CHANNELS.index("pitch_rate")]


@pytest.fixture(scope="module")
def clay():
    return force_curve("clay")


def test_clay_pulls_alike_at_three_exponents_with_two_turning_points_between(clay):
    assert len(clay.roots) == 3
    assert any(root == pytest.approx(0.5, abs=1e-6) for root in clay.roots)
    below, above = clay.turning_points
    assert clay.roots[0] < below < clay.roots[1] < above < clay.roots[2]
    # The paper's first guess lies next to a false root: that is why its filters stay there.
    assert clay.roots[2] == pytest.approx(1.0, abs=0.02)


def test_at_a_root_the_longitudinal_channel_cannot_tell_the_soils_apart(clay):
    false = clay.roots[2]
    at_root, beside = channel_distance(LEVEL, np.array([false, false + 0.1]))
    assert at_root[0] < 1e-3  # the tolerance of the contact solve and of the spline
    assert beside[0] > 0.1


def test_straight_on_level_ground_only_the_longitudinal_channel_speaks():
    rate = information_rate(LEVEL, np.array([0.6]))[0]
    assert rate[0] > 100.0
    assert rate[1:].max() < 1e-9 * rate[0]


def test_information_is_lost_at_the_turning_points_unless_the_ground_is_rough(clay):
    turn, beside = clay.turning_points[1], clay.turning_points[1] - 0.15
    level = information_rate(LEVEL, np.array([turn, beside])).sum(axis=1)
    rough = information_rate(ROWS[0], np.array([turn]))[0]
    assert level[0] < 0.01 * level[1]
    assert rough.sum() > 10.0 * level[0]
    assert rough[VERTICAL].sum() > 0.5 * rough.sum()


def test_steering_tells_more_than_straight_driving():
    straight, steered = (information_rate(row, np.array([0.5]))[0].sum() for row in (ROWS[0], ROWS[2]))
    assert steered > 10.0 * straight
