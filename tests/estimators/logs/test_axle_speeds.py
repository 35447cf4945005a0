"""Two axles whose wheels spin or lock."""

import math

import numpy as np
import pytest

from estimators.logs.axle_speeds import always_off, spins_less


@pytest.mark.parametrize(
    ("ratio", "off"),
    [
        (np.full(20, 3.6), True),
        (np.full(20, 2.8), False),  # a light axle spins as much
        (np.linspace(3.2, 9.0, 20), False),  # one scale has one ratio
        (np.linspace(25.0, 90.0, 20), True),  # and no wheel spins so fast
        (np.full(20, 0.3), True),
        (np.array([math.nan] * 5), False),
        (np.append(np.full(20, 3.6), math.nan), True),
    ],
)
def test_a_scale_is_one_ratio_that_no_wheel_spins_with(ratio, off):
    assert always_off(ratio, 1.9) is off


def test_the_axle_that_spins_or_locks_less_is_nearer_to_the_vehicle():
    front, rear = np.array([6.0, 6.0, -6.0, -6.0]), np.array([2.0, 2.0, -2.0, -2.0])
    torque, direction = np.array([900.0, -900.0, -900.0, 900.0]), np.array([1.0, 1.0, -1.0, -1.0])
    expected = [2.0, 6.0, -2.0, -6.0]
    assert spins_less(front, rear, [torque, None], direction).tolist() == expected
    assert spins_less(rear, front, [torque], direction).tolist() == expected


def test_without_torques_the_slower_axle_counts_and_an_axle_that_shows_nothing_does_not():
    front, rear = np.array([6.0, math.nan, 6.0]), np.array([2.0, 2.0, math.nan])
    assert spins_less(front, rear, [None], np.ones(3)).tolist() == [2.0, 2.0, 6.0]
