"""A steering that acts late is no wrong channel."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs.corruptions import corrupted
from estimators.logs.late_steering import steers_late


@pytest.fixture(scope="module")
def drive():
    return simulated_log(draw_case(43, duration=30.0))


def weaving(drive, delay):
    """The log as if the vehicle wove about once a second, ``delay`` [s] after its steering."""
    rng, t = np.random.default_rng(0), drive.times
    speed = np.full(len(t), 5.0)
    noise = 0.01 * rng.standard_normal((2, len(t)))
    made = {
        "steer": 0.2 * np.sin(6.0 * t) + noise[0],
        "yaw_rate": 0.35 * np.sin(6.0 * (t - delay)) + noise[1],
        **{name: speed for name in ("speed", "v_x") if name in drive.channels},
    }
    known = {name: np.where(np.isnan(drive.channels[name]), np.nan, values) for name, values in made.items()}
    return replace(drive, channels={**drive.channels, **known})


@pytest.mark.parametrize(("delay", "late"), [(0.0, True), (0.3, True), (0.75, False)])
def test_a_vehicle_that_weaves_follows_its_steering_half_a_second_later_at_most(drive, delay, late):
    assert steers_late(weaving(drive, delay)) == late


@pytest.mark.parametrize("kind", ["noise", "stuck", "stuck half", "sign"])
def test_a_steering_that_is_wrong_is_not_late(drive, kind):
    assert steers_late(drive)
    assert not steers_late(corrupted(drive, "steer", kind))


def test_without_a_speed_or_a_gyro_nothing_is_excused(drive):
    for gone in ("yaw_rate", "speed"):
        left = {name: values for name, values in drive.channels.items() if name not in (gone, "v_x")}
        assert not steers_late(replace(drive, channels=left))
