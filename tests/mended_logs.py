"""Logs that are read with the lines that their check prints, and what a right one is."""

from __future__ import annotations

import numpy as np
from foreign_logs import G, drive, in_imu_axes

from estimators.logs import Log, read_log
from estimators.logs.checking.check import check_log, with_lines

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
