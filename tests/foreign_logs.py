"""Drives as other people's loggers write them: one motion, many ways to put it into a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

__all__ = ["DESCRIPTION", "Foreign", "drive", "write"]

G = 9.80665
WHEELBASE, RADIUS, TRACK = 2.72, 0.33, 1.22
DESCRIPTION = """\
model: full
drivetrain: torque
vehicle: {base: mrzr, r: 0.33}
soil: {base: dry_sand}
terrain: {kind: flat}
imu: {kinematic: false, sd: {a: 0.05, rate: 0.003}}
gnss: {sd: {position: 0.02, speed: 0.02}}
start: log
"""


def drive(seconds: float = 16.0, rate: float = 50.0, seed: int = 3) -> dict[str, np.ndarray]:
    """Channels of a log in SI: a vehicle without slip that weaves, accelerates and brakes."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    steer = 0.16 * np.sin(0.9 * t) + 0.05 * np.sin(2.1 * t)
    v = 3.5 + 1.2 * np.sin(0.7 * t + 0.4)
    yaw_rate = v * np.tan(steer) / WHEELBASE
    yaw = 0.3 + np.concatenate([[0.0], np.cumsum(0.5 * (yaw_rate[1:] + yaw_rate[:-1]) / rate)])
    step = np.concatenate([[0.0], 0.5 * (v[1:] + v[:-1]) / rate])
    x, y = (40.0 + np.cumsum(step * turn(yaw)) for turn in (np.cos, np.sin))
    torque = 400.0 + 300.0 * np.cos(0.7 * t + 0.4)
    noise = {name: rng.standard_normal(len(t)) for name in ("a", "b", "c", "d", "e", "f", "w")}
    pitch_rate = 0.01 * np.sin(3.0 * t)
    return {
        "t": t, "steer": steer, "torque_f": torque, "torque_r": torque, "v_x": v + 0.02 * noise["w"],
        "omega_f": v / RADIUS * 1.02, "omega_r": v / RADIUS * 1.01,
        "omega_left": (v - 0.5 * TRACK * yaw_rate) / RADIUS,
        "omega_right": (v + 0.5 * TRACK * yaw_rate) / RADIUS,
        "a_x": np.gradient(v, t) + 0.05 * noise["a"], "a_y": v * yaw_rate + 0.05 * noise["b"],
        "a_z": G + 0.05 * noise["c"], "roll_rate": 0.01 * np.cos(2.0 * t) + 0.003 * noise["d"],
        "pitch_rate": pitch_rate + 0.003 * noise["e"], "yaw_rate": yaw_rate + 0.003 * noise["f"],
        "yaw": yaw, "x": x, "y": y,
    }  # fmt: skip


@dataclass(kw_only=True)
class Foreign:
    """A way to write a file: names of the columns, and what is done to the numbers before."""

    names: Mapping[str, str] = field(default_factory=dict)  #: log's name -> file's name; others are left out
    change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]] = lambda channels: channels
    text: Callable[[str], str | bytes] = lambda text: text  #: what is done to the finished text
    extra: Mapping[str, str] = field(default_factory=dict)  #: further columns, the same cell in every row
    digits: int = 9


def in_imu_axes(channels: dict[str, np.ndarray], axes: np.ndarray) -> dict[str, np.ndarray]:
    """The channels of an IMU whose x, y, z axes are the columns of ``axes`` (in forward, left, up)."""
    a = axes.T @ np.stack([channels[f"a_{axis}"] for axis in "xyz"])
    w = axes.T @ np.stack([channels["roll_rate"], -channels["pitch_rate"], channels["yaw_rate"]])
    made = dict(channels)
    made |= dict(zip(("a_x", "a_y", "a_z"), a, strict=True))
    return made | {
        "roll_rate": w[0],
        "pitch_rate": -w[1],
        "yaw_rate": w[2],
        "gyro_x": w[0],
        "gyro_y": w[1],
        "gyro_z": w[2],
    }


def write(folder: Path, way: Foreign, channels: dict[str, np.ndarray] | None = None) -> Path:
    """The CSV and its YAML; returns the CSV."""
    made = way.change(drive() if channels is None else channels)
    columns = {file: made[log] for log, file in way.names.items()}
    rows = [",".join([*columns, *way.extra])]
    for values in zip(*columns.values(), strict=True):
        cells = ["" if math.isnan(value) else f"{value:.{way.digits}g}" for value in values]
        rows.append(",".join([*cells, *way.extra.values()]))
    content = way.text("\n".join(rows) + "\n")
    path = folder / "run.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "run.yaml").write_text(DESCRIPTION)
    return path
