"""What a mounting adds to a channel is taken away, as far as a mounting can go."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.logs.mounting_leaks import (
    Leak,
    leaks_into_lean,
    leaks_into_push,
    leaks_into_turn,
    without_leaks,
)
from estimators.logs.signals import Windows

_T = np.arange(40.0)
_MOTION, _OTHER = np.sin(0.7 * _T), np.cos(1.9 * _T)


def test_a_multiple_that_a_mounting_can_have_is_taken_away_and_no_more():
    values = 3.0 * _MOTION + 0.2 * _OTHER
    kept = without_leaks(values, _MOTION, [Leak(_OTHER, 0.3)], centred=False)
    assert kept == pytest.approx(3.0 * _MOTION, abs=1e-6)
    too_much = without_leaks(3.0 * _MOTION + 0.5 * _OTHER, _MOTION, [Leak(_OTHER, 0.3)], centred=False)
    assert np.std(too_much - 3.0 * _MOTION) == pytest.approx(0.2 * np.std(_OTHER), rel=0.1)


def test_with_few_windows_nothing_is_taken_away():
    leak = Leak(np.where(_T < 9.0, _OTHER, math.nan), 1.0)
    assert without_leaks(_MOTION, _MOTION, [leak], centred=False) is None
    more = Leak(np.where(_T < 10.0, _OTHER, math.nan), 1.0)
    assert without_leaks(_MOTION, _MOTION, [more], centred=False) is not None


def test_a_constant_counts_for_nothing_where_a_channel_has_a_bias():
    kept = without_leaks(_MOTION + 0.1 * _OTHER + 5.0, _MOTION, [Leak(_OTHER, 0.2)], centred=True)
    assert kept == pytest.approx(_MOTION + 5.0, abs=1e-6)


@pytest.fixture(scope="module")
def windows() -> Windows:
    return Windows(simulated_log(draw_case(43, duration=30.0)))


def test_a_mounting_goes_no_further_than_a_description_can_have_it_wrong(windows):
    vehicle = windows.log.vehicle
    wheelbase = vehicle.l_f + vehicle.l_r
    turn, speed = windows.mean("yaw_rate"), windows.mean("omega_r") * vehicle.r
    antenna = leaks_into_turn(windows, ("course",), turn, speed)
    assert [leak.most for leak in antenna] == [1.5 * wheelbase]
    lever, *turned = leaks_into_turn(windows, ("a_y",), turn, speed)
    assert lever.most == 0.6 * wheelbase
    assert {leak.most for leak in turned} == {math.sin(0.2)}
    assert [leak.most for leak in leaks_into_push(windows, ("a_x",))[:2]] == [0.6 * wheelbase, 1.0]
    assert {leak.most for leak in leaks_into_lean(windows, "pitch_rate")} == {math.sin(0.2)}
    assert not leaks_into_turn(windows, ("steer",), turn, speed)  # it has no mounting
    assert not leaks_into_push(windows, ("torque_f",))


def test_gravity_leaks_into_an_accelerometer_that_feels_it(windows):
    felt = replace(
        windows.log, config=replace(windows.log.config, imu=replace(windows.log.imu, kinematic=False))
    )
    channels = {name: values for name, values in felt.channels.items() if name != "a_z"}
    felt = Windows(replace(felt, channels=channels))
    turn, speed = felt.mean("yaw_rate"), felt.mean("omega_r") * felt.log.vehicle.r
    without = Windows(replace(windows.log, channels=channels))
    counts = [len(leaks_into_turn(one, ("a_y",), turn, speed)) for one in (felt, without)]
    assert counts[0] == counts[1] + 1
