"""From files to logs: whatever is missing, impossible or misspelt is refused in one sentence."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from estimators.logs import bags
from estimators.logs.config import LogConfig
from estimators.logs.config_parsing import parse_config
from estimators.logs.log import Log
from estimators.logs.schema import (
    DRIVE,
    IMU,
    REFERENCE,
    RIG_COLUMNS,
    UNITS,
    VEHICLE_COLUMNS,
    Column,
    find_unit,
    nearest,
    unit_factor,
)
from estimators.logs.tables import Table, parse_csv, parse_parquet, read_bytes
from estimators.logs.yaml_sections import Section
from offroad_env.errors import DataError
from offroad_env.world.yaml_text import parse_yaml

__all__ = ["read_log", "read_logs"]

_FORMATS = (".csv", ".parquet", ".bag")
_ABOUT = "vehicle, soil, terrain, IMU and start"
_RIG_RESULTS = ("drawbar", "side_force", "torque", "sinkage")
#: Steps between rows that a vehicle log can have [s]; outside, time is in another unit.
_STEP_RANGE = (1e-5, 1.0)


def read_log(path: str | PathLike[str]) -> Log:
    """Read one run: a CSV or Parquet file, or a ROS bag, with the YAML of the same name beside it.

    Parameters
    ----------
    path
        ``run.csv``, ``run.parquet``, a ROS 1 bag ``run.bag`` or the folder of a ROS 2 bag.

    Returns
    -------
    Log
        In SI units, ``units`` of the YAML applied; ``ref_*`` columns apart from the channels.

    Raises
    ------
    DataError
        One sentence with file, column and row (CSV: the line; Parquet: the row from 1), or with
        file, line and key of the YAML.
    """
    path = Path(path)
    _check_path(path)
    settings = _find_yaml(path)
    file = str(settings)
    digest: bags.Digest
    description = read_bytes(settings)
    try:
        text = description.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{file}: is not UTF-8 text") from None
    if path.is_dir() or path.suffix.lower() == ".bag":
        top = Section(*parse_yaml(text, file, about=_ABOUT), file)
        table, digest = bags.read_bag(path, bags.parse_topics(top))
    else:
        content = read_bytes(path)
        parse = parse_parquet if path.suffix.lower() == ".parquet" else parse_csv
        table = parse(content, str(path))
        digest = hashlib.sha256(content)
        top = Section(*parse_yaml(text, file, about=_ABOUT), file)
    digest.update(b"\0" + description)
    return _assemble(table, top, path.stem, digest.hexdigest())


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


def _check_path(path: Path) -> None:
    if not path.exists():
        folder = path.parent
        others = [p.name for p in folder.iterdir() if p.suffix in _FORMATS] if folder.is_dir() else []
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
    if suffix not in _FORMATS:
        raise DataError(f"{path}: a log is named .csv, .parquet or .bag, got {suffix or 'no ending'!r}")


def _find_yaml(path: Path) -> Path:
    base = path if path.is_dir() else path.with_suffix("")
    candidates = [base.with_name(base.name + ending) for ending in (".yaml", ".yml")]
    present = [candidate for candidate in candidates if candidate.is_file()]
    if len(present) == 2:
        raise DataError(f"{path}: has two descriptions, {present[0].name} and {present[1].name}: keep one")
    if not present:
        raise DataError(
            f"{path}: its description {candidates[0].name} is missing: a log needs a YAML of the same name "
            "(vehicle, soil, terrain, imu, start)"
        )
    return present[0]


# ------------------------------------------------------------------ columns


def _assemble(table: Table, top: Section, name: str, digest: str) -> Log:
    """Check columns and description against each other and make the log."""
    rig = _is_rig(table)
    known = RIG_COLUMNS if rig else VEHICLE_COLUMNS
    _check_names(table, known, rig)
    config = parse_config(top, rig=rig)
    factors = _factors(table, known, config, top)
    channels: dict[str, np.ndarray] = {}
    references: dict[str, np.ndarray] = {}
    for column, values in table.columns.items():
        if column in factors:
            with np.errstate(over="ignore"):  # infinity is refused below, with its row
                values = values * factors[column]
        values.flags.writeable = False
        if column.startswith(REFERENCE):
            references[column] = values
        else:
            _check_values(table, known[column], values)
            channels[column] = values
    t = channels.pop("t", None)
    if t is not None:
        _check_time(table, t)
        _check_drive(table, channels, config)
        config = _with_drive_share(config, channels, top)
    elif not (channels["load"][~np.isnan(channels["load"])] > 0.0).all():
        first = int(np.argmax(channels["load"] <= 0.0))
        raise table.error(
            f"a wheel load is positive, got {channels['load'][first]:g} N", column="load", index=first
        )
    return Log(name=name, t=t, channels=channels, references=references, config=config, hash=digest)


def _is_rig(table: Table) -> bool:
    names = set(table.columns)
    rig, vehicle = names & set(RIG_COLUMNS), names & set(VEHICLE_COLUMNS)
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
    for wanted in ("slip", "load") if rig else ("t", "steer", *IMU):
        if wanted not in names:
            near = next((name for name in unknown if nearest(name, [wanted])), None)
            hint = f" - is it {near!r}?" if near else ""
            raise table.error(f"the column is missing{hint}", column=wanted)
    group, title = (_RIG_RESULTS, "results") if rig else (DRIVE, "drive inputs")
    if not set(group) & set(names):
        raise table.error(f"needs one of the columns {', '.join(group)} ({title}), has none")
    if unknown:
        near = nearest(unknown[0], known)
        hint = (
            f"did you mean {near!r}?" if near else f"name it {REFERENCE}{unknown[0]} to keep it for looking"
        )
        raise table.error(f"a log has no such column - {hint}", column=unknown[0])


def _factors(table: Table, known: Mapping[str, Column], config: LogConfig, top: Section) -> dict[str, float]:
    """What each column named under ``units`` is multiplied by; SI columns stay bit for bit."""
    factors = {}
    for column, unit in config.units:
        if column not in table.columns:
            near = nearest(column, table.columns)
            hint = f" - did you mean {near!r}?" if near else ""
            raise top.error(f"units.{column}: the log has no such column{hint}", f"units.{column}")
        plain = column.removeprefix(REFERENCE)
        if plain not in known:
            raise top.error(f"units.{column}: reference columns stay as they are", f"units.{column}")
        dimension = known[plain].dimension
        found = find_unit(unit, dimension)
        if found is None:
            allowed = ", ".join(UNITS[dimension])
            raise top.error(
                f"units.{column} must be a unit of {dimension} ({allowed}), got {unit!r}", f"units.{column}"
            )
        if (factor := unit_factor(found, dimension)) != 1.0:
            factors[column] = factor
    return factors


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


def _check_time(table: Table, t: np.ndarray) -> None:
    missing = np.isnan(t)
    if missing.any():
        raise table.error("a row without time", column="t", index=int(np.argmax(missing)))
    if len(t) < 2:
        raise table.error("is one row only: a run needs at least two", column="t", index=0)
    step = np.diff(t)
    if not (step > 0.0).all():
        i = int(np.argmax(step <= 0.0)) + 1
        how = "stands twice" if t[i] == t[i - 1] else f"follows {t[i - 1]:g} s"
        raise table.error(f"time must increase, but {t[i]:g} s {how}", column="t", index=i)
    low, high = _STEP_RANGE
    typical = float(np.median(step))
    if not low <= typical < high:
        unit = "another unit (ms, us, ns)" if typical >= high else "another unit (min)"
        raise table.error(
            f"rows are {typical:g} s apart: {unit} given as s? Name it under units in the YAML",
            column="t",
            index=1,
        )


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
