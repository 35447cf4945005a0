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
from estimators.logs import Log, f1tenth_log, quality, read_log, write_log
from estimators.logs.checking.check import check_description, check_log, with_lines
from estimators.logs.checking.naming import column_of
from estimators.logs.key_table import column_rows, log_rows
from estimators.logs.schema import ALL_COLUMNS
from estimators.logs.template import log_template
from helpers import measured_data
from offroad_env.errors import DataError

DEGREES = 180.0 / np.pi
PLAIN = {name: name for name in ("t", "steer", "torque_f", "torque_r", "omega_r", "v_x", "x", "y")}
IMU = {name: name for name in ("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate")}
#: Axes x, y, z of an IMU that is turned by 90 degrees to the left, as columns.
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def printed_lines(output: str) -> list[str]:
    """The lines that the check asks to add: the block after "add to"."""
    block = output.split("add to ", 1)[1].split("\n", 2)[2]
    return [line for line in block.split("\n\n", 1)[0].splitlines() if line]


def mended(path) -> Log:
    """The log, read with the lines of its check added to its YAML as text."""
    report = check_log(path)
    left = [remark.sentence for remark in report.remarks if remark.severity == "problem" and not remark.lines]
    assert not left
    settings = path.with_suffix(".yaml")
    settings.write_text(with_lines(settings.read_text(), report.lines))
    return read_log(path)


def assert_is_the_drive(log: Log, channels=None, *, names=("steer", "a_x", "a_y", "yaw_rate"), far=1e-3):
    channels = drive() if channels is None else channels
    for name in names:
        t, values = log.samples(name)
        expected = np.interp(t - t[0], channels["t"], channels[name])
        assert np.abs(values - expected).max() < far * max(np.abs(expected).max(), 1.0), name


def turned_and_scaled(channels):
    made = in_imu_axes(channels, TURNED)
    for name in ("a_x", "a_y", "a_z"):
        made[name] = made[name] / G
    for name in ("gyro_x", "gyro_z", "steer"):
        made[name] = DEGREES * made[name]
    return made | {"t": 1000.0 * channels["t"] + 5e6}


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


def reversed_(*names: str):
    return lambda channels: channels | {name: -channels[name] for name in names}


def times(name: str, factor: float):
    return lambda channels: channels | {name: factor * channels[name]}


def gaps(channels):
    made = {name: values.copy() for name, values in channels.items()}
    for name, every in (("x", 10), ("y", 10), ("v_x", 5)):
        made[name][np.arange(len(made[name])) % every != 0] = np.nan
    made["a_x"][100:108] = np.nan
    return made


def quaternion(channels):
    half = 0.5 * channels["yaw"]
    zero = np.zeros(len(half))
    return channels | {"q_w": np.cos(half), "q_x": zero, "q_y": zero, "q_z": np.sin(half)}


def fixes(channels):
    north, east = 111_132.95, 111_412.88 * np.cos(np.radians(48.0))
    return channels | {"lat": 48.0 + channels["y"] / north, "lon": 11.0 + channels["x"] / east}


def numbered(text: str, change) -> str:
    head, *rows = text.splitlines()
    return "\n".join([head, *(change(i, row) for i, row in enumerate(rows))]) + "\n"


def rest(row: str) -> str:
    return row.split(",", 1)[1]


def late_row(text: str) -> str:
    head, first, *rows = text.splitlines()
    return "\n".join([head, *rows[:7], first, *rows[7:]]) + "\n"


def unmeasured(i: int, row: str) -> str:
    mark = "N/A" if i % 3 else "-9999"
    return f"{row.rsplit(',', 1)[0]},{mark}" if i % 40 == 5 else row


