"""Habits of other people's loggers: each is read right, or named as what it is."""

from __future__ import annotations

import math

import numpy as np
from foreign_logs import Foreign, drive, write

from estimators.logs import read_log
from estimators.logs.checking.check import check_log
from estimators.logs.substitutes import substituted
from mended_logs import IMU, PLAIN

# ------------------------------------------------------------------ driving in reverse


def _reverse(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same speeds backwards: all signs right, the speed over ground without one, no v_x."""
    made = dict(channels)
    for name in ("omega_f", "omega_r", "torque_f", "torque_r", "a_x", "yaw_rate", "v_x"):
        made[name] = -made[name]
    yaw = 0.6 - channels["yaw"]
    step = made["v_x"] * np.gradient(channels["t"])
    made |= {"x": 40.0 + np.cumsum(step * np.cos(yaw)), "y": 40.0 + np.cumsum(step * np.sin(yaw))}
    return made | {"yaw": yaw, "speed": np.abs(made["v_x"]), "course": yaw + math.pi}


_GROUND = {name: name for name in (*PLAIN, *IMU, "speed") if name != "v_x"}


def _with_speed(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return channels | {"speed": np.abs(channels["v_x"])}


def test_a_drive_in_reverse_with_right_signs_gets_no_line(tmp_path):
    report = check_log(write(tmp_path, Foreign(names=_GROUND | {"course": "course"}, change=_reverse)))
    assert report.lines == ()
    assert report.quality is not None
    assert not report.quality.problems


def test_wheels_with_a_reversed_sign_are_still_named(tmp_path):
    def turned(channels: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        made = _with_speed(channels)
        return made | {"omega_r": -made["omega_r"]}

    report = check_log(write(tmp_path, Foreign(names=_GROUND, change=turned)))
    assert "the sign of omega_r is reversed" in " ".join(remark.sentence for remark in report.remarks)


def test_a_log_that_begins_in_reverse_starts_backwards(tmp_path):
    names = {name: name for name in _GROUND if name != "yaw"} | {"course": "course"}
    log = read_log(write(tmp_path, Foreign(names=names, change=_reverse)))
    start = log.config.start
    assert start is not None
    assert start.v_x < -3.0
    assert math.cos(start.yaw - 0.3) > 0.99


def test_a_missing_lateral_acceleration_takes_the_direction_of_the_wheels(tmp_path):
    names = {name: name for name in _GROUND if name != "a_y"}
    way = Foreign(names=names, change=_reverse)
    log, _ = substituted(read_log(write(tmp_path, way)))
    expected = way.change(drive())["a_y"]
    assert np.corrcoef(log.channels["a_y"], expected)[0, 1] > 0.9
