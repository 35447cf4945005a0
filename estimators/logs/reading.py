"""From files to logs: whatever is missing, impossible or misspelt is refused in one sentence."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from estimators.logs import bags
from estimators.logs.config import LogConfig, StartSpec
from estimators.logs.config_parsing import parse_config
from estimators.logs.csv_tables import numbers_of, parse_csv
from estimators.logs.description_files import find_description
from estimators.logs.file_keys import FileKeys, parse_file_keys
from estimators.logs.log import Log
from estimators.logs.mounting import IMU_CHANNELS, at_even_rate, turned
from estimators.logs.parquet import read_parquet
from estimators.logs.raw import derived
from estimators.logs.row_order import blanked, check_time, named_columns, ordered, shortened
from estimators.logs.schema import (
    DATA_ENDINGS,
    DRIVE,
    RAW_COLUMNS,
    REFERENCE,
    RIG_COLUMNS,
    VEHICLE_INPUTS,
    Column,
    nearest,
)
from estimators.logs.tables import MOST_LOG, Table
from estimators.logs.unit_conversion import Conversion, conversion
from estimators.logs.yaml_sections import Section
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.files import MOST_TEXT, open_file, read_file
from offroad_env.world.yaml_text import parse_yaml

__all__ = [
    "assemble",
    "check_path",
    "parse_description",
    "read_described",
    "read_log",
    "read_logs",
    "read_table",
]

_ABOUT = "vehicle, soil, terrain, IMU and start"
_RIG_RESULTS = ("drawbar", "side_force", "torque", "sinkage")
#: A drive is commanded by a steering angle, or shows it in the speeds of its sides.
_STEERED = ("steer",)
#: Of these an IMU has at least one.
_SENSED = ("a_x", "a_y", "yaw_rate", "gyro_x", "gyro_y", "gyro_z")
_DRIVEN = (*DRIVE, *(name for name in RAW_COLUMNS if name.startswith(("omega", "torque"))))
#: A stamp later than this counts from an epoch, not from the start of the log [s].
_EPOCH = 1e7
#: Most rows that an even rate may make of one, besides these.
_MOST_RESAMPLED, _ALWAYS_RESAMPLED = 30, 100_000


def read_log(path: str | PathLike[str]) -> Log:
    """Read one run: a CSV or Parquet file, or a ROS bag, with the YAML of the same name beside it.

    Parameters
    ----------
    path
        ``run.csv``, ``run.parquet``, ``run.mcap``, a ROS 1 bag ``run.bag`` or the folder of a ROS 2 bag.

    Returns
    -------
    Log
        In SI units and the axes of the vehicle, as the YAML states those of the file; ``ref_*`` columns apart
        from the channels.

    Raises
    ------
    DataError
        One sentence with file, column and row (CSV: the line; Parquet: the row from 1), or with
        file, line and key of the YAML.
    """
    path = Path(path)
    check_path(path)
    settings = find_description(path)
    return read_described(path, read_file(settings, most=MOST_TEXT), str(settings))


def read_described(path: Path, description: bytes, file: str) -> Log:
    """Read one run with the content of its YAML, whose name is ``file``.

    Raises
    ------
    DataError
        As `read_log`.
    """
    top = parse_description(description, file)
    keys = parse_file_keys(top)
    table, digest = read_table(path, top, keys)
    digest.update(b"\0" + description)
    return assemble(table, top, keys, path.stem, digest.hexdigest())


def parse_description(description: bytes, file: str) -> Section:
    """The YAML's top mapping.

    Raises
    ------
    DataError
        For what is no YAML, with the line.
    """
    try:
        text = description.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{file}: is not UTF-8 text") from None
    return Section(*parse_yaml(text, file, about=_ABOUT, dotted=True), file)


def read_table(path: Path, top: Section, keys: FileKeys) -> tuple[Table, bags.Digest]:
    """Columns of the file under its own names, and the hash of its content.

    Raises
    ------
    DataError
        With file, column and row.
    """
    if bags.is_bag(path):
        return bags.read_bag(path, bags.parse_topics(top), keys.time)
    with open_file(path, most=MOST_LOG) as file:
        digest = bags.add_file(hashlib.sha256(), file)
        file.seek(0)
        if path.suffix.lower() == ".parquet":
            return read_parquet(file, str(path), numbers_of, keys.unread), digest
        return parse_csv(file, str(path), keys.csv, unread=keys.unread, time=keys.time_column), digest


def read_logs(paths: Iterable[str | PathLike[str]]) -> list[Log]:
    """Read several runs of one vehicle, or several files of trials of one rig.

    Raises
    ------
    DataError
        As `read_log`; also for no file, the same run twice (evidence would count double), or
        vehicle and rig logs mixed.
    """
    logs: list[Log] = []
    seen: dict[str, Path] = {}
    for path in map(Path, paths):
        log = read_log(path)
        if log.hash in seen:
            raise DataError(f"{path}: is the same run as {seen[log.hash]}: give each run once")
        if logs and log.rig != logs[0].rig:
            kinds = {True: "a wheel-rig log", False: "a vehicle log"}
            first = next(iter(seen.values()))
            raise DataError(f"{path}: is {kinds[log.rig]}, but {first} is {kinds[logs[0].rig]}")
        seen[log.hash] = path
        logs.append(log)
    if not logs:
        raise DataError("no log was given")
    return logs


# ------------------------------------------------------------------ files


def check_path(path: Path) -> None:
    """Refuse what cannot be the data of a log.

    Raises
    ------
    DataError
    """
    if not path.exists():
        folder = path.parent
        others = [p.name for p in folder.iterdir() if p.suffix in DATA_ENDINGS] if folder.is_dir() else []
        near = nearest(path.name, others)
        hint = f" - did you mean {near!r}?" if near else ""
        raise DataError(f"{path}: there is no such file{hint}")
    if path.is_dir():
        if not bags.is_ros2_bag(path):
            raise DataError(f"{path}: is a folder, and no ROS 2 bag (it holds no metadata.yaml)")
        return
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        raise DataError(f"{path}: is the description of a log: give the CSV, Parquet or bag file beside it")
    if suffix not in DATA_ENDINGS:
        raise DataError(
            f"{path}: a log is named .csv, .parquet, .bag or .mcap, got {suffix or 'no ending'!r}"
        )


# ------------------------------------------------------------------ columns


def assemble(table: Table, top: Section, keys: FileKeys, name: str, digest: str) -> Log:
    """Check columns and description against each other and make the log.

    Raises
    ------
    DataError
        As `read_log`.
    """
    named = named_columns(table, keys)
    rig = _is_rig(named)
    known = RIG_COLUMNS if rig else VEHICLE_INPUTS
    _check_names(named, known, rig)
    config = parse_config(top, rig=rig)
    named = ordered(named, keys.time)
    channels, references = _converted(named, known, config, keys, top)
    t = channels.pop("t", None)
    if t is None:
        _check_loads(named, channels)
    else:
        check_time(named, t)
        channels = blanked(named, t, channels, keys.blank)
        t, silences = shortened(t)
        channels, notes = derived(named, t, channels, config.vehicle)
        config = replace(config, notes=notes, silences=silences)
        if "torque_total" not in named.columns:  # its shares are stated, not measured
            config = _with_drive_share(config, channels, top)
        t, channels, references = _mounted(t, channels, references, config, named.file)
        _check_drive(named, channels, config)
        config = _started(config, channels)
    for values in (*channels.values(), *references.values(), *(() if t is None else (t,))):
        values.flags.writeable = False
    return Log(name=name, t=t, channels=channels, references=references, config=config, hash=digest)


def _converted(
    table: Table, known: Mapping[str, Column], config: LogConfig, keys: FileKeys, top: Section
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(channels, references) in SI, with the signs of a log; impossible values are refused."""
    conversions = _conversions(table, known, config, top)
    for column in keys.signs:
        if column not in table.columns:
            raise top.error(f"signs.{column}: the log has no such column", f"signs.{column}")
    channels: dict[str, np.ndarray] = {}
    references: dict[str, np.ndarray] = {}
    for column, values in table.columns.items():
        with np.errstate(over="ignore"):  # infinity is refused below, with its row
            if (found := conversions.get(column)) is not None:
                values = values * found.factor + found.shift
            if column in keys.signs:
                values = keys.signs[column] * values
        if column.startswith(REFERENCE):
            references[column] = values
        else:
            _check_values(table, known[column], values)
            channels[column] = values
    return channels, references


