"""Every channel is compared with all others that physics ties to it."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.combined import combined
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.faults.other_forms import OTHER_FORMS
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import Verdict
from estimators.logs import agreement, quality, read_log
from estimators.logs.channel_checks import OUTSIDE
from estimators.logs.corruptions import CORRUPTIONS, corrupted, corruptible
from estimators.logs.log import Log
from offroad_env.simulation.drive import Faults
from tests.helpers import measured_data


@pytest.fixture(scope="module")
def drive() -> Log:
    """30 s on flat ground with bends and braking."""
    return simulated_log(draw_case(43, duration=30.0))


def _named(log: Log) -> set[str]:
    return {finding.channel for finding in quality(log).problems}


#: What the drive cannot show: nothing else measures the vertical motion, and a steering or a pitch of a few
#: times its size is within what soil or road does.
_UNDECIDABLE = {("a_z", "x3.6"), ("a_z", "sign"), ("a_z", "noise"), ("pitch_rate", "noise"), ("a_x", "x3.6")}


def test_nearly_every_damage_to_one_channel_is_named(drive):
    cases = [(channel, kind) for channel in corruptible(drive) for kind in CORRUPTIONS]
    # A third of all cases, so that every channel and every kind has its turn.
    missed = {case for case in cases[::3] if case[0] not in _named(corrupted(drive, *case))}
    assert missed <= _UNDECIDABLE


def test_a_sound_drive_has_no_problem_and_says_what_could_not_be_checked(drive):
    report = quality(drive)
    assert not report.problems
    assert {f.channel for f in report.findings if f.kind == "unchecked"} == {"a_z"}


@pytest.mark.parametrize(
    ("fault", "size"), [("cg_shift", 0.5), ("rolling_resistance", 0.1), ("steer_gain", 0.5)]
)
def test_a_wrong_model_is_no_problem_of_the_data(fault, size):
    assert not quality(simulated_log(draw_case(107, duration=30.0), FAULTS[fault](size))).problems


@pytest.mark.parametrize(
    ("seed", "gnss", "fault", "size"),
    [
        (140, None, "antenna_x", 2.72),  # its course turns 2.4 times as much as the vehicle
        (105, True, "antenna_x", -2.72),  # its path is mostly what the vehicle turns it aside
        (236, None, "imu_misalignment_roll", 0.1),  # its pitch gyro reads the yaw rate
    ],
)
def test_a_sensor_that_is_mounted_otherwise_is_no_problem_of_the_data(seed, gnss, fault, size):
    log = simulated_log(draw_case(seed, duration=30.0, gnss=gnss), FAULTS[fault](size))
    assert not quality(log).problems


@pytest.mark.parametrize(
    ("seed", "fault", "size"), [(1018, "slip_exponent", -1.0), (1005, "torque_scale", -0.3)]
)
def test_a_vehicle_that_digs_in_or_drives_at_full_throttle_is_no_problem_of_the_data(seed, fault, size):
    assert not quality(simulated_log(draw_case(seed, duration=30.0), FAULTS[fault](size))).problems


def test_a_torque_that_never_comes_back_from_full_throttle_is_stuck(drive):
    t, values = drive.times, drive.channels["torque_f"]
    held = np.where(t > 15.0, np.nanmax(values), values)
    assert "torque_f" in _named(replace(drive, channels={**drive.channels, "torque_f": held}))


def test_a_mounting_excuses_no_wrong_unit():
    log = simulated_log(draw_case(43, duration=30.0), FAULTS["imu_misalignment_roll"](0.1))
    for channel in ("yaw_rate", "a_y", "pitch_rate"):
        assert channel in _named(corrupted(log, channel, "x57.3"))
        assert channel in _named(corrupted(log, channel, "sign"))


def test_wheels_that_spin_up_are_no_problem_of_the_data():
    folder = measured_data("scm_drives")
    assert not quality(read_log(folder / "train_29_steps_flat_steps.parquet")).problems


def test_a_wheel_that_locks_under_its_brake_shows_no_speed():
    """And one that is as slow while it is driven is noise, or another quantity."""
    log = simulated_log(draw_case(43, gnss=True, duration=30.0))
    braked = log.times % 6.0 > 3.0
    slow = np.where(braked, 0.15, 1.3) * log.channels["omega_f"]
    locked = {"omega_f": slow, "torque_f": np.where(braked, -900.0, log.channels["torque_f"])}
    assert "omega_f" not in _named(replace(log, channels={**log.channels, **locked}))
    driven = {"omega_f": slow, "torque_f": np.abs(log.channels["torque_f"])}
    assert "omega_f" in _named(replace(log, channels={**log.channels, **driven}))


def test_front_wheels_that_slide_on_soft_soil_are_no_wrong_steering(monkeypatch):
    log = simulated_log(draw_case(43, gnss=True, duration=30.0))
    v = np.interp(log.times, *log.samples("speed"))
    turn = np.convolve(np.interp(log.times, *log.samples("yaw_rate")), np.full(25, 0.04), "same")
    pure = np.arctan((log.vehicle.l_f + log.vehicle.l_r) * turn / v)

    def blamed(slide):
        steer = np.where(np.isnan(log.channels["steer"]), np.nan, 2.0 * pure + slide * turn * v)
        return "steer" in _named(replace(log, channels={**log.channels, "steer": steer}))

    assert not blamed(0.11)
    assert blamed(0.22)
    monkeypatch.setattr(agreement, "_SLIDE", 0.06)
    assert blamed(0.11)


def test_where_one_channel_is_wrong_only_that_one_is_blamed(drive):
    for channel in ("yaw_rate", "course", "a_x", "omega_r"):
        assert _named(corrupted(drive, channel, "sign")) == {channel}


def test_a_vehicle_that_turns_without_steering_is_outside_the_model(drive):
    straight = replace(drive, channels={**drive.channels, "steer": np.zeros(len(drive))})
    found = diagnose([straight])
    assert found.verdict is Verdict.OUTSIDE
    assert found.search is None  # nothing was fitted
    assert "skid steer" in summarise(found).sentence
    assert {finding.kind for finding in found.findings} == {OUTSIDE}


def test_a_stuck_speed_gets_no_verdict(drive):
    found = diagnose([corrupted(drive, "speed", "stuck")])
    assert found.verdict is Verdict.DATA_PROBLEM
    assert found.findings[0].channel == "speed"


@pytest.mark.parametrize(("factor", "problem"), [(2.6, False), (3.5, True)])
def test_an_axle_that_is_driven_at_a_slip_of_two_thirds_is_no_other_unit(drive, factor, problem):
    log = replace(drive, channels={**drive.channels, "omega_f": factor * drive.channels["omega_f"]})
    assert ("omega_f" in _named(log)) == problem


@pytest.mark.parametrize(
    ("steered", "spun", "problem"),
    [
        (4.0, 1.0, True), (4.0, 1.6, False), (4.0, 1.1, True), (8.0, 1.6, True),
        (0.25, 1.0, True), (0.25, 1.6, False), (0.25, 1.1, True), (0.12, 1.6, True),
    ],
)  # fmt: skip
def test_front_wheels_that_spin_turn_a_vehicle_less_or_more_than_they_are_steered(
    drive, steered, spun, problem
):
    factors = {"steer": steered, "omega_f": spun}
    changed = {name: factor * drive.channels[name] for name, factor in factors.items()}
    assert ("steer" in _named(replace(drive, channels={**drive.channels, **changed}))) == problem


@pytest.mark.parametrize(
    ("seed", "causes"),
    [
        (24009, {"rut_drag": 27_000.0}),  # its front wheels spin until it digs in
        (24012, {"rolling_resistance": 0.2}),  # they spin all the time: the rear ones tell its speed
        (30000, {"rolling_resistance": 0.18, "steer_gain": 0.46}),  # the less torque, the less they do
    ],
)
def test_front_wheels_that_spin_are_no_wrong_unit_where_no_receiver_shows_the_speed(seed, causes):
    log = _natural(seed, combined([OTHER_FORMS[name](size) for name, size in causes.items()]))
    assert "speed" not in log.channels
    assert not quality(log).problems


def test_a_steering_that_lags_and_has_another_gain_is_no_wrong_unit():
    """Means over a second have it 2.6 times as large as the turns; the lag takes a third of them."""
    log = _natural(30007, combined([FAULTS["steer_gain"](-0.42), OTHER_FORMS["steer_lag"](0.37)]))
    assert not quality(log).problems
    assert "steer" in _named(corrupted(log, "steer", "x57.3"))


@pytest.mark.parametrize(
    ("angle", "share", "problem"), [(1.6, 0.03, True), (1.6, 0.01, False), (1.4, 1.0, False)]
)
def test_no_wheel_is_steered_so_far(drive, angle, share, problem):
    t = drive.samples("steer")[0]
    channels = {name: drive.channels[name] for name in ("omega_f", "omega_r", "a_x")}
    channels["steer"] = np.where(np.isnan(drive.channels["steer"]), np.nan, 0.0)
    channels["steer"][np.searchsorted(drive.times, t[: int(share * len(t))])] = angle
    assert ("steer" in _named(replace(drive, channels=channels))) == problem


def _natural(seed: int, world: Faults) -> Log:
    return simulated_log(draw_case(seed, road="unknown", natural=True), world)
