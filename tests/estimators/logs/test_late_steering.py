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


def weaving(drive, delay, share=1.0):
    """The log as if the vehicle wove about once a second, ``delay`` [s] after its steering.

    ``share`` of the yaw rate follows it; the rest has another frequency.
    """
    rng, t = np.random.default_rng(0), drive.times
    speed = np.full(len(t), 5.0)
    noise = 0.01 * rng.standard_normal((2, len(t)))
    made = {
        "steer": 0.2 * np.sin(6.0 * t) + noise[0],
        "yaw_rate": 0.35 * share * np.sin(6.0 * (t - delay))
        + 0.35 * (1.0 - share) * np.sin(9.0 * t)
        + noise[1],
        **{name: speed for name in ("speed", "v_x") if name in drive.channels},
    }
    known = {name: np.where(np.isnan(drive.channels[name]), np.nan, values) for name, values in made.items()}
    return replace(drive, channels={**drive.channels, **known})


@pytest.mark.parametrize(("delay", "late"), [(0.0, True), (0.45, True), (0.75, False)])
def test_a_vehicle_that_weaves_follows_its_steering_half_a_second_later_at_most(drive, delay, late):
    assert steers_late(weaving(drive, delay)) == late


@pytest.mark.parametrize(("share", "late"), [(0.35, False), (0.6, True)])
def test_what_follows_the_steering_must_be_most_of_the_yaw_rate(drive, share, late):
    """Correlations of 0.47 and 0.83."""
    assert steers_late(weaving(drive, 0.2, share)) == late


@pytest.mark.parametrize("kind", ["noise", "stuck", "stuck half", "sign"])
def test_a_steering_that_is_wrong_is_not_late(drive, kind):
    assert steers_late(drive)
    assert not steers_late(corrupted(drive, "steer", kind))


def test_without_a_speed_or_a_gyro_nothing_is_excused(drive):
    for gone in ("yaw_rate", "speed"):
        left = {name: values for name, values in drive.channels.items() if name not in (gone, "v_x")}
        assert not steers_late(replace(drive, channels=left))
