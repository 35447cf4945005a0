"""Columns under the names of a log, and rows in the order of time."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from estimators.logs.file_keys import FileKeys, Source, TimeKeys
from estimators.logs.schema import nearest
from estimators.logs.tables import Table

__all__ = ["blanked", "check_time", "named_columns", "ordered", "shortened"]

#: Steps between rows that a vehicle log can have [s]; outside, time is in another unit.
_STEP_RANGE = (1e-5, 1.0)
#: A clock of the day, or of the week, begins anew after so long [s], within this share of it: a minute and a
#: half of a day.
_PERIODS, _NEAR = (86_400.0, 604_800.0), 1e-3
#: A silence is longer than so many usual steps, and than this [s]; it counts for this time at most [s], and
#: all of them together for this share of the rest or this time [s].
_SILENT_STEPS, _SILENT, _LONGEST_SILENCE, _SILENT_SHARE, _SILENT_ROOM = 10.0, 1.0, 30.0, 10.0, 300.0


def named_columns(table: Table, keys: FileKeys) -> Table:
    """The table with the columns that the YAML names, under the names of a log.

    Raises
    ------
    DataError
        If the file has no column of a name that the YAML gives.
    """
    used = {name for source in keys.columns.values() for name in source.names}
    columns = {
        target: _column(table, target, source, len(table.rows)) for target, source in keys.columns.items()
    }
    for name, values in table.columns.items():
        if name in used or (keys.ignore is not None and name in keys.ignore):
            continue
        if name in columns:
            continue  # what the YAML maps goes before a column that happens to have the name
        columns[name] = values
    if "t" in columns:
        columns["t"] = _without_wraps(columns["t"])
    order = [name for name in ("t",) if name in columns]
    return Table(
        file=table.file,
        columns={name: columns[name] for name in (*order, *(n for n in columns if n not in order))},
        rows=table.rows,
    )


def _column(table: Table, target: str, source: Source, count: int) -> np.ndarray:
    if source.rate is not None:
        return np.arange(count) / source.rate
    if source.constant is not None:
        return np.full(count, source.constant)
    for name in source.names:
        if name not in table.columns:
            near = nearest(name, table.columns)
            hint = f" - did you mean {near!r}?" if near else f"; it has {_some(table)}"
            raise table.error(
                f"columns.{target} of the YAML names it, but the file has no such column{hint}", column=name
            )
    parts = [table.columns[name] for name in source.names]
    if target == "t" and len(parts) == 2:
        seconds, nanoseconds = parts
        whole = np.floor(seconds[np.isfinite(seconds)][0]) if np.isfinite(seconds).any() else 0.0
        return np.asarray((seconds - whole) + 1e-9 * nanoseconds)
    return parts[0] if len(parts) == 1 else np.asarray(np.mean(parts, axis=0))


def _without_wraps(t: np.ndarray) -> np.ndarray:
    """Stamps in any unit that begin anew at midnight, or with the week of a receiver, as they go on."""
    known = np.flatnonzero(np.isfinite(t))
    stamps = t[known]
    before, after = stamps[:-1], stamps[1:]
    for period in (length * unit for length in _PERIODS for unit in (1.0, 1e3, 1e6, 1e9)):
        wraps = (
            (before > (1.0 - _NEAR) * period) & (before <= period) & (after >= 0.0) & (after < _NEAR * period)
        )
        if wraps.any():
            result = t.copy()
            result[known[1:]] += period * np.cumsum(wraps)
            return result
    return t


def _some(table: Table) -> str:
    names = [repr(name) for name in table.columns]
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")


def ordered(table: Table, time: TimeKeys) -> Table:
    """The rows in the order of time, as far as the YAML allows to change them."""
    t = table.columns.get("t")
    if t is None:
        return table
    rows = np.arange(len(t))
    if time.missing == "drop":
        rows = rows[~np.isnan(t)]
    if time.order == "longest" and len(rows):
        pieces = np.split(rows, np.flatnonzero(np.diff(t[rows]) < 0.0) + 1)
        rows = max(pieces, key=len)
    if time.order == "sort" and not np.isnan(t[rows]).any():
        rows = rows[np.argsort(t[rows], kind="stable")]
    if len(rows) == len(t) and (len(rows) < 2 or (np.diff(rows) == 1).all()):
        return _merged(table) if time.repeated == "merge" and len(rows) else table
    taken = Table(
        file=table.file,
        columns={name: values[rows] for name, values in table.columns.items()},
        rows=table.rows[rows],
    )
    return _merged(taken) if time.repeated == "merge" and len(rows) else taken


def _merged(table: Table) -> Table:
    """Rows of one stamp as one row; every column keeps its first sample."""
    t = table.columns["t"]
    first = np.concatenate([[True], np.diff(t) != 0.0])
    if first.all():
        return table
    group = np.cumsum(first) - 1
    columns = {}
    for name, values in table.columns.items():
        column = np.full(int(group[-1]) + 1, math.nan)
        present = np.flatnonzero(~np.isnan(values))[::-1]  # so that the first one is written last
        column[group[present]] = values[present]
        columns[name] = column
    return Table(file=table.file, columns=columns, rows=table.rows[first])


def check_time(table: Table, t: np.ndarray) -> None:
    """Refuse stamps that are missing, do not increase, or are in another unit.

    Raises
    ------
    DataError
        With the row, and the key of the YAML by which such a file is read.
    """
    missing = np.isnan(t)
    if missing.any():
        index = int(np.argmax(missing))
        raise table.error(
            "a row without time (time.missing: drop leaves such rows out)", column="t", index=index
        )
    if len(t) < 2:
        raise table.error("is one row only: a run needs at least two", column="t", index=0)
    step = np.diff(t)
    if not (step > 0.0).all():
        i = int(np.argmax(step <= 0.0)) + 1
        twice = t[i] == t[i - 1]
        how = "stands twice" if twice else f"follows {t[i - 1]:g} s"
        mend = "time.repeated: merge joins such rows" if twice else "time.order: sort orders the rows"
        raise table.error(f"time must increase, but {t[i]:g} s {how} ({mend})", column="t", index=i)
    low, high = _STEP_RANGE
    typical = float(np.median(step))
    if not low <= typical < high:
        unit = "another unit (ms, us, ns)" if typical >= high else "another unit (min)"
        raise table.error(
            f"rows are {typical:g} s apart: {unit} given as s? Name it under units in the YAML",
            column="t",
            index=1,
        )


def shortened(t: np.ndarray) -> tuple[np.ndarray, tuple[tuple[float, float], ...]]:
    """The stamps with long silences cut short, and (where [s], true length [s]) of each.

    Nothing is known of a silence, and nobody drives on for days: a clock that was set while the log ran makes
    one of years. What is computed from a log takes time and room by the second, so silences count no more
    than the samples between them allow; the parts before and after are used.
    """
    step = np.diff(t)
    typical = float(np.median(step))
    silent = step > max(_SILENT_STEPS * typical, _SILENT)
    if not silent.any():
        return t, ()
    room = max(_SILENT_SHARE * float(step[~silent].sum()), _SILENT_ROOM)
    longest = max(min(_LONGEST_SILENCE, room / int(silent.sum())), _SILENT_STEPS * typical)
    cut = silent & (step > longest)
    if not cut.any():
        return t, ()
    kept = t.copy()
    kept[1:] -= np.cumsum(np.where(cut, step - longest, 0.0))
    return kept, tuple((float(kept[i]), float(step[i])) for i in np.flatnonzero(cut))


def blanked(
    table: Table,
    t: np.ndarray,
    channels: Mapping[str, np.ndarray],
    spans: Mapping[str, tuple[tuple[float, float], ...]],
) -> dict[str, np.ndarray]:
    """The channels without the samples inside the ``spans`` [s]; one without any sample left is left out.

    Raises
    ------
    DataError
        For a span of a channel that the log does not have.
    """
    result = dict(channels)
    start = t[0] if abs(t[0]) > 1e7 else 0.0
    for name, own in spans.items():
        if name not in result:
            raise table.error("blank of the YAML names it, but the log has no such column", column=name)
        inside = np.any([(t - start >= low) & (t - start <= high) for low, high in own], axis=0)
        result[name] = np.where(inside, math.nan, result[name])
        if np.isnan(result[name]).all():
            del result[name]
    return result
