"""Logs that cannot be right, each with what its refusal must say."""

from __future__ import annotations

import copy
import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

__all__ = ["CASES", "DESCRIPTION", "ROWS", "Case", "good_rows", "no_change", "rig", "text_of", "write"]

HEADER = (
    "t", "steer", "torque_f", "torque_r", "omega_f", "omega_r", "a_x", "a_y", "a_z",
    "pitch_rate", "yaw_rate", "x", "ref_yaw",
)  # fmt: skip
ROWS = 40
DESCRIPTION = {
    "model": "full",
    "drivetrain": "torque",
    "vehicle": {
        "m": 1378.0, "I_z": 1787.0, "I_y": 1395.0, "l_f": 1.537, "l_r": 1.183, "k_f": 28029.0,
        "k_r": 88329.0, "c_f": 14287.0, "c_r": 5707.0, "m_w": 68.0, "r": 0.33, "b": 0.212,
        "wheels_per_axle": 2,
    },
    "soil": {
        "k_c": 990.0, "k_phi": 1528430.0, "n": 1.1, "c": 1040.0, "phi": 0.4887, "k_x": 0.025,
        "k_y": 0.025, "a_0": 0.18, "a_1": 0.32, "b_0": -0.1, "b_1": 0.0,
    },
    "terrain": {"kind": "flat"},
    "imu": {"kinematic": True, "position": [0.0, 0.0, 0.0], "sd": {"a": 0.05, "rate": 0.003}},
    "start": {"settled": True, "x": 0.0, "y": 0.0, "yaw": 0.0, "v_x": 4.0},
}  # fmt: skip


def good_rows() -> list[list[str]]:
    """Header and 40 rows of a log that is right."""
    rng = np.random.default_rng(5)
    rows = [list(HEADER)]
    for i in range(ROWS):
        values = [0.1, 300.0, 300.0, 12.5, 12.4, *(0.1 * rng.standard_normal(5)), 0.04 * i, 0.0]
        rows.append([repr(0.01 * i), *(repr(float(value)) for value in values)])
    return rows


def text_of(rows: list[list[str]]) -> str:
    return "\n".join(",".join(row) for row in rows) + "\n"


class Case(NamedTuple):
    """A bad log: what is done to the good one, and what the sentence must hold."""

    name: str
    make: Callable[[Path], None]
    expect: tuple[str, ...]
    file: str = "run.csv"


def write(folder: Path, table: str | bytes, description: object = DESCRIPTION) -> None:
    content = table if isinstance(table, bytes) else table.encode()
    (folder / "run.csv").write_bytes(content)
    text = description if isinstance(description, str) else yaml.safe_dump(description, sort_keys=False)
    (folder / "run.yaml").write_text(text)


def cell(column: str, row: int, value: str) -> Callable[[Path], None]:
    """Put a value into the line ``row`` (the header is line 1)."""

    def make(folder: Path) -> None:
        rows = good_rows()
        rows[row - 1][HEADER.index(column)] = value
        write(folder, text_of(rows))

    return make


def column(name: str, value: Callable[[int, str], str]) -> Callable[[Path], None]:
    """Replace all values of a column."""

    def make(folder: Path) -> None:
        rows = good_rows()
        for i, row in enumerate(rows[1:]):
            row[HEADER.index(name)] = value(i, row[HEADER.index(name)])
        write(folder, text_of(rows))

    return make


