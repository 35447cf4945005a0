"""A steering that acts late is no wrong channel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs.corruptions import corrupted
from estimators.logs.late_steering import steers_late
from estimators.logs.signals import Windows


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


def late(log, kind="contradiction", spread=2.4):
    windows = Windows(log)
    return steers_late(windows, windows.mean("v_x" if "v_x" in log.channels else "speed"), kind, spread)


@pytest.mark.parametrize(("delay", "follows"), [(0.0, True), (0.45, True), (0.75, False)])
def test_a_vehicle_that_weaves_follows_its_steering_half_a_second_later_at_most(drive, delay, follows):
    assert late(weaving(drive, delay)) == follows


@pytest.mark.parametrize(("share", "follows"), [(0.35, False), (0.6, True)])
def test_what_follows_the_steering_must_be_most_of_the_yaw_rate(drive, share, follows):
    """Correlations of 0.47 and 0.83."""
    assert late(weaving(drive, 0.2, share)) == follows


@pytest.mark.parametrize("kind", ["noise", "stuck", "stuck half", "sign"])
def test_a_steering_that_is_wrong_is_not_late(drive, kind):
    assert late(drive)
    assert not late(corrupted(drive, "steer", kind))


def test_without_a_speed_or_a_gyro_nothing_is_excused(drive):
    windows = Windows(drive)
    left = {name: values for name, values in drive.channels.items() if name != "yaw_rate"}
    assert not late(replace(drive, channels=left))
    assert not steers_late(windows, None, "contradiction", 2.4)
    assert not steers_late(windows, np.full(len(windows.starts), np.nan), "contradiction", 2.4)


def slow(drive, lag, factor):
    """The log as if wheels followed a steering with a lag [s] that is stated ``factor`` times as large."""
    t, steer = drive.samples("steer")
    follow = (t[1] - t[0]) / (lag + t[1] - t[0])
    swerving = 0.1 * np.sin(3.0 * t)
    followed, _ = lfilter([follow], [1.0, follow - 1.0], swerving, zi=[0.0])
    at, yaw_rate = drive.samples("yaw_rate")
    wheelbase = drive.vehicle.l_f + drive.vehicle.l_r
    turned = 5.0 * np.tan(np.interp(at, t, followed)) / wheelbase
    changed = {"steer": (steer, factor * swerving), "yaw_rate": (yaw_rate, turned)}
    channels = dict(drive.channels)
    for name, (_old, values) in changed.items():
        channels[name] = np.array(channels[name])
        channels[name][~np.isnan(channels[name])] = values
    for name in ("speed", "v_x"):
        if name in channels:
            channels[name] = np.where(np.isnan(channels[name]), np.nan, 5.0)
    return replace(drive, channels=channels)


@pytest.mark.parametrize(
    ("lag", "factor", "follows"),
    [
        (0.4, 2.0, True),
        (0.9, 2.0, True),
        (2.0, 2.0, False),
        (0.0, 2.0, True),
        (0.4, 3.0, False),
        (0.0, 3.6, False),
        (0.4, 0.35, False),
    ],
)
def test_a_lag_explains_no_more_of_a_scale_than_it_takes_off(drive, lag, factor, follows):
    """Without it 0.4 s take 1.56 from the turns: 2.0 looks like 3.1, where vehicles differ by up to 2.4."""
    assert late(slow(drive, lag, factor), "scale") == follows


def test_only_a_scale_and_a_contradiction_are_excused(drive):
    assert not late(drive, "stuck")
    assert not late(drive, "sign")
