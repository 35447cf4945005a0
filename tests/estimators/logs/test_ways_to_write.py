"""However a drive is written, the lines of its check make it the same drive."""

from __future__ import annotations

import numpy as np
import pytest
from foreign_logs import RADIUS, Foreign, G, in_imu_axes, write

from estimators.logs import quality
from mended_logs import (
    DEGREES,
    IMU,
    PLAIN,
    assert_is_the_drive,
    mended,
)


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
