"""Findings about the numbers of single columns: stamps, empty columns, values that no vehicle has."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estimators.logs import bags
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.checking.naming import named_unit
from estimators.logs.file_keys import FileKeys, parse_file_keys
from estimators.logs.reading import parse_description, read_table
from estimators.logs.row_order import named_columns
from estimators.logs.schema import RIG_COLUMNS, UNITS, VEHICLE_INPUTS, Column, plain_unit
from estimators.logs.tables import Table
from estimators.logs.unit_conversion import Conversion, conversion
from offroad_env.errors import InvalidParameter

__all__ = ["STEERING_WHEELS", "table_remarks"]

#: Step between rows that a log usually has [s]: of several units that which comes closest to it.
_USUAL_STEP, _STEPS = 0.01, (1e-4, 0.5)
#: A clock that goes back further than this began anew [s].
_RESTART = 1.0
#: Share of impossible values up to which they are single errors of a sound channel, and the most that are
#: listed.
_SINGLE, _MOST_SPANS = 0.02, 40
#: A steering angle beyond this is that of the steering wheel [deg]; usual ratio of a steering gear.
_ROAD_WHEEL = 60.0
#: By the unit of a steering wheel's angle: that of the road wheels with a usual ratio of a steering gear.
STEERING_WHEELS = {"deg": "0.0625 deg", "rad": "0.0625 rad"}


def table_remarks(path: Path, text: str, file: str) -> list[Remark]:
    """Stamps and values, column by column.

    Raises
    ------
    DataError
        If the file cannot be read even so.
    """
    top = parse_description(text.encode(), file)
    stated: Any = top.peek("units")
    units = {str(k): v for k, v in stated.items() if isinstance(v, str)} if isinstance(stated, dict) else {}
    keys = parse_file_keys(top)
    table, _ = read_table(path, top, keys)
    named = named_columns(table, keys)
    if "slip" in named.columns:
        return []
    remarks = [] if bags.is_bag(path) or "t" not in named.columns else _time_remarks(named, keys, units)
    for name, values in named.columns.items():
        if name == "t" or name not in VEHICLE_INPUTS or name in RIG_COLUMNS:
            continue
        if np.isnan(values).all():
            remarks.append(_empty(name, keys))
            continue
        unit = units.get(name) or _unit_of_name(keys, VEHICLE_INPUTS[name])
        remarks += _value_remarks(named, VEHICLE_INPUTS[name], values, unit, keys)
    return remarks


def _unit_of_name(keys: FileKeys, column: Column) -> str | None:
    """The unit that the file's own name of a column states, where it is the log's own."""
    source = keys.columns.get(column.name)
    found = {named_unit(name)[1] for name in source.names} if source is not None else set()
    unit = found.pop() if len(found) == 1 else None
    return unit if unit and plain_unit(unit) == plain_unit(column.unit) else None


def _empty(name: str, keys: FileKeys) -> Remark:
    sentence = f"{name} holds no number at all"
    if name in keys.columns:
        return Remark(severity="problem", sentence=f"{sentence}: leave columns.{name} out of the YAML")
    value = [*(keys.ignore or ()), name]
    return Remark(severity="problem", sentence=sentence, lines=(Line("columns.ignore", value),))


# ------------------------------------------------------------------ time


def _time_remarks(table: Table, keys: FileKeys, units: Mapping[str, str]) -> list[Remark]:
    t, remarks = table.columns["t"], []
    missing = int(np.isnan(t).sum())
    if missing == len(t):
        return [Remark(severity="problem", sentence="no row has a time: a rate helps (columns.t: 100 Hz)")]
    if missing and keys.time.missing == "refuse":
        sentence = f"{missing} rows have no time, the first in row {table.rows[int(np.argmax(np.isnan(t)))]}"
        remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line("time.missing", "drop"),)))
    unit, factor = _time_unit(t[~np.isnan(t)], units.get("t"))
    if unit is not None:
        step = float(np.median(np.abs(np.diff(t[~np.isnan(t)]))))
        sentence = f"rows are {step:g} apart in t: it is in {unit}"
        remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line("units.t", unit),)))
    return remarks + _order_remarks(table, t[~np.isnan(t)] * factor, keys)


def _time_unit(t: np.ndarray, stated: str | None) -> tuple[str | None, float]:
    """(unit of the stamps if it has to be named, its factor)."""
    column = VEHICLE_INPUTS["t"]
    steps = np.abs(np.diff(t))
    steps = steps[steps > 0.0]
    factor = 1.0
    if stated is not None:
        try:
            factor = conversion(stated, column).factor
        except InvalidParameter:
            factor = 1.0
    if not len(steps):
        return None, factor
    typical = float(np.median(steps))
    if _STEPS[0] <= typical * factor <= _STEPS[1]:
        return None, factor
    fits = {name: abs(math.log(typical * scale / _USUAL_STEP)) for name, scale in UNITS["time"].items()}
    best = min(fits, key=fits.__getitem__)
    scale = UNITS["time"][best]
    return (best, scale) if _STEPS[0] <= typical * scale <= _STEPS[1] else (None, factor)


def _order_remarks(table: Table, t: np.ndarray, keys: FileKeys) -> list[Remark]:
    """Stamps that go back or stand twice; ``t`` [s] in the order of the file."""
    remarks, steps = [], np.diff(t)
    back = np.flatnonzero(steps < 0.0)
    if len(back) and keys.time.order == "refuse":
        far = -float(steps[back].min())
        where = f"time goes back {len(back)} times, by {far:.3g} s at most, first after {_shown(t[back[0]])}"
        if far > _RESTART and len(back) <= 20:
            sentence = f"{where}: several recordings, or a clock that was set; the longest stretch is kept"
            value = "longest"
            pieces = np.split(t, back + 1)
            t = max(pieces, key=len)
        else:
            sentence, value = f"{where}: rows are not in the order of time", "sort"
            t = np.sort(t)
        remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line("time.order", value),)))
    elif keys.time.order != "refuse":
        t = np.sort(t)
    twice = int((np.diff(t) == 0.0).sum())
    if twice and keys.time.repeated == "refuse":
        sentence = f"{twice} rows have the stamp of the row before: each column keeps its first sample"
        remarks.append(Remark(severity="problem", sentence=sentence, lines=(Line("time.repeated", "merge"),)))
    return remarks


def _shown(t: float) -> str:
    return f"t = {t:.6g} s"


# ------------------------------------------------------------------ values


def _value_remarks(
    table: Table, column: Column, values: np.ndarray, unit: str | None, keys: FileKeys
) -> list[Remark]:
    """Infinite values, and values beyond what any vehicle has, in the unit that the YAML states."""
    name = column.name
    try:
        own = Conversion(1.0) if unit is None else conversion(unit, column)
    except InvalidParameter as error:
        return [Remark(severity="problem", sentence=f"units.{name} {error}")]
    infinite = np.isinf(values)
    if infinite.any():
        sentence = f"{name} is infinite in {int(infinite.sum())} rows: no sample"
        value = [*keys.csv.missing, "inf", "-inf"]
        return [Remark(severity="problem", sentence=sentence, lines=(Line("csv.missing", value),))]
    size = np.abs(values * own.factor)
    finite = ~np.isnan(size)
    beyond = finite & (size > column.limit)
    if not beyond.any():
        return []
    if beyond.sum() <= _SINGLE * finite.sum() and "t" in table.columns:
        return _spikes(table, column, beyond, float(size[beyond].max()), keys)
    return [_unit_by_size(column, values[finite], unit)]


def _spikes(table: Table, column: Column, beyond: np.ndarray, largest: float, keys: FileKeys) -> list[Remark]:
    """Single impossible values as samples that are none; spans in the time of the log."""
    t = table.columns["t"]
    rows = np.flatnonzero(beyond & ~np.isnan(t))[:_MOST_SPANS]
    sentence = (
        f"{column.name} reads {largest:.3g} {column.unit}, which is impossible, in {int(beyond.sum())} "
        "rows, the "
        f"first in row {table.rows[int(np.argmax(beyond))]}: errors of the sensor"
    )
    return [
        Remark(
            severity="problem",
            sentence=sentence,
            lines=(Line("csv.missing", sorted({*keys.csv.missing, *_cells(table, column.name, rows)})),),
        )
    ]


def _cells(table: Table, name: str, rows: np.ndarray) -> list[str]:
    return [f"{value:.15g}" for value in table.columns[name][rows]]


def _unit_by_size(column: Column, values: np.ndarray, stated: str | None) -> Remark:
    """The unit in which the values of a whole column are possible."""
    name, largest = column.name, float(np.quantile(np.abs(values), 0.999))
    sentence = f"{name} reaches {largest:.4g}, which no vehicle does in {stated or column.unit}"
    if name == "steer" and (largest > _ROAD_WHEEL or stated is not None):
        # A unit that the file states is not another one: what is too large is another angle.
        unit = "rad" if stated is not None and plain_unit(stated) == "rad" else "deg"
        return Remark(
            severity="problem",
            sentence=f"{sentence}: the angle of the steering wheel in {unit}? The line divides it by 16: put "
            "your own ratio there",
            lines=(Line("units.steer", STEERING_WHEELS[unit]),),
        )
    for unit in _smaller_units(column):
        factor = conversion(unit, column).factor
        if largest * abs(factor) <= column.limit and factor < 1.0:
            return Remark(
                severity="problem",
                sentence=f"{sentence}: it is in {unit}",
                lines=(Line(f"units.{name}", unit),),
            )
    likely = f" ({column.mistake})" if column.mistake else ""
    return Remark(severity="problem", sentence=f"{sentence}{likely}: name its unit under units in the YAML")


def _smaller_units(column: Column) -> list[str]:
    """Units that make numbers smaller, the usual ones first."""
    if column.name.startswith("omega"):
        return ["rpm", "deg/s", "mrad/s"]
    return [unit for unit, factor in UNITS[column.dimension].items() if factor < 1.0]