def drop(*names: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        keep = [i for i, name in enumerate(HEADER) if name not in names]
        write(folder, text_of([[row[i] for i in keep] for row in good_rows()]))

    return make


def rename(old: str, new: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        rows = good_rows()
        rows[0][HEADER.index(old)] = new
        write(folder, text_of(rows))

    return make


def table(change: Callable[[str], str | bytes]) -> Callable[[Path], None]:
    return lambda folder: write(folder, change(text_of(good_rows())))


def description(*path_and_value: object) -> Callable[[Path], None]:
    """Set a key of the YAML, given by its path; `DROP` removes it."""
    *path, value = path_and_value

    def make(folder: Path) -> None:
        data = copy.deepcopy(DESCRIPTION)
        inner = data
        for key in path[:-1]:
            inner = inner[key]
        if value is DROP:
            del inner[path[-1]]
        else:
            inner[path[-1]] = value
        write(folder, text_of(good_rows()), data)

    return make


DROP = object()


def yaml_text(text: str) -> Callable[[Path], None]:
    return lambda folder: write(folder, text_of(good_rows()), text)


def swapped_rows(text: str) -> str:
    lines = text.split("\n")
    lines[9], lines[24] = lines[24], lines[9]
    return "\n".join(lines)


def zipped(_: str) -> bytes:
    sheet = io.BytesIO()
    with zipfile.ZipFile(sheet, "w") as archive:
        archive.writestr("sheet1.xml", "<xml/>")
    return sheet.getvalue()


def rig(change: Callable[[list[list[str]]], None], **keys: object) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        rows = [["slip", "slip_angle", "load", "drawbar", "sinkage"]]
        rows += [
            [f"{0.1 * i:.1f}", "0.0", "20.0", f"{2.0 * i}", f"{0.015 + 0.003 * i:.3f}"] for i in range(8)
        ]
        change(rows)
        data = {"wheel": {"r": 0.058, "b": 0.05}, "soil": DESCRIPTION["soil"]} | keys
        write(folder, text_of(rows), {k: v for k, v in data.items() if v is not DROP})

    return make


def put(row: int, column_: int, value: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        rows[row - 1][column_] = value

    return change


def no_change(rows: list[list[str]]) -> None:
    """Leave the rig's rows as they are."""


YAML = "run.yaml"

CASES = (
    # the file itself
    Case("empty file", table(lambda text: ""), ("is empty",)),
    Case("blank lines only", table(lambda text: "\n\n  \n"), ("is empty",)),
    Case("header only", table(lambda text: text.split("\n")[0] + "\n"), ("no row of numbers",)),
    Case("one row", table(lambda text: "\n".join(text.split("\n")[:2])), ("'t'", "row 2", "one row")),
    Case("random bytes", table(lambda text: b"\x93\xa7\x00\xff" * 400), ("row 1", "binary")),
    Case("zero bytes inside", table(lambda text: text[:900].encode() + bytes(64)), ("row", "zero byte")),
    Case("Latin-1 degree sign", table(lambda text: text.encode() + b"0.5,3\xb0\n"), ("row 42", "0xb0")),
    Case("UTF-16", table(lambda text: text.encode("utf-16")), ("UTF-16",)),
    Case("gzip", table(lambda text: b"\x1f\x8b\x08\x00" + b"x" * 50), ("gzip",)),
    Case("spreadsheet", table(zipped), ("spreadsheet",)),
    Case("Parquet named csv", table(lambda text: b"PAR1" + b"\0" * 60), ("Parquet",)),
    Case("semicolons", table(lambda text: text.replace(",", ";")), ("row 1", "semicolons")),
    Case("tabs", table(lambda text: text.replace(",", "\t")), ("row 1", "tabs")),
    Case("decimal comma in quotes", cell("a_x", 12, '"0,25"'), ("'a_x'", "row 12", "decimal comma")),
    Case("no header", table(lambda text: text.split("\n", 1)[1]), ("row 1", "name the columns")),
    Case("comment first", table(lambda text: "# logger 3, 7\n" + text), ("row 1", "comment")),
    Case(
        "cut off in a row",
        table(lambda text: text[: text.rindex(",12.4,") + 3]),
        ("'a_x'", "row 41", "cut off"),
    ),
    Case(
        "a cell too many", table(lambda text: text.replace("300.0,", "300.0,0.0,", 1)), ("row 2", "14 values")
    ),
    Case("quote left open", table(lambda text: text.replace("300.0", '"300.0', 1)), ("row",)),
    Case("duplicate column", rename("torque_r", "torque_f"), ("'torque_f'", "two columns")),
    Case("column without a name", rename("x", ""), ("'column 12'", "no such column", "ignore")),
    Case("text in a number column", cell("omega_f", 7, "fast"), ("'omega_f'", "row 7", "'fast'")),
    Case("NA in a number column", cell("a_y", 9, "N/A"), ("'a_y'", "row 9", "empty")),
    Case("error of a spreadsheet", cell("a_z", 30, "#REF!"), ("'a_z'", "row 30", "#REF!")),
    Case("digits with underscore", cell("x", 8, "1_000"), ("'x'", "row 8", "1_000")),
    Case("hexadecimal", cell("torque_f", 8, "0x12C"), ("'torque_f'", "row 8")),
    Case("date as time", column("t", lambda i, _: f"2024-05-01 10:00:{i:02d}"), ("'t'", "1 s apart")),
    Case("infinite value", cell("a_x", 21, "inf"), ("'a_x'", "row 21", "infinite")),
    Case("number beyond double", cell("a_x", 22, "1e999"), ("'a_x'", "row 22", "infinite")),
    # columns
    Case("no time column", drop("t"), ("'t'", "missing")),
    Case("no steering", drop("steer"), ("'steer'", "missing")),
    Case("no IMU", drop("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate"), ("'a_x'", "missing")),
    Case("no drive at all", drop("torque_f", "torque_r", "omega_f", "omega_r"), ("drive_force", "omega_f")),
    Case("misspelt column", rename("steer", "steering"), ("'steer'", "missing", "'steering'")),
    Case("unit in the heading", rename("a_x", "a_x [m/s^2]"), ("'a_x'", "'a_x [m/s^2]'")),
    Case("misspelt optional column", rename("x", "v_xx"), ("'v_xx'", "'v_x'")),
    Case("unknown column", rename("x", "battery"), ("'battery'", "ref_battery")),
    Case("reference columns only", drop(*HEADER[:-1]), ("'ref_yaw'",)),
    Case("other data altogether", table(lambda text: "name,price\nbolt,3\n"), ("'name'", "row 2", "'bolt'")),
    Case("vehicle and rig mixed", rename("x", "sinkage"), ("sinkage", "steer", "mixes")),
    Case("NaN throughout", column("yaw_rate", lambda i, _: "nan"), ("'yaw_rate'", "no number")),
    Case("empty throughout", column("x", lambda i, _: ""), ("'x'", "no number")),
    # time
    Case("shuffled rows", table(swapped_rows), ("'t'", "row 11", "increase")),
    Case("time stands twice", cell("t", 15, "0.12"), ("'t'", "row 15", "twice")),
    Case("clock steps back", cell("t", 20, "-3.0"), ("'t'", "row 20", "increase")),
    Case("row without time", cell("t", 17, ""), ("'t'", "row 17", "without time")),
    Case("time in ms", column("t", lambda i, _: f"{10 * i}"), ("'t'", "10 s apart", "ms")),
    Case("time in ns", column("t", lambda i, _: f"{10_000_000 * i}"), ("'t'", "ns")),
    Case("time in minutes", column("t", lambda i, _: repr(i * 1e-6 / 60.0)), ("'t'", "min")),
    # values that no vehicle has
    Case("steering in degrees", column("steer", lambda i, _: f"{i - 20}.0"), ("'steer'", "row 2", "degrees")),
    Case(
        "raw gyro counts", column("yaw_rate", lambda i, _: f"{1200 + i}"), ("'yaw_rate'", "row 2", "counts")
    ),
    Case("raw accelerometer counts", cell("a_z", 3, "16384"), ("'a_z'", "row 3", "counts")),
    Case("torque of a ship", cell("torque_r", 40, "-3e9"), ("'torque_r'", "row 40", "impossible")),
    # the description: file and syntax
    Case("no YAML", lambda folder: (folder / "run.csv").write_text("t\n1\n"), ("run.yaml", "missing")),
    Case("empty YAML", yaml_text(""), ("empty",), YAML),
    Case("YAML syntax", yaml_text("model: full\nvehicle: {m: 1200\nsoil: {}\n"), ("line", "syntax"), YAML),
    Case("tab in YAML", yaml_text("model: full\nvehicle:\n\tm: 1200\n"), ("line 3", "syntax"), YAML),
    Case("YAML is a list", yaml_text("- model\n- full\n"), ("line 1", "keys"), YAML),
    Case("YAML is one word", yaml_text("full\n"), ("line 1", "'full'"), YAML),
    Case("YAML runs code", yaml_text("model: !!python/object/apply:os.getcwd []\n"), ("line 1",), YAML),
    Case("YAML nested without end", yaml_text("[" * 5000), ("nested",), YAML),
    Case(
        "YAML key twice",
        yaml_text("model: full\nmodel: paper\n"),
        ("run.yaml, line 2: model is given twice", "line 1"),
        YAML,
    ),
    Case("YAML impossible date", yaml_text("model: 2024-13-45\n"), ("cannot be read",), YAML),
    # the description: keys and values
    Case("no vehicle", description("vehicle", DROP), ("vehicle is missing",), YAML),
    Case("no soil", description("soil", DROP), ("soil is missing",), YAML),
    Case("no IMU key", description("imu", DROP), ("imu is missing",), YAML),
    Case("no terrain", description("terrain", DROP), ("terrain is missing",), YAML),
    Case("no start", description("start", DROP), ("start is missing",), YAML),
    Case("no start speed", description("start", "v_x", DROP), ("start.v_x is missing",), YAML),
    Case("no mass", description("vehicle", "m", DROP), ("vehicle.m is missing",), YAML),
    Case(
        "mass without a value", description("vehicle", "m", None), ("line 4", "vehicle.m", "no value"), YAML
    ),
    Case("negative mass", description("vehicle", "m", -1378.0), ("line 4", "vehicle.m", "-1378"), YAML),
    Case("mass in words", description("vehicle", "m", "heavy"), ("line 4", "vehicle.m", "'heavy'"), YAML),
    Case("mass true", description("vehicle", "m", True), ("line 4", "vehicle.m", "True"), YAML),
    Case("mass infinite", description("vehicle", "m", float("inf")), ("line 4", "vehicle.m", "inf"), YAML),
    Case("mass as a list", description("vehicle", "m", [1378.0]), ("line 4", "vehicle.m"), YAML),
    Case("mass in grams", description("vehicle", "m", 1378e6), ("line 4", "vehicle.m"), YAML),
    Case("wheelbase in mm", description("vehicle", "l_f", 1537.0), ("vehicle.l_f", "mm given as m"), YAML),
    Case("stiffness in N/mm", description("vehicle", "k_f", 2.8), ("vehicle.k_f", "N/m"), YAML),
    Case(
        "misspelt vehicle key",
        description("vehicle", "wheels_per_axel", 2),
        ("wheels_per_axel", "'wheels_per_axle'"),
        YAML,
    ),
    Case("misspelt top key", description("vehicel", {}), ("'vehicel'", "'vehicle'"), YAML),
    Case("unknown key", description("weather", "wet"), ("'weather'", "known:"), YAML),
    Case("vehicle is a number", description("vehicle", 3), ("line 3", "vehicle must be", "hold keys"), YAML),
    Case("friction angle in degrees", description("soil", "phi", 28.0), ("soil.phi", "degrees"), YAML),
    Case("cohesion in kPa", description("soil", "c", 4.14), ("soil.c", "kPa"), YAML),
    Case("soil without n", description("soil", "n", DROP), ("soil.n is missing",), YAML),
    Case("no such soil kind", description("soil", {"kind": "ice", "mu": 0.1}), ("soil.kind", "rigid"), YAML),
    Case("rigid without mu", description("soil", {"kind": "rigid", "C_alpha": 9.0}), ("soil.mu",), YAML),
    Case("paper ground without H0", description("terrain", {"kind": "paper"}), ("terrain.H0",), YAML),
    Case("height in mm", description("terrain", {"kind": "paper", "H0": 50}), ("terrain.H0", "mm"), YAML),
    Case("unknown without rms", description("terrain", {"kind": "unknown"}), ("terrain.rms",), YAML),
    Case("grid", description("terrain", {"kind": "grid", "file": "g.npy"}), ("grid", "not supported"), YAML),
    Case("misspelt kind", description("terrain", {"kind": "flatt"}), ("terrain.kind", "flat?"), YAML),
    Case("no such model", description("model", "Paper"), ("model", "'Paper'", "paper?"), YAML),
    Case("kinematic in words", description("imu", "kinematic", "maybe"), ("imu.kinematic", "'maybe'"), YAML),
    Case("noise of zero", description("imu", "sd", {"a": 0.0, "rate": 0.1}), ("imu.sd.a", "0"), YAML),
    Case("no noise", description("imu", "sd", DROP), ("imu.sd is missing",), YAML),
    Case("position of two", description("imu", "position", [0.0, 1.0]), ("imu.position", "3 numbers"), YAML),
    Case("unknown misspelt", description("unknown", ["imu.positon"]), ("unknown", "imu.position?"), YAML),
    Case("unknown in a word", description("unknown", "springs"), ("unknown", "list", "suspension"), YAML),
    Case("hold misspelt", description("inputs", {"hold": "foh"}), ("inputs.hold", "zoh, linear"), YAML),
    Case("slip in per cent", description("slip", 3.0), ("slip", "per cent"), YAML),
    Case("state without speed", description("start", {"state": {"x": 1.0}}), ("start.state.v_x",), YAML),
    Case("topics without a bag", description("topics", {"imu": "/imu"}), ("'topics'",), YAML),
    # units
    Case(
        "unit of something else",
        description("units", {"a_x": "deg"}),
        ("units.a_x", "m/s^2, g", "'deg'"),
        YAML,
    ),
    Case(
        "no such unit", description("units", {"steer": "pints"}), ("units.steer", "rad, deg", "'pints'"), YAML
    ),
    Case(
        "unit of no column", description("units", {"yawrate": "deg/s"}), ("units.yawrate", "'yaw_rate'"), YAML
    ),
    Case("unit is a number", description("units", {"steer": 57.3}), ("units.steer", "57.3"), YAML),
    Case(
        "drive of the other kind", lambda folder: force_with_torque_only(folder), ("'drive_force'", "force")
    ),
    # wheel rigs
    Case("rig without load", rig(lambda rows: [row.pop(2) for row in rows]), ("'load'", "missing")),
    Case(
        "rig without results", rig(lambda rows: [row.__delitem__(slice(3, 5)) for row in rows]), ("drawbar",)
    ),
    Case("rig slip in per cent", rig(put(6, 0, "40")), ("'slip'", "row 6", "per cent")),
    Case("rig angle in degrees", rig(put(4, 1, "15")), ("'slip_angle'", "row 4", "degrees")),
    Case("rig load negative", rig(put(5, 2, "-20")), ("'load'", "row 5", "positive")),
    Case("rig sinkage in mm", rig(put(3, 4, "18.0")), ("'sinkage'", "row 3", "mm")),
    Case("rig without wheel", rig(no_change, wheel=DROP), ("wheel is missing",), YAML),
    Case("rig wheel in mm", rig(no_change, wheel={"r": 58.0, "b": 50.0}), ("wheel.r", "mm"), YAML),
)


def force_with_torque_only(folder: Path) -> None:
    keep = [i for i, name in enumerate(HEADER) if not name.startswith("omega")]
    rows = [[row[i] for i in keep] for row in good_rows()]
    write(folder, text_of(rows), DESCRIPTION | {"drivetrain": "force"})