UNITS_ROW = "[s],[deg],[Nm],[Nm],[rad/s],[km/h],[m],[m],[m/s2],[m/s2],[m/s2],[rad/s],[rad/s]"
PER_MINUTE = 60.0 / (2.0 * np.pi)
WAYS = {
    "time in ns since 1970": Foreign(
        names=PLAIN | IMU, change=lambda c: c | {"t": 1e9 * c["t"] + 1.7e18}, digits=19
    ),
    "time in us": Foreign(names=PLAIN | IMU, change=times("t", 1e6)),
    "dates": Foreign(
        names=PLAIN | IMU,
        text=lambda text: numbered(text, lambda i, row: f"2026-05-01T10:00:{0.02 * i:09.6f}Z,{rest(row)}"),
    ),
    "seconds and nanoseconds": Foreign(
        names={"secs": "header.stamp.secs", "nsecs": "header.stamp.nsecs"}
        | PLAIN
        | IMU
        | {"t": "counter_t_unused"},
        change=lambda c: c | {"secs": 1.7e9 + np.floor(c["t"]), "nsecs": np.round(1e9 * (c["t"] % 1.0))},
        digits=12,
    ),
    "stamps stand twice": Foreign(
        names=PLAIN | IMU,
        text=lambda text: numbered(text, lambda i, row: f"{row}\n{row}" if i % 50 == 7 else row),
    ),
    "rows out of order": Foreign(
        names=PLAIN | IMU,
        text=late_row,
    ),
    "rows without time": Foreign(
        names=PLAIN | IMU,
        text=lambda text: numbered(text, lambda i, row: f"{row}\n,{rest(row)}" if i % 90 == 11 else row),
    ),
    "semicolons and decimal commas": Foreign(
        names=PLAIN | IMU, text=lambda text: text.replace(",", ";").replace(".", ",")
    ),
    "tabs": Foreign(names=PLAIN | IMU, text=lambda text: text.replace(",", "\t")),
    "comments and a title before the header": Foreign(
        names=PLAIN | IMU, text=lambda text: "# logger 3\n# car 7\n" + text
    ),
    "a preamble of another width": Foreign(
        names=PLAIN | IMU, text=lambda text: "Logger,Version 3\nCar,7\n\n" + text
    ),
    "a row of units": Foreign(
        names=PLAIN | IMU,
        change=lambda c: c | {"steer": DEGREES * c["steer"], "v_x": 3.6 * c["v_x"]},
        text=lambda text: text.replace("\n", f"\n{UNITS_ROW}\n", 1),
    ),
    "units in the heading": Foreign(
        names=PLAIN | IMU | {"yaw_rate": "yaw_rate [deg/s]", "steer": "steer (deg)", "v_x": "v_x_kmh"},
        change=lambda c: (
            c | {"yaw_rate": DEGREES * c["yaw_rate"], "steer": DEGREES * c["steer"], "v_x": 3.6 * c["v_x"]}
        ),
    ),
    "UTF-16": Foreign(names=PLAIN | IMU, text=lambda text: text.encode("utf-16")),
    "Latin-1 with a degree sign": Foreign(
        names=PLAIN | IMU | {"steer": "steer [°]"},
        change=times("steer", DEGREES),
        text=lambda text: text.encode("latin-1"),
    ),
    "NA and -9999": Foreign(
        names=PLAIN | IMU | {"roll_rate": "roll_rate"},
        text=lambda text: numbered(text, unmeasured),
    ),
    "rows cut off": Foreign(names=PLAIN | IMU, text=lambda text: text[:-30]),
    "wheel speeds in rpm, each wheel": Foreign(
        names={**PLAIN, **IMU, "omega_r": "rpm_rl", "rr": "rpm_rr", "fl": "rpm_fl", "fr": "rpm_fr"},
        change=lambda c: (
            c
            | {
                "omega_r": PER_MINUTE * c["omega_r"],
                "rr": PER_MINUTE * c["omega_r"],
                "fl": PER_MINUTE * c["omega_f"],
                "fr": PER_MINUTE * c["omega_f"],
            }
        ),
    ),
    "speed of the rim": Foreign(
        names={**PLAIN, **IMU, "omega_r": "wheel_speed_kmh"}, change=times("omega_r", 3.6 * RADIUS)
    ),
    "quaternion": Foreign(
        names=PLAIN | IMU | {f"q_{axis}": f"orientation.{axis}" for axis in "wxyz"}, change=quaternion
    ),
    "latitude and longitude": Foreign(
        names={n: n for n in PLAIN if n not in "xy"} | IMU | {"lat": "latitude", "lon": "longitude"},
        change=fixes,
        digits=14,
    ),
    "steering reversed": Foreign(names=PLAIN | IMU | {"yaw": "yaw"}, change=reversed_("steer")),
    "lateral and yaw reversed": Foreign(
        names=PLAIN | IMU | {"yaw": "yaw"}, change=reversed_("a_y", "yaw_rate")
    ),
    "gravity reversed": Foreign(names=PLAIN | IMU, change=reversed_("a_z")),
    "forward, right, down": Foreign(
        names=PLAIN | {"a_x": "ax", "a_y": "ay", "a_z": "az", "gyro_x": "wx", "gyro_y": "wy", "gyro_z": "wz"},
        change=lambda c: in_imu_axes(c, np.diag([1.0, -1.0, -1.0])),
    ),
    "gravity taken out": Foreign(names=PLAIN | IMU, change=lambda c: c | {"a_z": c["a_z"] - G}),
    "compass heading": Foreign(
        names=PLAIN | IMU | {"yaw": "heading_deg"},
        change=lambda c: c | {"yaw": np.mod(90.0 - DEGREES * c["yaw"], 360.0)},
    ),
    "other rates and gaps": Foreign(names=PLAIN | IMU, change=gaps),
    "spikes": Foreign(
        names=PLAIN | IMU,
        change=lambda c: c | {"a_x": np.where(np.arange(len(c["t"])) % 200 == 9, 65535.0, c["a_x"])},
    ),
    "a sensor that is stuck": Foreign(
        names=PLAIN | IMU,
        change=lambda c: c | {"pitch_rate": np.where(c["t"] > 9.0, 0.0123, c["pitch_rate"])},
    ),
    "no IMU but one gyro": Foreign(names=PLAIN | {"yaw_rate": "gyro_z"}),
    "two recordings in one file": Foreign(
        names=PLAIN | IMU, text=lambda text: text + "\n".join(text.splitlines()[1:200]) + "\n"
    ),
}


#: Run by make check: each has a sibling that is always run.
SLOWER = {
    "time in us", "tabs", "comments and a title before the header", "UTF-16", "rows cut off",
    "rows without time",
    "gravity taken out", "speed of the rim", "lateral and yaw reversed", "units in the heading",
    "two recordings in one file", "latitude and longitude", "stamps stand twice", "gravity reversed",
}  # fmt: skip


EVERY_WAY = [
    pytest.param(way, id=name, marks=[pytest.mark.check] if name in SLOWER else [])
    for name, way in WAYS.items()
]


@pytest.mark.parametrize("way", EVERY_WAY)
def test_however_a_drive_is_written_the_lines_make_it_the_same_drive(way, tmp_path):
    log = mended(write(tmp_path, way))
    names = [name for name in ("steer", "omega_r", "a_x", "a_y", "yaw_rate") if name in log.channels]
    assert_is_the_drive(log, names=names)
    assert not quality(log).problems


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
    assert check_description(settings) == []
    path = write(tmp_path, Foreign(names=PLAIN | IMU))
    settings.write_text(log_template(vehicle, "clay"))
    assert not [r for r in check_description(settings) if r.severity == "problem"]
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
        ("units.a_x: __import__('os')", "acceleration"), ("columns.ignore: 3", "list"),
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
