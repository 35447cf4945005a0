"""Reference rows of a log's YAML and columns: key, unit, allowed values, default, meaning."""

from __future__ import annotations

from estimators.logs.config import RIGID_KEYS, SOIL_KEYS, UNKNOWN
from estimators.logs.schema import RAW_COLUMNS, RIG_COLUMNS, VEHICLE_COLUMNS, Column
from offroad_env.world.schema import KeyRow

__all__ = ["LOG_ABOUT", "column_rows", "log_rows"]

LOG_ABOUT = (
    "The YAML of a log ([logs.md](logs.md)). A dotted line (`imu.rate: 100 Hz`) sets one value of a "
    "section and may "
    "stand at the end of the file."
)

_ROWS = (
    KeyRow("model", "-", "full, paper", "needed", "the model of the vehicle"),
    KeyRow(
        "drivetrain",
        "-",
        "torque, force",
        "needed",
        "what the inputs are: torque at the wheels, or body force",
    ),
    KeyRow("structure", "-", "as `structure`", "full", "laws of the wheels"),
    KeyRow("slip", "-", "in (-1, 1)", "0", "constant slip of the model paper"),
    KeyRow("vehicle", "-", "keys of `vehicle`, a name, a file", "needed", "the vehicle"),
    KeyRow(
        "soil",
        "-",
        f"a name, a file, {', '.join(SOIL_KEYS)}, or {', '.join(RIGID_KEYS)}",
        "needed",
        "prior of the soil",
    ),
    KeyRow("terrain.kind", "-", "flat, unknown, paper, waves", "needed", "the ground"),
    KeyRow("terrain.rms", "m", "in (0, 2]", "needed", "standard deviation of the height, for kind unknown"),
    KeyRow("terrain.H0", "m", "in [-2, 2]", "needed", "greatest height, for kind paper"),
    KeyRow(
        "terrain.waves",
        "m, rad/m, rad",
        "[amplitude, p, q, phase], ...",
        "needed",
        "for kind waves; also plane",
    ),
    KeyRow(
        "imu.kinematic", "-", "true, false", "needed", "whether gravity is taken out of the accelerations"
    ),
    KeyRow(
        "imu.position",
        "m",
        "3 numbers in [-10, 10]",
        "[0, 0, 0]",
        "from the centre of gravity: forward, left, up",
    ),
    KeyRow(
        "imu.orientation", "-", "{forward: -y, left: x}, {yaw: 90 deg}", "as the vehicle", "how it is mounted"
    ),
    KeyRow("imu.rate", "Hz", "in [1, 1000]", "as sampled", "even rate to which its samples are brought"),
    KeyRow("imu.sd.a", "m/s^2", "in (0, 50]", "needed", "noise of an acceleration sample"),
    KeyRow("imu.sd.rate", "rad/s", "in (0, 5]", "needed", "noise of a rate sample"),
    KeyRow("gnss.sd.position", "m", "in (0, 100]", "no receiver", "noise of x and y"),
    KeyRow("gnss.sd.speed", "m/s", "in (0, 20]", "not stated", "noise of the speed"),
    KeyRow("inputs.hold", "-", "zoh, linear", "zoh", "how a command goes on to the next"),
    KeyRow(
        "start",
        "-",
        "log; or x, y, yaw, v_x; or state",
        "needed",
        "how the run begins; log: the first samples",
    ),
    KeyRow(
        "tolerances",
        "-",
        "usual, none",
        "usual",
        "whether numbers of vehicle and soil are known to tolerances only, and the soil scatters",
    ),
    KeyRow("unknown", "-", ", ".join(UNKNOWN), "none", "what nobody has measured: a diagnosis fits it"),
    KeyRow(
        "columns",
        "-",
        "column: name, [names], number",
        "the same names",
        "the file's names of the columns below",
    ),
    KeyRow("columns.ignore", "-", "names, others", "none", "columns of the file that are not read"),
    KeyRow("units", "-", "column: unit", "as below", "units of the file, with a factor: 0.0625 deg"),
    KeyRow("signs", "-", "column: 1, -1", "1", "what a column is multiplied by besides its unit"),
    KeyRow("blank", "s", "column: [[from, to]], all", "none", "samples that are none"),
    KeyRow("time.order", "-", "refuse, sort, longest", "refuse", "stamps that go back"),
    KeyRow("time.repeated", "-", "refuse, merge", "refuse", "rows of one stamp"),
    KeyRow("time.missing", "-", "refuse, drop", "refuse", "rows without a stamp"),
    KeyRow("csv.separator", "-", '"," ";" "\\t" " " "|"', '","', "between columns"),
    KeyRow("csv.decimal", "-", '"." ","', '"."', "in numbers"),
    KeyRow("csv.skip", "-", "in 0 ... 10000", "0", "lines before the header"),
    KeyRow("csv.units_row", "-", "true, false", "false", "whether the row after the header holds units"),
    KeyRow("csv.comment", "-", "text", "none", "lines that begin with it are no rows"),
    KeyRow("csv.missing", "-", "texts", "none", "cells that are no sample, besides empty ones"),
    KeyRow("csv.encoding", "-", "utf-8, latin-1, utf-16, ...", "utf-8", "of the text"),
    KeyRow("csv.incomplete", "-", "refuse, drop", "refuse", "rows of another width"),
    KeyRow(
        "topics",
        "-",
        "column: /topic field, imu: /topic, odometry: /topic",
        "needed",
        "of a bag or MCAP file",
    ),
    KeyRow("clock", "-", "header, bag", "header", "stamps of a bag or MCAP file"),
    KeyRow("wheel", "m", "r, b", "needed", "of a wheel rig"),
)


def log_rows() -> list[KeyRow]:
    """Keys of the YAML."""
    return list(_ROWS)


def _row(column: Column, kind: str) -> KeyRow:
    return KeyRow(column.name, column.unit, f"to {column.limit:.4g}", kind, column.meaning)


def column_rows() -> list[KeyRow]:
    """Columns of a log, with what a file may have in their place, and those of a wheel rig."""
    tables = ((VEHICLE_COLUMNS, "drive"), (RAW_COLUMNS, "in place of others"), (RIG_COLUMNS, "wheel rig"))
    return [_row(column, kind) for table, kind in tables for column in table.values()]
