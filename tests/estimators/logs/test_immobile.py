"""A vehicle that gets stuck: it stands though its wheels are driven, which is no error of the data."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.data_quality import unusable
from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.discrepancy.model.run_model import RunModel
from estimators.discrepancy.verdict import Verdict
from estimators.discrepancy.wording import verdict_sentence
from estimators.logs.corruptions import corrupted
from estimators.logs.immobile import driven_time, has_rolled, only_spins, stuck_spans
from estimators.logs.immobile_findings import hardly_driven, stuck_findings
from estimators.logs.quality import quality
from estimators.logs.units import Finding


@pytest.fixture(scope="module")
def driven():
    return simulated_log(draw_case(102, road="unknown", natural=True, duration=20.0))


@pytest.fixture(scope="module")
def stuck():
    """Ruts hold the rear wheels from the first seconds on."""
    case = draw_case(102, road="unknown", natural=True, duration=20.0)
    return simulated_log(case, FAULTS["rut_drag"](27e3))


def with_channels(log, **channels):
    return replace(log, channels={**log.channels, **channels})


def stopped(log, start):
    """The log as if the vehicle stood from ``start`` [s] on, its front wheels spinning."""
    gone, rng = log.times >= start, np.random.default_rng(1)
    stands = {"omega_f": 20.0, "omega_r": 0.0, "speed": 0.0, "v_x": 0.0}
    changed = {}
    for name, values in log.channels.items():
        known = ~np.isnan(values)
        if name in stands:
            after = stands[name] + 0.02 * rng.standard_normal(len(values))
        elif name in ("x", "y"):
            after = np.full(len(values), values[~gone & known][-1])
        else:
            continue
        changed[name] = np.where(gone & known, after, values)
    return with_channels(log, **changed)


def test_a_vehicle_that_is_stuck_from_the_start_is_no_problem_of_the_data(stuck):
    report = quality(stuck)
    assert not report.problems
    (finding,) = [one for one in report.findings if one.kind == "immobile"]
    assert hardly_driven(finding)
    assert finding.sentence.endswith("of driving are left, and a diagnosis needs 6 s")
    assert unusable([stuck], [report]) == (finding,)


def test_damaged_data_are_told_before_a_vehicle_that_is_stuck(stuck):
    report = quality(corrupted(stuck, "pitch_rate", "x1000"))
    reasons = unusable([stuck], [report])
    assert reasons == report.problems
    assert reasons
    assert any(hardly_driven(one) for one in report.findings)


@pytest.mark.parametrize(("start", "hardly"), [(4.0, True), (8.0, False)])
def test_a_few_seconds_before_the_vehicle_is_stuck_are_no_drive(driven, start, hardly):
    (finding,) = stuck_findings(stopped(driven, start))
    assert hardly_driven(finding) == hardly


def test_another_finding_leaves_a_drive():
    assert not hardly_driven(Finding(kind="unit", channel="v_x", severity="problem", sentence="x"))


@pytest.mark.check
def test_a_vehicle_that_is_stuck_from_the_start_is_outside_the_model(stuck):
    diagnosis = diagnose([stuck])
    assert diagnosis.verdict is Verdict.OUTSIDE
    sentence = verdict_sentence(diagnosis.verdict, diagnosis)
    assert sentence.startswith("There is no drive to diagnose: the vehicle gets stuck")


def test_a_vehicle_that_drives_is_not_stuck(driven):
    assert stuck_spans(driven) == ()
    assert driven_time(driven) == pytest.approx(driven.duration)


def test_only_what_was_driven_before_the_vehicle_got_stuck_is_fitted(driven):
    log = stopped(driven, 12.0)
    (span,) = stuck_spans(log)
    assert span[0] == pytest.approx(12.0, abs=1.0)
    windows = RunModel(log).windows
    ends = RunModel(log).t_0 + RunModel(log).step * (windows.first + windows.count)
    assert ends.max() <= span[0] + 0.1
    (finding,) = [one for one in quality(log).findings if one.kind == "immobile"]
    assert finding.severity == "warning"
    assert not quality(log).problems


def bogged(driven, share):
    """The log as if vehicle and wheels stood from 8 s on, driven by ``share`` of the weight."""
    log, rng = stopped(driven, 8.0), np.random.default_rng(3)
    gone, vehicle = log.times >= 8.0, log.vehicle
    torque = 0.5 * share * vehicle.m * 9.81 * vehicle.r
    changed = {}
    for name, value in (("omega_f", 0.0), ("omega_r", 0.0), ("torque_f", torque), ("torque_r", torque)):
        after = value + 0.02 * rng.standard_normal(len(gone))
        changed[name] = np.where(gone & ~np.isnan(log.channels[name]), after, log.channels[name])
    return with_channels(log, **changed)


@pytest.mark.parametrize(("share", "stuck"), [(0.11, True), (0.09, False), (-0.11, False)])
def test_a_vehicle_that_stands_though_it_is_driven_hard_is_stuck_with_wheels_that_stand(driven, share, stuck):
    """One that is held by its brakes, waits or idles is not."""
    spans = stuck_spans(bogged(driven, share))
    assert bool(spans) == stuck
    assert not stuck or spans[0][0] == pytest.approx(8.0, abs=1.0)


def test_a_torque_too_small_to_move_the_vehicle_leaves_it_stuck():
    """Soft soil at 42 % of the torque: the wheels do not even spin."""
    case = draw_case(28010, road="unknown", natural=True, duration=20.0)
    log = simulated_log(case, FAULTS["torque_scale"](-0.58))
    (span,) = stuck_spans(log)
    assert span[1] - span[0] > 10.0


def digging_in(driven, ahead):
    """The log as if the vehicle dug in after 3 s: its rims ``ahead`` times faster, then 40 times."""
    moves, rng = driven.times < 3.0, np.random.default_rng(2)
    body, rim = np.where(moves, 2.0, 0.2), np.where(moves, 2.0 * ahead, 8.0) / driven.vehicle.r
    noise = 0.01 * rng.standard_normal((3, len(driven.times)))
    way = np.cumsum(body) * (driven.times[1] - driven.times[0])
    made = {
        **dict.fromkeys(("speed", "v_x"), body + noise[0]),
        "omega_f": rim + noise[1],
        "omega_r": body / driven.vehicle.r + noise[2],
        "x": way,
        "y": np.zeros(len(way)),
    }
    known = {
        name: np.where(np.isnan(old), np.nan, made[name])
        for name, old in driven.channels.items()
        if name in made
    }
    return with_channels(driven, **known)


@pytest.mark.parametrize(("ahead", "stuck"), [(12.0, True), (15.0, False)])
def test_a_vehicle_that_digs_in_at_once_never_rolls_and_is_stuck_all_the_same(driven, ahead, stuck):
    """Its rims are 40 times ahead of it, more than three times what they were: no unit does that."""
    spans = stuck_spans(digging_in(driven, ahead))
    assert bool(spans) == stuck
    assert not stuck or spans[0][0] == pytest.approx(3.0, abs=1.0)


def test_that_the_vehicle_gets_stuck_stands_beside_any_verdict(driven):
    diagnosis = diagnose([stopped(driven, 12.0)], library=["rolling_resistance"])
    assert diagnosis.search is not None
    assert ["gets stuck" in one.sentence for one in diagnosis.findings] == [True]


def test_wheels_in_degrees_per_second_are_not_taken_for_spinning(driven):
    wheels = {name: 57.3 * driven.channels[name] for name in ("omega_f", "omega_r")}
    log = with_channels(driven, **wheels)
    assert stuck_spans(log) == ()
    assert any(finding.channel.startswith("omega") for finding in quality(log).problems)


def test_a_sensor_that_holds_one_value_is_stuck_itself(driven):
    gone = driven.times >= 10.0
    log = with_channels(driven, omega_r=np.where(gone, 0.1, driven.channels["omega_r"]))
    assert stuck_spans(log) == ()


@pytest.mark.parametrize("seed", [2, 7])
def test_an_axle_that_spins_now_and_then_is_no_problem_of_the_data(seed):
    """A centre of gravity so far off the middle leaves one driven axle too little load."""
    shift = 0.35 if seed == 2 else -0.5
    assert not quality(simulated_log(draw_case(seed), FAULTS["cg_shift"](shift))).problems


def test_a_rim_that_rolls_in_no_window_has_another_unit_and_one_that_is_noise_is_too_slow():
    rng, speed = np.random.default_rng(3), np.linspace(1.0, 5.0, 40)
    spins = speed * np.where(np.arange(40) % 4 == 0, 1.02, 3.0)
    assert only_spins(spins, speed)
    assert not only_spins(3.0 * speed, speed)
    assert not only_spins(-spins, speed)
    assert not only_spins(5.0 * rng.random(40), speed)


@pytest.mark.parametrize(("most", "spins"), [(1.5, False), (2.5, False), (8.0, True)])
def test_a_rim_that_spins_all_the_time_does_so_unevenly_and_one_with_another_unit_does_not(most, spins):
    rng = np.random.default_rng(3)
    speed = rng.uniform(1.0, 3.0, 60)
    assert only_spins(3.6 * speed * rng.uniform(1.0, most, 60), speed) is spins


def test_a_rim_that_has_rolled_has_its_unit_however_much_it_spins_later(driven):
    """The light front axle of a loaded vehicle in its own ruts looked like one in turns per minute."""
    log = stopped(driven, 2.0)
    assert has_rolled(log, "omega_f")
    for scale in (30.0 / math.pi, 3.6, -1.0):
        assert not has_rolled(with_channels(log, omega_f=scale * log.channels["omega_f"]), "omega_f")


@pytest.mark.parametrize(
    ("rolled", "ratio", "braked", "found"),
    [(0.4, 1.4, False, True), (0.2, 1.4, False, False), (0.4, 1.6, False, False), (0.4, 1.4, True, False)],
)
def test_a_moment_in_which_a_rim_is_as_fast_as_the_vehicle_must_last_without_brakes(
    driven, rolled, ratio, braked, found
):
    """A wheel in another unit passes the speed of the vehicle while it locks."""
    t = driven.times
    speed = np.full(len(t), 2.0)
    rim = np.where((t >= 1.0) & (t < 1.0 + rolled), ratio, 9.0) * speed
    torque = np.full(len(t), -100.0 if braked else 100.0)
    log = with_channels(driven, omega_f=rim / driven.vehicle.r, speed=speed, torque_f=torque)
    log = replace(log, channels={name: own for name, own in log.channels.items() if name != "v_x"})
    assert has_rolled(log, "omega_f") is found
    assert not has_rolled(replace(log, channels={"speed": speed}), "omega_f")
