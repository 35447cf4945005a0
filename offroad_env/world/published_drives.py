"""The drives of the data set ``f1tenth_indoor`` from the files that its authors publish.

They publish one table for each topic of a drive: commands, IMU, odometry, speed and pose of a particle
filter, each
with stamps of its own. A drive here is one table with a row for every sample of the IMU: commands and
speeds held from
the sample before, the pose straight between its samples, headings as published. Rows begin and end where
all have samples. Headings state the units that the authors state.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np

from offroad_env.errors import DataError

__all__ = ["DRIVES", "TABLES", "is_drive", "join_drive"]

#: Tables of a drive, by what they hold.
TABLES = {
    "command": "commandData.csv",
    "imu": "imuData.csv",
    "odometry": "odomData.csv",
    "filter": "pfOdomData.csv",
    "pose": "pfPoseData.csv",
}
#: Drive -> (rows, means of the magnitudes of its columns to five digits), from the published tables of
#: commit 6a1b907.
DRIVES: Mapping[str, tuple[int, tuple[float, ...]]] = {
    "DS1": (
        1422,
        (
            21.525,
            2.2779,
            0.18988,
            2.5372,
            2.535,
            4.1679,
            4.2054,
            14.383,
            11.733,
            12.279,
            63.807,
            0.42103,
            0.29826,
            0.96949,
        ),
    ),
    "DS2": (
        4647,
        (
            69.79,
            1.604,
            0.13119,
            1.6755,
            1.6678,
            10.879,
            4.0812,
            12.053,
            5.7252,
            5.4317,
            35.52,
            0.16655,
            0.15482,
            0.99972,
        ),
    ),
    "DS3": (
        2732,
        (
            64.756,
            4.2531,
            0.14181,
            1.1764,
            1.1764,
            9.6708,
            28.477,
            3.7374,
            4.5075,
            4.4837,
            29.945,
            0.10653,
            0.073036,
            1.0014,
        ),
    ),
}

_HEADING = (
    "t_s", "cmd_speed_m_s", "cmd_steer_rad", "vesc_speed_m_s", "pf_speed_m_s", "pf_x_m", "pf_y_m",
    "pf_yaw_rad",
    "gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s", "acc_x_m_s2", "acc_y_m_s2", "acc_z_m_s2",
)  # fmt: skip
_NEEDED = {
    "command": ("V", "delta"),
    "imu": ("wx", "wy", "wz", "ax", "ay", "az"),
    "odometry": ("vx",),
    "filter": ("vx",),
    "pose": ("x", "y", "q.z", "q.w"),
}
#: Agreement of a mean with the registered one: five digits.
_TOLERANCE = 2e-4


def join_drive(tables: Mapping[str, str]) -> str:
    """One CSV of the tables of a drive.

    Parameters
    ----------
    tables
        Key of `TABLES` -> text of the published file.

    Raises
    ------
    DataError
        If a table has not the published columns, or they have no time in common.
    """
    read = {name: _table(name, text) for name, text in tables.items()}
    begin, end = (pick(t[i] for t, _ in read.values()) for pick, i in ((max, 0), (min, -1)))
    stamps, imu = read["imu"]
    inside = (stamps >= begin) & (stamps <= end)
    if not inside.any():
        raise DataError("f1tenth_indoor: the tables of the drive have no time in common")
    t = stamps[inside]
    pose_t, pose = read["pose"]
    yaw = np.unwrap(2.0 * np.arctan2(pose["q.z"], pose["q.w"]))
    columns = [
        t - t[0],
        *(_held(*read["command"], name, t) for name in ("V", "delta")),
        _held(*read["odometry"], "vx", t),
        _held(*read["filter"], "vx", t),
        *(np.interp(t, pose_t, values) for values in (pose["x"], pose["y"], yaw)),
        *(imu[name][inside] for name in ("wx", "wy", "wz", "ax", "ay", "az")),
    ]
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.column_stack(columns).tolist()]
    return "\n".join([",".join(_HEADING), *rows]) + "\n"


def _table(name: str, text: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Stamps [s] and columns of a published file."""
    rows = list(csv.reader(io.StringIO(text)))
    head = {column: i for i, column in enumerate(rows[0])} if rows else {}
    missing = [column for column in ("s", "ns", *_NEEDED[name]) if column not in head]
    if missing or len(rows) < 3:
        raise DataError(f"f1tenth_indoor: {TABLES[name]} has no column {', '.join(missing) or '(no rows)'}")
    try:
        values = np.array(
            [[float(row[head[c]]) for c in ("s", "ns", *_NEEDED[name])] for row in rows[1:] if row]
        )
    except (ValueError, IndexError):
        raise DataError(f"f1tenth_indoor: {TABLES[name]} holds a row that is no row of numbers") from None
    return values[:, 0] + 1e-9 * values[:, 1], dict(zip(_NEEDED[name], values[:, 2:].T, strict=True))


def _held(stamps: np.ndarray, columns: Mapping[str, np.ndarray], name: str, t: np.ndarray) -> np.ndarray:
    """A column at the times ``t``, held from its last sample."""
    return np.asarray(columns[name][np.searchsorted(stamps, t, side="right") - 1])


def is_drive(name: str, text: str) -> bool:
    """Whether a joined table is the registered drive of this name (``DS1``), by its rows and means."""
    rows, means = DRIVES[name]
    lines = text.splitlines()
    if len(lines) != rows + 1 or tuple(lines[0].split(",")) != _HEADING:
        return False
    try:
        values = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    except ValueError:
        return False
    found = np.abs(values).mean(axis=0)
    return bool(np.allclose(found, means, rtol=_TOLERANCE, atol=1e-9))
