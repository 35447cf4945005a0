"""`offroad log check`: everything at once, and with exactly the lines that it prints a log is read right."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from bad_logs import no_change, rig
from foreign_logs import DESCRIPTION, RADIUS, Foreign, G, drive, in_imu_axes, write

from agents.commands.cli import main
from estimators.discrepancy.diagnosis import diagnose
from estimators.log_estimation import estimate_log
from estimators.logs import f1tenth_log, quality, read_log, write_log
from estimators.logs.checking.check import check_description, check_log
from estimators.logs.checking.naming import column_of
from estimators.logs.key_table import column_rows, log_rows
from estimators.logs.schema import ALL_COLUMNS
from estimators.logs.template import log_template
from helpers import measured_data
from mended_logs import (
    DEGREES,
    IMU,
    PLAIN,
    assert_is_the_drive,
    mended,
    printed_lines,
    turned_and_scaled,
)
from offroad_env.errors import DataError

#: Foreign names, degrees, g, milliseconds, an IMU turned by 90 degrees and no pitch gyro: its y axis points
#: backwards, so that the rate about x is the one of pitching.
ISSUE = Foreign(
    names={
        "t": "Timestamp", "steer": "SteeringAngle", "torque_f": "TrqFront", "torque_r": "TrqRear",
        "omega_r": "wheel_speed_rear", "v_x": "vx", "x": "gps/east", "y": "gps/north",
        "a_x": "imu/linear_acceleration.x", "a_y": "imu/linear_acceleration.y",
        "a_z": "imu/linear_acceleration.z",
        "gyro_z": "imu/angular_velocity.z",
    },
    change=turned_and_scaled,
    extra={"battery": "12.1", "mode": "auto"},
)  # fmt: skip


@pytest.mark.check  # a minute: a whole log is estimated, and its first seconds are diagnosed
def test_with_exactly_the_printed_lines_estimate_and_diagnose_run(tmp_path, capsys):
    path = write(tmp_path, ISSUE)
    with pytest.raises(SystemExit) as ended:
        main(["log", "check", str(path), "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    output = capsys.readouterr().out
    lines = printed_lines(output)
    settings = tmp_path / "run.yaml"
    settings.write_text(settings.read_text() + "\n".join(lines) + "\n")
    log = read_log(path)
    assert_is_the_drive(log)
    assert not quality(log).problems
    assert "pitch_rate" not in log.channels
    assert "no pitch_rate" in output
    assert "pitch_rate is not measured" in " ".join(estimate_log(log, "online_joint_ukf").notes)
    # On hard ground, and the first seconds of the file: a search over all of it takes minutes.
    settings.write_text(
        settings.read_text().replace("{base: dry_sand}", "{kind: rigid, mu: 0.8, C_alpha: 8.0}")
    )
    path.write_text("\n".join(path.read_text().splitlines()[:160]) + "\n")
    assert diagnose([read_log(path)]).verdict is not None


def test_what_is_wrong_is_listed_in_one_go(tmp_path):
    report = check_log(write(tmp_path, ISSUE))
    keys = {line.key for line in report.lines}
    assert {f"columns.{name}" for name in ("t", "steer", "a_x", "a_y", "a_z", "gyro_z")} <= keys
    assert {
        "units.t",
        "units.steer",
        "units.a_x",
        "units.gyro_z",
        "imu.orientation",
        "columns.ignore",
    } <= keys
    assert (tmp_path / "run.yaml").read_text().count("\n") == 8  # nothing was written


def test_a_log_without_faults_gets_no_line(tmp_path):
    report = check_log(write(tmp_path, Foreign(names=PLAIN | IMU)))
    assert report.lines == ()
    assert report.commands == {"estimate": "", "diagnose": "", "replay": ""}


def some_mountings():
    rng = np.random.default_rng(7)
    turns = [np.eye(3)[:, order] * signs for order in itertools.permutations(range(3)) for signs in
             itertools.product((1.0, -1.0), repeat=3)]  # fmt: skip
    right = [turn for turn in turns if np.linalg.det(turn) > 0.0]
    return [right[i] for i in rng.choice(len(right), 3, replace=False)]


@pytest.mark.parametrize("axes", some_mountings(), ids=lambda axes: str(axes.astype(int).tolist()))
def test_any_mounting_at_right_angles_is_found(axes, tmp_path):
    names = PLAIN | {name: name for name in ("a_x", "a_y", "a_z", "gyro_x", "gyro_y", "gyro_z")}
    log = mended(write(tmp_path, Foreign(names=names, change=lambda c: in_imu_axes(c, axes))))
    assert_is_the_drive(log, names=("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate"))


def test_an_imu_that_is_tilted_is_turned_upright(tmp_path):
    angle = np.radians(25.0)
    axes = np.array(
        [[np.cos(angle), 0.0, -np.sin(angle)], [0.0, 1.0, 0.0], [np.sin(angle), 0.0, np.cos(angle)]]
    )
    log = mended(
        write(
            tmp_path,
            Foreign(names=PLAIN | IMU | {"roll_rate": "roll_rate"}, change=lambda c: in_imu_axes(c, axes)),
        )
    )
    assert_is_the_drive(log, names=("a_x", "a_y", "yaw_rate"), far=0.2)  # a degree


@pytest.mark.parametrize(
    "drive_name", ["DS1", *(pytest.param(name, marks=pytest.mark.check) for name in ("DS2", "DS3"))]
)
def test_the_published_drives_of_the_1_to_10_car_are_put_right_by_their_lines(drive_name, tmp_path):
    published = measured_data("f1tenth_indoor") / f"{drive_name}.csv"
    right = f1tenth_log(published, corrected=True)
    path = write_log(tmp_path / "run.csv", f1tenth_log(published))
    log = mended(path)
    assert not quality(log).problems
    for name in ("a_x", "a_y", "a_z", "roll_rate", "pitch_rate", "yaw_rate"):
        assert np.allclose(log.channels[name], right.channels[name], rtol=1e-12), name


def test_a_drive_as_published_with_a_template_is_read_by_the_lines_alone(tmp_path):
    path = tmp_path / "run.csv"
    published = measured_data("f1tenth_indoor") / "DS1.csv"
    path.write_bytes(published.read_bytes())
    path.with_suffix(".yaml").write_text(log_template("f1tenth", "dry_sand"))
    log, right = mended(path), f1tenth_log(published, corrected=True)
    for name in ("steer", "omega_f", "a_x", "a_y", "yaw_rate", "yaw"):
        assert np.allclose(log.channels[name], right.channels[name], rtol=1e-9), name


@pytest.mark.parametrize("vehicle", ["mrzr", "f1tenth"])
def test_a_template_has_no_problem(vehicle, tmp_path):
    settings = tmp_path / "run.yaml"
    settings.write_text(log_template(vehicle, "clay"))
    assert check_description(settings).remarks == ()
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    settings.write_text(log_template(vehicle, "clay"))
    assert not [r for r in check_description(settings).remarks if r.severity == "problem"]
    assert read_log(path).config.start.v_x == pytest.approx(drive()["v_x"][0])


def test_problems_of_the_description_are_listed_at_once_with_those_of_the_data(tmp_path):
    path = write(tmp_path, ISSUE)
    settings = path.with_suffix(".yaml")
    text = (
        DESCRIPTION.replace("r: 0.33", "r: -2.0")
        .replace("rate: 0.003", "rate: 40.0")
        .replace("start: log\n", "")
    )
    settings.write_text(text)
    report = check_log(path)
    problems = " | ".join(remark.sentence for remark in report.remarks if remark.severity == "problem")
    for part in ("-2", "imu.sd.rate", "start is missing", "SteeringAngle", "turned"):
        assert part in problems


def test_a_description_that_is_not_utf8_is_a_problem_as_for_the_reader(tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    settings = path.with_suffix(".yaml")
    settings.write_bytes(f"# first\n# Versuch Günzburg\n{DESCRIPTION}".encode("latin-1"))
    with pytest.raises(DataError) as refused:
        read_log(path)
    for report in (check_log(path), check_description(settings)):
        (found,) = [remark for remark in report.remarks if remark.severity == "problem"]
        assert found.sentence.startswith(str(refused.value))
        assert "(line 2): save it as UTF-8" in found.sentence
        assert found.lines == ()
        assert report.obstacle
    assert set(check_log(path).commands) == {"estimate", "diagnose", "replay"}
    assert all(check_log(path).commands.values())


def test_names_in_a_description_that_is_not_utf8_are_still_found_in_the_file(tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU | {"v_x": "v_längs"}))
    settings = path.with_suffix(".yaml")
    settings.write_bytes(f"{DESCRIPTION}columns.v_x: v_längs\n".encode("latin-1"))
    report = check_log(path)
    assert "v_x" in report.log.channels
    assert len([remark for remark in report.remarks if remark.severity == "problem"]) == 1


def test_no_command_takes_a_log_whose_description_is_a_stand_in(tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    path.with_suffix(".yaml").unlink()
    report = check_log(path)
    assert "offroad log template VEHICLE" in report.obstacle
    assert all(report.commands.values())


@pytest.mark.parametrize(
    ("imu", "keys"),
    [
        ("{kinematic: false}", {"imu.sd"}),
        ("{sd: {a: 0.05, rate: 0.003}}", {"imu.kinematic"}),
        ("{kinematic: false, sd: {a: 0.05}}", {"imu.sd.rate"}),
        ("{sd: {}}", {"imu.kinematic", "imu.sd.a", "imu.sd.rate"}),
    ],
)
def test_what_the_section_of_an_imu_lacks_is_mended_by_lines(imu, keys, tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    settings = path.with_suffix(".yaml")
    given = "{kinematic: false, sd: {a: 0.05, rate: 0.003}}"
    settings.write_text(DESCRIPTION.replace(given, imu))
    assert {line.key for line in check_description(settings).lines} == keys
    mended(path)
    assert check_log(path).lines == ()


def test_a_misspelt_key_of_an_imu_gets_no_line(tmp_path):
    settings = tmp_path / "run.yaml"
    settings.write_text(DESCRIPTION.replace("kinematic", "kinematc"))
    report = check_description(settings)
    assert report.lines == ()
    assert "is it 'kinematc'?" in report.remarks[0].sentence


def test_left_and_right_wheel_speeds_take_the_place_of_a_steering_angle(tmp_path):
    names = {
        name: name for name in ("t", "torque_f", "torque_r", "omega_left", "omega_right", "x", "y")
    } | IMU
    log = mended(write(tmp_path, Foreign(names=names)))
    right = drive()
    assert "Skid steering" in " ".join(log.config.notes)
    assert np.corrcoef(log.channels["steer"], right["steer"])[0, 1] > 0.98
    assert np.allclose(log.channels["omega_f"], right["v_x"] / RADIUS, rtol=0.05)


def test_an_imu_with_jitter_is_brought_to_an_even_rate(tmp_path):
    rng = np.random.default_rng(4)
    base = drive()
    t = np.sort(base["t"] + 0.007 * rng.uniform(-1.0, 1.0, len(base["t"])))
    channels = {name: np.interp(t, base["t"], values) for name, values in base.items()} | {"t": t}
    path = write(tmp_path, Foreign(names=PLAIN | IMU), channels)
    assert "imu.rate" in {line.key for line in check_log(path).lines}
    log = mended(path)
    steps = np.diff(log.samples("yaw_rate")[0])
    assert np.ptp(steps) < 1e-6
    assert_is_the_drive(log, base, names=("yaw_rate",), far=0.05)


def test_a_drive_straight_ahead_shows_its_units_by_noise_and_size(tmp_path):
    def straight(channels):
        noise = np.random.default_rng(8).standard_normal((3, len(channels["t"])))
        calm = {"steer": 0.25 * np.sin(channels["t"]), "x": 4.0 * channels["t"], "y": 0.0 * channels["t"]}
        gyros = dict(zip(("yaw_rate", "pitch_rate"), DEGREES * 0.003 * noise, strict=False))
        return channels | calm | gyros | {"a_y": 0.05 * noise[2]}

    report = check_log(write(tmp_path, Foreign(names=PLAIN | IMU, change=straight)))
    lines = {line.key: line.value for line in report.lines}
    assert lines["units.steer"] == "deg"
    assert lines["units.yaw_rate"] == lines["units.pitch_rate"] == "deg/s"


def test_a_log_of_three_seconds_at_most_is_taken_by_no_command_that_needs_more(tmp_path):
    def first(channels):
        early = channels["t"] - channels["t"][0] < 2.95
        return {name: values[early] for name, values in channels.items()}

    commands = check_log(write(tmp_path, Foreign(names=PLAIN | IMU, change=first))).commands
    for command in ("estimate", "diagnose"):
        assert commands[command].startswith("lasts 2.")
        assert commands[command].endswith("needs 3 s")


@pytest.mark.parametrize("missing", ["a_x", "a_y", "a_z", "pitch_rate", "yaw_rate"])
def test_no_channel_of_the_imu_is_needed_to_estimate(missing, tmp_path):
    names = PLAIN | {name: name for name in IMU if name != missing}
    report = check_log(write(tmp_path, Foreign(names=names)))
    assert report.commands["estimate"] == ""
    assert f"no {missing}" in " ".join(remark.sentence for remark in report.remarks)


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("imu/linear_acceleration.y", "a_y"), ("AccZ[g]", "a_z"), ("angular_velocity_x", "gyro_x"),
        ("WheelSpeed_FL (rpm)", "omega_fl"), ("front_left_wheel_speed", "omega_fl"),
        ("rpm_right", "omega_right"),
        ("SteeringAngle [deg]", "steer"), ("delta", "steer"), ("yawRate", "yaw_rate"), ("heading", "yaw"),
        ("gps.lat", "latitude"), ("GPS Speed [km/h]", "speed"), ("vx", "v_x"), ("pose.position.x", "x"),
        ("Motor Torque [Nm]", "torque_total"), ("timestamp", "t"), ("orientation.w", "q_w"),
        ("cog", "course"),
        ("battery", None), ("gps_accuracy", None), ("target_speed", None), ("a_x_std", None), ("mode", None),
    ],
)  # fmt: skip
def test_names_of_columns_are_understood(name, column):
    assert column_of(name) == column


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("columns.a_q: x", "did you mean"), ("columns.t: 3.0", "constant"), ("signs.a_x: 2", "1 or -1"),
        ("signs.roll_rate: -1", "no such column"), ("imu.orientation: {yaw: 90}", "90 deg"),
        ("imu.orientation: {forward: up}", "axis of the IMU"),
        ("imu.orientation: {forward: x, left: x}", "right angles"),
        ("imu.rate: fast", "100 Hz"), ("imu.rate: 1e9", "1000"), ("csv.separator: ab", "csv.separator"),
        ("csv.decimal: ','", "which is which"), ("csv.encoding: nonsense", "utf-8"),
        ("time.order: maybe", "sort"),
        ("blank.a_x: [3.0, 1.0]", "from, to"), ("blank.roll_rate: all", "no such column"),
        ("columns.steer: steering", "no such column"), ("units.a_x: furlong", "acceleration"),
        ("units.a_x: __import__('os')", "acceleration"), ("units.a_x: m**9**9**9", "acceleration"),
        ("columns.ignore: 3", "list"),
    ],
)  # fmt: skip
def test_a_wrong_line_is_refused_with_what_is_allowed(line, part, tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    with path.with_suffix(".yaml").open("a") as file:
        file.write(line + "\n")
    with pytest.raises(DataError, match=r"run\.(yaml|csv)") as refused:
        read_log(path)
    assert part in str(refused.value)


def test_units_go_beyond_the_usual_ones(tmp_path):
    names = PLAIN | IMU | {"torque_f": "torque_f"}
    path = write(
        tmp_path, Foreign(names=names, change=lambda c: c | {"yaw_rate": c["yaw_rate"] / (0.0175 / DEGREES)})
    )
    with path.with_suffix(".yaml").open("a") as file:
        file.write("units.yaw_rate: 0.0175 deg/s\nunits.torque_f: lbf*ft\nunits.torque_r: 0.5 kgf*m\n")
    log = read_log(path)
    assert_is_the_drive(log, names=("yaw_rate",))
    assert log.channels["torque_f"][0] == pytest.approx(drive()["torque_f"][0] * 1.3558179483, rel=1e-6)
    assert log.channels["torque_r"][0] == pytest.approx(drive()["torque_r"][0] * 0.5 * G, rel=1e-6)


def test_what_was_read_through_all_keys_is_written_as_a_plain_log(tmp_path):
    log = mended(write(tmp_path, ISSUE))
    back = read_log(write_log(tmp_path / "plain.csv", log))
    assert set(back.channels) == set(log.channels)
    assert all(
        np.array_equal(back.channels[name], log.channels[name], equal_nan=True) for name in log.channels
    )


def test_the_reference_table_has_every_key_of_a_log(tmp_path):
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    with path.with_suffix(".yaml").open("a") as file:
        file.write("zzz: 1\n")
    with pytest.raises(DataError) as refused:
        read_log(path)
    known = {name.strip() for name in str(refused.value).partition("known: ")[2].split(",")}
    listed = {row.key.partition(".")[0] for row in log_rows()}
    assert known <= listed
    assert listed - known == {"topics", "clock", "wheel"}  # of bags and rigs
    assert {row.key for row in column_rows()} == set(ALL_COLUMNS)


def test_trials_of_a_wheel_rig_are_checked_too(tmp_path):
    rig(no_change)(tmp_path)
    report = check_log(tmp_path / "run.csv")
    assert report.readable
    assert report.lines == ()
    assert report.commands["diagnose"] == ""


@pytest.mark.parametrize("drive_name", ["clay_0.05_sin02_R0.csv", "sand_0.01_straight_R0.csv"])
def test_logs_in_the_format_of_this_project_need_no_line(drive_name):
    report = check_log(measured_data("chrono_scm") / drive_name)
    assert report.lines == ()
    assert not [remark for remark in report.remarks if remark.severity == "problem"]


@pytest.mark.parametrize("file", ["run.csv", "run.yaml"])
def test_the_check_of_damaged_files_ends_in_findings_or_one_sentence(file, tmp_path):
    path = write(tmp_path, ISSUE, drive(seconds=3.0))
    content, rng = (tmp_path / file).read_bytes(), np.random.default_rng(3)
    ends = []
    for _ in range(15):
        damaged = bytearray(content)
        for position in rng.integers(0, len(content), rng.integers(1, 8)):
            damaged[position] = int(rng.integers(0, 256))
        (tmp_path / file).write_bytes(bytes(damaged))
        try:
            ends.append(bool(check_log(path).remarks))
        except DataError as error:
            ends.append("run" in str(error))
    assert all(ends)


def test_rows_of_another_width_than_the_header_are_a_problem_without_a_line(tmp_path):
    rows = Foreign(names=PLAIN | IMU, text=lambda text: text.splitlines()[0] + "\n1,2\n3,4\n")
    report = check_log(write(tmp_path, rows))
    assert not report.readable
    assert any(remark.severity == "problem" and not remark.lines for remark in report.remarks)
