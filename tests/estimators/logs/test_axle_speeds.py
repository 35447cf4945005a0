"""Two axles whose wheels spin or lock."""

import math

import numpy as np
import pytest

from estimators.logs.axle_speeds import always_off, rolls_undriven, spins_less


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


#: Torque from a fifth of the full one to all of it, and the ratio of an axle that its slip takes ahead.
_TORQUE = np.tile(np.linspace(360.0, 1800.0, 20), 2)
_SLIP = 1.0 / (1.0 - 0.7 * _TORQUE / 1800.0)
#: A torque that hardly varies, and another unit whose noise grows with it by chance.
_STEADY = np.linspace(1700.0, 1800.0, 40)
_NOISY = 3.6 * np.exp(np.tile([-0.3, 0.3], 20) + 0.004 * (_STEADY - 1750.0))


@pytest.mark.parametrize(
    ("ratio", "torque", "slips"),
    [
        (_SLIP, _TORQUE, True),  # never within a third of the other, yet no scale
        (1.3 * _SLIP, _TORQUE, True),  # a smaller tyre beside
        (2.0 * _SLIP, _TORQUE, False),
        (3.6 * _SLIP, _TORQUE, False),  # slip beside another unit
        (3.6 * _SLIP**0.1, _TORQUE, False),
        (np.full(40, 3.6), _TORQUE, False),
        (_SLIP, np.full(40, 900.0), False),  # the torque tells nothing
        (_SLIP, _TORQUE[::-1], False),  # less of it with more torque is no slip
        (_NOISY, _STEADY, False),
        (_SLIP, np.where(_TORQUE > 1700.0, math.nan, _TORQUE), False),
        (_SLIP, None, False),
    ],
)
def test_an_axle_is_ahead_by_its_slip_where_it_rolls_without_torque(ratio, torque, slips):
    rear = np.where(np.arange(40) < 20, 2.0, -2.0)
    front = ratio * rear
    assert rolls_undriven(front, rear, [torque, None, None]) is slips
    assert rolls_undriven(rear, front, [None, torque, None]) is slips
    assert rolls_undriven(front, rear, [None, None, torque]) is slips


def test_few_windows_do_not_tell_slip_from_a_scale():
    front, rear = _SLIP[10:20].copy(), np.ones(10)
    assert rolls_undriven(front, rear, [_TORQUE[10:20], None, None])
    front[0] = math.nan
    assert not rolls_undriven(front, rear, [_TORQUE[10:20], None, None])
