"""What the quality of a simulated log is said to be."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.logs import (
    log_from_run,
    quality,
)
from estimators.logs.clocks import pose_age
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.simulator import settled_state, simulate_commands
from simulated_logs import STEP, changed, plant_with, sensors_for


@pytest.mark.parametrize("seed", range(20))
def test_a_right_log_has_no_problem_and_no_warning(run, seed):
    trajectory, plant, commands = run
    kind = "kinematic" if seed % 2 else "specific_force"
    good = log_from_run(trajectory, plant, commands, sensors_for(kind=kind), np.random.default_rng(seed))
    report = quality(good)
    assert [f.sentence for f in report.findings if f.severity != "note"] == []
    verdicts = {check.name: check.verdict for check in report.checks}
    for law in ("speed x steer / wheelbase", "the turn of the path x, y"):
        assert verdicts[f"yaw_rate against {law}"] == "agrees"
    assert verdicts["a_y against speed x yaw_rate"] == "agrees"
    assert verdicts["a_x against the change of speed"] == "agrees"


DEGREES = math.degrees(1.0)


@pytest.mark.parametrize(
    ("factors", "suspected"),
    [
        ({"yaw_rate": DEGREES, "pitch_rate": DEGREES}, {"yaw_rate": "deg/s"}),
        ({"a_x": 1 / GRAVITY, "a_y": 1 / GRAVITY, "a_z": 1 / GRAVITY}, {"a_x": "g", "a_y": "g", "a_z": "g"}),
        ({"omega_f": 30 / math.pi, "omega_r": 30 / math.pi}, {"omega_f": "rpm", "omega_r": "rpm"}),
        ({"omega_f": DEGREES}, {"omega_f": "deg/s"}),
        (
            {"omega_f": 0.33, "omega_r": 0.33},
            {"omega_f": "m/s (a rim speed)", "omega_r": "m/s (a rim speed)"},
        ),
        ({"speed": 3.6}, {"speed": "km/h"}),
        ({"speed": 2.237}, {"speed": "mph"}),
        ({"x": 1e3, "y": 1e3}, {"x": "mm"}),
        ({"a_y": 1 / GRAVITY}, {"a_y": "g"}),
    ],
    ids=lambda value: ",".join(value) if isinstance(value, dict) else None,
)
def test_a_wrong_unit_is_suspected_by_name(factors, suspected, log):
    wrong = changed(log, **{name: factor * log.channels[name] for name, factor in factors.items()})
    found = quality(wrong).suspected_units
    assert suspected.items() <= found.items()
    assert set(found) <= set(factors)  # and no channel that is right


def test_an_accelerometer_that_contradicts_its_description_is_found(run, log):
    kinematic = replace(log.config, imu=replace(log.config.imu, kinematic=True))
    found = [f for f in quality(replace(log, config=kinematic)).problems if f.kind == "frame"]
    assert "kinematic is false" in found[0].sentence
    without_gravity = changed(log, a_z=log.channels["a_z"] - GRAVITY)
    found = [f for f in quality(without_gravity).problems if f.kind == "frame"]
    assert "kinematic is true" in found[0].sentence


@pytest.mark.parametrize("channel", ["yaw_rate", "a_y", "a_x"])
def test_a_reversed_sign_is_found(channel, log):
    problems = quality(changed(log, **{channel: -log.channels[channel]})).problems
    assert any(f.kind == "sign" and channel in f.sentence for f in problems)


def test_an_imu_turned_by_a_right_angle_is_found_with_its_direction(log):
    for sign, side in ((1.0, "left"), (-1.0, "right")):
        a_x, a_y = log.channels["a_x"], log.channels["a_y"]
        turned = changed(log, a_x=sign * a_y, a_y=-sign * a_x)
        axes = [f for f in quality(turned).problems if f.kind == "axes"]
        assert len(axes) == 1
        assert f"points {side}" in axes[0].sentence


def test_a_stuck_channel_is_found_with_its_time(log):
    a_x = log.channels["a_x"].copy()
    a_x[500:800] = a_x[500]
    warnings = [f for f in quality(changed(log, a_x=a_x)).findings if f.kind == "stuck"]
    assert [f.channel for f in warnings] == ["a_x"]
    assert warnings[0].numbers["time"] == pytest.approx(2.99)
    dead = quality(changed(log, a_x=np.full(len(log), 0.25)))
    assert any(f.kind == "stuck" and f.severity == "problem" for f in dead.findings)


@pytest.mark.parametrize("channel", ["a_x", "yaw_rate", "omega_r", "speed"])
def test_a_channel_that_sticks_while_the_vehicle_moves_is_a_problem(channel, log):
    values = log.channels[channel].copy()
    middle = (log.t > 9.0) & (log.t < 15.0) & ~np.isnan(values)
    values[middle] = values[middle][0]
    found = [f for f in quality(changed(log, **{channel: values})).problems if f.kind == "stuck"]
    assert [f.channel for f in found] == [channel]
    assert "while the vehicle moves" in found[0].sentence


def test_numbers_that_repeat_by_habit_are_not_stuck(log):
    """Held for two seconds, again and again; in steps coarser than their noise; and of a vehicle at rest."""
    rate = log.channels["yaw_rate"]
    held = np.repeat(rate[::200], 200)[: len(rate)]
    coarse = 0.05 * np.round(rate / 0.05)
    stands = log.t > 12.0
    rest = {
        name: np.where(stands, 0.0, log.channels[name]) for name in ("omega_f", "omega_r", "speed", "steer")
    }
    rest |= {
        name: np.where(
            stands, log.channels[name][~np.isnan(log.channels[name]) & stands][0], log.channels[name]
        )
        for name in ("x", "y", "course")
    }
    rest |= {
        name: np.where(stands, 0.2 * np.random.default_rng(0).standard_normal(len(log)), log.channels[name])
        for name in ("a_x", "a_y")
    }
    still = np.where(stands, rate[0], rate)
    for one in (
        changed(log, yaw_rate=held),
        changed(log, yaw_rate=coarse),
        changed(log, yaw_rate=still, **rest),
    ):
        assert not [f for f in quality(one).problems if f.kind == "stuck"]


def test_a_sensor_at_the_end_of_its_range_is_found(log):
    rate = log.channels["yaw_rate"]
    limit = np.quantile(rate, 0.99)
    clipped = quality(changed(log, yaw_rate=np.minimum(rate, limit)))
    found = [f for f in clipped.findings if f.kind == "saturation"]
    assert [f.channel for f in found] == ["yaw_rate"]
    assert found[0].numbers["share"] == pytest.approx(0.01, abs=0.002)


def test_a_gap_of_the_whole_log_is_told_once_and_one_of_a_channel_for_that_channel(log):
    x = log.channels["x"].copy()
    x[800:1400] = math.nan
    found = [f for f in quality(changed(log, x=x)).findings if f.kind == "gap"]
    assert [f.channel for f in found] == ["x"]
    assert found[0].numbers["longest"] == pytest.approx(6.1)
    t = log.t.copy()
    t[1000:] += 4.0
    found = [f for f in quality(replace(log, t=t)).findings if f.kind == "gap"]
    assert [(f.channel, f.numbers["at"]) for f in found] == [("t", pytest.approx(9.99))]


def test_a_position_that_jumps_is_told_and_one_that_only_drives_is_not(log):
    assert not [f for f in quality(log).findings if f.kind == "jump"]
    x = log.channels["x"] + 3.0 * (log.t > 12.0)
    found = [f for f in quality(changed(log, x=x)).findings if f.kind == "jump"]
    assert [f.severity for f in found] == ["warning"]
    assert found[0].numbers["at"] == pytest.approx(12.0, abs=0.4)


def test_jitter_is_measured(log):
    rng = np.random.default_rng(0)
    t = log.t + rng.uniform(-0.002, 0.002, len(log))
    rows = {c.name: c for c in quality(replace(log, t=t)).channels}
    # Differences of two uniform errors of +-2 ms: 2 ms sqrt(2/3).
    assert rows["a_x"].jitter == pytest.approx(0.002 * math.sqrt(2.0 / 3.0), rel=0.1)
    assert rows["x"].rate == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize("delay", [0.05, -0.08, 0.15])
def test_two_clocks_are_told_apart_to_ten_milliseconds(delay, log):
    yaw = np.interp(log.t - delay, log.t, log.references["ref_yaw"])
    found = [f for f in quality(changed(log, yaw=yaw)).findings if (f.kind, f.channel) == ("clock", "yaw")]
    assert found[0].numbers["delay"] == pytest.approx(delay, abs=0.01)
    in_time = changed(log, yaw=log.references["ref_yaw"].copy())
    assert [f for f in quality(in_time).findings if f.channel == "yaw"] == []
    # A heading that seems to come too soon is a gyro that is late: the pose is not younger than it says.
    assert pose_age(changed(log, yaw=yaw)) == pytest.approx(max(delay, 0.0), abs=0.01)
    assert pose_age(in_time) == pose_age(log) == 0.0


def test_heading_in_degrees_is_suspected_even_where_it_wraps(log):
    yaw = np.degrees(log.references["ref_yaw"] + 3.1) % 360.0
    assert quality(changed(log, yaw=yaw)).suspected_units == {"yaw": "deg"}


def test_a_description_that_understates_the_noise_is_noted(log):
    imu = replace(log.config.imu, sd_a=0.005)
    notes = [
        f for f in quality(replace(log, config=replace(log.config, imu=imu))).findings if f.kind == "noise"
    ]
    assert {f.channel for f in notes} == {"a_x", "a_y", "a_z"}
    assert notes[0].numbers["measured"] == pytest.approx(0.05, rel=0.2)


def test_a_run_that_excites_nothing_says_so(tmp_path):
    plant = plant_with(0.8)
    state, warm = settled_state(plant, v_x=4.0)
    commands = np.tile([0.0, 330.0, 0.0], (800, 1))
    trajectory = simulate_commands(plant, state, warm, commands, interval=STEP)
    dull = log_from_run(trajectory, plant, commands, sensors_for(), np.random.default_rng(0))
    sentences = [f.sentence for f in quality(dull).findings if f.kind == "excitation"]
    assert any(s.startswith("steer never moves") for s in sentences)


def test_a_report_is_a_table_and_valid_json(log):
    wrong = quality(changed(log, yaw_rate=DEGREES * log.channels["yaw_rate"]))
    head, rows = wrong.table()
    assert len(rows) == len(log.channels)
    assert all(len(row) == len(head) for row in rows)
    data = json.loads(json.dumps(wrong.to_dict(), allow_nan=False))
    assert data["suspected_units"]["yaw_rate"] == "deg/s"
    assert "yaw_rate is in deg/s" in str(wrong)


@pytest.mark.parametrize("rows", [2, 3, 9, 60])
def test_a_very_short_log_still_gets_its_table(rows, log):
    short = replace(
        log, t=log.t[:rows], channels={k: v[:rows] for k, v in log.channels.items()}, references={}
    )
    assert len(quality(short).channels) == len(log.channels)
