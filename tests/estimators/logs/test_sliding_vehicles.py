"""A vehicle that turns without steering is outside the model, and its slides are no problem of the data."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.summarise import summarise
from estimators.discrepancy.verdict import Verdict
from estimators.logs import Log, log_from_run, quality, read_log, write_log
from estimators.logs.channel_checks import OUTSIDE
from offroad_env.physics import state as at
from offroad_env.simulation.sensors import GnssConfig, ImuConfig, SensorSuite, WheelSpeedConfig
from offroad_env.simulation.simulator import make_plant, settled_state, simulate_commands
from offroad_env.world.four_wheel_vehicles import FOUR_WHEEL_VEHICLES
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat

STEP = 0.01
RECEIVER = ("x", "y", "speed", "course")


def robot_drive(handle: float, soil: str = "sandy_loam") -> tuple[Log, np.ndarray]:
    """20 s of a skid-steered robot, as if it steered, and the speeds of its sides (T, 2) [rad/s]."""
    vehicle, four = FOUR_WHEEL_VEHICLES["warthog"]
    plant = make_plant(vehicle, SOILS[soil], flat(), vehicle_model="four_wheel", four_wheel=four)
    t = STEP * np.arange(2000)
    steer, drive = handle * np.sin(0.8 * t), 200.0 + 60.0 * np.sin(0.5 * t)
    state, warm = settled_state(plant, v_x=2.0)
    commands = np.column_stack([steer, drive, np.zeros(len(t))])
    run = simulate_commands(plant, state, warm, commands, interval=STEP)
    sensors = SensorSuite(
        imu=ImuConfig(accel_noise=0.05, gyro_noise=0.003, kind="specific_force"),
        wheel=WheelSpeedConfig(noise=0.01, scale_sd=0.0),
        gnss=GnssConfig(),
    )
    log = log_from_run(run, plant, commands, sensors, np.random.default_rng(1))
    rims = [run.readings[:, at.WHEELS + i * at.AXLE + at.R_OMEGA] / vehicle.r for i in range(at.WHEEL_COUNT)]
    sides = np.column_stack([0.5 * (rims[0] + rims[2]), 0.5 * (rims[1] + rims[3])])
    return replace(log, config=replace(log.config, four_wheel=None)), sides


@pytest.fixture(scope="module")
def robot() -> tuple[Log, np.ndarray]:
    """It turns hard, so that its wheels are far from its speed."""
    return robot_drive(0.1)


def unsteered(log: Log, *, missing: tuple[str, ...] = ()) -> Log:
    channels = {name: values for name, values in log.channels.items() if name not in missing}
    return replace(log, channels=channels | {"steer": np.zeros(len(log))})


def with_sides(log: Log, sides: np.ndarray, folder) -> Log:
    """The log as a file has it that knows left and right wheels in place of a steering."""
    path = write_log(folder / "run.csv", log)
    head, *rows = [line.split(",") for line in path.read_text().splitlines()]
    kept = [i for i, name in enumerate(head) if name not in ("steer", "omega_f", "omega_r")]
    lines = [",".join([*(head[i] for i in kept), "omega_left", "omega_right"])]
    for row, (left, right) in zip(rows, sides, strict=True):
        lines.append(",".join([*(row[i] for i in kept), str(float(left)), str(float(right))]))
    path.write_text("\n".join(lines) + "\n")
    return read_log(path)


@pytest.mark.parametrize(
    "missing",
    [(), ("pitch_rate",), RECEIVER, (*RECEIVER, "a_x", "a_y", "a_z", "pitch_rate")],
    ids=["everything", "no pitch gyro", "no receiver", "a yaw gyro and wheels"],
)
@pytest.mark.parametrize("soil", ["sandy_loam", "clay"])
def test_no_other_channel_is_blamed_for_the_slides_of_a_vehicle_without_steering(missing, soil, robot):
    log = robot[0] if soil == "sandy_loam" else robot_drive(0.1, soil)[0]
    found = diagnose([unsteered(log, missing=missing)])
    assert found.verdict is Verdict.OUTSIDE
    assert {(one.kind, one.channel) for one in found.findings} == {(OUTSIDE, "steer")}
    assert "skid steer" in summarise(found).sentence


def test_the_same_drive_has_problems_of_data_where_a_steering_is_stated(robot):
    # Otherwise nothing would show that the checks of rolling vehicles are left out.
    assert quality(robot[0]).problems


@pytest.mark.parametrize("by_sides", [False, True])
def test_what_is_not_compared_is_said(by_sides, robot, tmp_path):
    log = with_sides(*robot, tmp_path) if by_sides else unsteered(robot[0])
    notes = {one.channel: one.sentence for one in quality(log).findings if one.kind == "unchecked"}
    assert notes.keys() == log.channels.keys() - {"steer", "a_z"}
    assert all("slide in every turn" in sentence for sentence in notes.values())


def test_a_sensor_that_is_wrong_by_itself_is_still_a_problem(robot):
    log = unsteered(robot[0])
    log = replace(log, channels={**log.channels, "a_z": 5.0 * log.channels["a_z"]})
    assert {one.channel for one in quality(log).problems} == {"steer", "a_z"}
    assert diagnose([log]).verdict is Verdict.DATA_PROBLEM


@pytest.mark.parametrize(("rate", "outside"), [(0.15, False), (0.3, True)])
def test_a_turn_that_only_the_gyro_shows_must_be_clear(rate, outside, robot):
    log = unsteered(robot[0], missing=(*RECEIVER, "a_x", "a_y", "a_z", "pitch_rate"))
    yaw_rate = rate * np.sin(0.5 * log.times)
    found = quality(replace(log, channels={**log.channels, "yaw_rate": yaw_rate}))
    assert bool(found.problems) == outside
    assert not outside or "(yaw_rate alone)" in found.problems[0].sentence


@pytest.mark.parametrize(
    ("steady", "swing", "outside"),
    [(0.07, 0.0, False), (0.15, 0.0, True), (0.0, 0.05, False), (0.0, 0.07, True)],
)
def test_a_turn_that_two_channels_confirm_may_be_slower(steady, swing, outside, robot):
    log = unsteered(robot[0], missing=(*RECEIVER, "a_x", "a_y", "a_z", "pitch_rate"))
    t, noise = log.times, np.random.default_rng(0).normal(0.0, 0.003, len(log))
    turn = {
        "yaw_rate": steady + swing * np.sin(0.5 * t) + noise,
        "yaw": steady * t - swing / 0.5 * np.cos(0.5 * t),
    }
    found = quality(replace(log, channels={**log.channels, **turn}))
    assert {one.kind for one in found.problems} == ({OUTSIDE} if outside else set())
    assert not outside or "(yaw_rate, yaw agree)" in found.problems[0].sentence


@pytest.mark.parametrize(("steered", "outside"), [(0.015, True), (0.035, False)])
def test_a_steering_that_stays_near_zero_is_none(steered, outside, robot):
    log = unsteered(robot[0])
    log = replace(log, channels={**log.channels, "steer": np.full(len(log), steered)})
    assert (OUTSIDE in {one.kind for one in quality(log).findings}) == outside


def test_a_vehicle_described_by_its_sides_is_outside_the_model_and_no_problem_of_the_data(robot, tmp_path):
    log = with_sides(*robot, tmp_path)
    assert np.nanmax(np.abs(log.channels["steer"])) > 0.1  # what the sides would steer without slip
    assert not quality(log).problems  # an estimate goes on
    found = diagnose([log])
    assert found.verdict is Verdict.OUTSIDE
    assert "no wheel is steered" in summarise(found).sentence


def test_straight_on_a_vehicle_described_by_its_sides_is_like_any_other(tmp_path):
    log = with_sides(*robot_drive(0.0), tmp_path)
    assert OUTSIDE not in {one.kind for one in quality(log).findings}


def test_a_log_with_a_problem_comes_before_one_without_steering(robot, tmp_path):
    sound = with_sides(*robot, tmp_path)
    wrong = unsteered(robot[0])
    wrong = replace(wrong, channels={**wrong.channels, "a_z": 5.0 * wrong.channels["a_z"]})
    assert diagnose([sound, wrong]).verdict is Verdict.DATA_PROBLEM