def _mounted(
    t: np.ndarray,
    channels: dict[str, np.ndarray],
    references: dict[str, np.ndarray],
    config: LogConfig,
    file: str,
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Time from about zero, and the IMU in the axes of the vehicle and at the rate that the YAML asks for."""
    if abs(t[0]) > _EPOCH:
        t = t - t[0]
    imu = config.imu
    if imu is None:
        return t, channels, references
    if imu.orientation is not None:
        channels = turned(channels, imu.orientation)
    if imu.rate is not None and any(name in channels for name in IMU_CHANNELS):
        rows = (t[-1] - t[0]) * imu.rate
        if rows > _MOST_RESAMPLED * len(t) + _ALWAYS_RESAMPLED:
            raise DataError(
                f"{file}: imu.rate {imu.rate:g} Hz would make {rows:.3g} rows of {len(t)}: another unit of t?"
            )
        t, both = at_even_rate(t, {**channels, **references}, imu.rate)
        channels, references = ({name: both[name] for name in part} for part in (channels, references))
    return t, channels, references


def _started(config: LogConfig, channels: Mapping[str, np.ndarray]) -> LogConfig:
    """The description with a start from the first samples, where it asks for one."""
    if not config.start_from_data or config.vehicle is None:
        return config
    first = {name: float(values[~np.isnan(values)][0]) for name, values in channels.items()}
    rims = [config.vehicle.r * first[name] for name in ("omega_r", "omega_f") if name in first]
    speed = next((first[name] for name in ("v_x", "speed") if name in first), rims[0] if rims else 0.0)
    course = first.get("course", 0.0)
    if "v_x" not in first and rims and max(rims) < -0.5 * abs(speed):
        # A speed over ground has no sign, and its course is opposite to the heading of a drive in reverse.
        speed, course = -abs(speed), course + math.pi
    start = StartSpec(
        x=first.get("x", 0.0),
        y=first.get("y", 0.0),
        yaw=first.get("yaw", course),
        v_x=speed,
    )
    return replace(config, start=start)


def _check_loads(table: Table, channels: Mapping[str, np.ndarray]) -> None:
    load = channels["load"]
    if not (load[~np.isnan(load)] > 0.0).all():
        first = int(np.argmax(load <= 0.0))
        raise table.error(f"a wheel load is positive, got {load[first]:g} N", column="load", index=first)


def _is_rig(table: Table) -> bool:
    names = set(table.columns)
    rig, vehicle = names & set(RIG_COLUMNS), names & set(VEHICLE_INPUTS)
    if rig and vehicle:
        raise table.error(
            f"mixes columns of a wheel rig ({', '.join(sorted(rig))}) and of a vehicle "
            f"({', '.join(sorted(vehicle))})"
        )
    if not rig and not vehicle:
        raise table.error(
            "has none of the columns of a log (t, steer, a_x, ... or slip, load, ...), only "
            + ", ".join(repr(name) for name in list(table.columns)[:6])
        )
    return bool(rig) and not vehicle


def _check_names(table: Table, known: Mapping[str, Column], rig: bool) -> None:
    names = [name for name in table.columns if not name.startswith(REFERENCE)]
    unknown = [name for name in names if name not in known]
    for wanted in ("slip", "load") if rig else ("t", *_STEERED):
        given = names if wanted != "steer" or "omega_left" not in names else [*names, "steer"]
        if wanted not in given:
            near = next((name for name in unknown if nearest(name, [wanted])), None)
            hint = f" - is it {near!r}? Then columns: {{{wanted}: {near}}} in the YAML" if near else ""
            if wanted == "t":
                hint = hint or " - columns.t: 100 Hz in the YAML numbers the rows at a rate"
            raise table.error(f"the column is missing{hint}", column=wanted)
    if unknown:
        near = nearest(unknown[0], known)
        hint = (
            f"did you mean {near!r}?" if near else f"name it {REFERENCE}{unknown[0]} to keep it for looking"
        )
        raise table.error(
            f"a log has no such column - {hint} (or list it under columns.ignore in the YAML)",
            column=unknown[0],
        )
    if not rig and not set(_SENSED) & set(names):
        raise table.error("the column is missing, and so are a_y and yaw_rate: no IMU at all", column="a_x")
    group, title = (_RIG_RESULTS, "results") if rig else (_DRIVEN, "drive inputs")
    if not set(group) & set(names):
        shown = _RIG_RESULTS if rig else DRIVE
        raise table.error(f"needs one of the columns {', '.join(shown)} ({title}), has none")


def _conversions(
    table: Table, known: Mapping[str, Column], config: LogConfig, top: Section
) -> dict[str, Conversion]:
    """How each column named under ``units`` is converted; SI columns stay bit for bit."""
    found = {}
    for column, unit in config.units:
        if column not in table.columns:
            near = nearest(column, table.columns)
            hint = f" - did you mean {near!r}?" if near else ""
            raise top.error(f"units.{column}: the log has no such column{hint}", f"units.{column}")
        plain = column.removeprefix(REFERENCE)
        if plain not in known:
            raise top.error(f"units.{column}: reference columns stay as they are", f"units.{column}")
        try:
            own = conversion(unit, known[plain])
        except InvalidParameter as error:
            raise top.error(f"units.{column} {error}", f"units.{column}") from None
        if own.over_radius and config.vehicle is not None:
            own = own._replace(factor=own.factor / config.vehicle.r)
        if own.factor != 1.0 or own.shift != 0.0:
            found[column] = own
    return found


def _check_values(table: Table, column: Column, values: np.ndarray) -> None:
    name = column.name
    missing = np.isnan(values)
    if missing.all():
        raise table.error("holds no number at all: fill it, or leave the column out", column=name)
    infinite = np.isinf(values)
    if infinite.any():
        i = int(np.argmax(infinite))
        raise table.error(
            "the value is infinite: leave the cell empty where there is no sample", column=name, index=i
        )
    beyond = np.abs(np.where(missing, 0.0, values)) > column.limit
    if beyond.any():
        i = int(np.argmax(beyond))
        likely = f" - {column.mistake}? Name the unit under units in the YAML" if column.mistake else ""
        unit = "" if column.unit == "-" else f" {column.unit}"
        raise table.error(f"{values[i]:g}{unit} is impossible{likely}", column=name, index=i)


def _check_drive(table: Table, channels: dict[str, np.ndarray], config: LogConfig) -> None:
    own = {"force": ("drive_force",), "torque": ("torque_f", "torque_r")}[config.drivetrain]
    if not set(own) & set(channels) and not {"omega_f", "omega_r"} & set(channels):
        raise table.error(
            f"drivetrain: {config.drivetrain} needs {' or '.join(own)}, or wheel speeds, and has none",
            column=own[0],
        )


def _with_drive_share(config: LogConfig, channels: dict[str, np.ndarray], top: Section) -> LogConfig:
    """The front share of the measured torque, where the YAML does not name it."""
    both = "torque_f" in channels and "torque_r" in channels
    vehicle = config.vehicle
    if vehicle is None or not both or top.given("vehicle.drive_front"):
        return config
    front, rear = (float(np.nansum(np.abs(channels[name]))) for name in ("torque_f", "torque_r"))
    if front + rear <= 0.0:
        return config
    share = front / (front + rear)
    brake = vehicle.brake_front if top.given("vehicle.brake_front") else share
    return replace(config, vehicle=vehicle._replace(drive_front=share, brake_front=brake))
