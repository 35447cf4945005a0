"""Keys of a log's YAML about its file: how it is written, what its columns are called, which samples count.

csv: {separator: ";", decimal: ","}      # also skip, units_row, comment, missing, encoding, incomplete
columns:
  a_y: imu/linear_acceleration.y         # the file's name of a column
  omega_f: [wheel_fl, wheel_fr]          # mean of several
  steer: 0.0                             # a constant
  t: [secs, nsecs]                       # seconds and nanoseconds; or "100 Hz": rows at this rate
ignore: [battery, mode]                  # columns that are not read; or "others"
signs: {pitch_rate: -1}                  # what a column is multiplied by besides its unit
blank: {omega_r: [[12.3, 15.1]]}         # samples that are none, from and to [s]; or "all"
time: {order: sort, repeated: merge, missing: drop}
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from estimators.logs.csv_tables import PLAIN, CsvFormat
from estimators.logs.schema import ALL_COLUMNS, REFERENCE, nearest
from estimators.logs.yaml_sections import Section
from offroad_env.world.catalogue import Quantity
from offroad_env.world.yaml_text import shown

__all__ = ["AS_IS", "FileKeys", "Source", "TimeKeys", "parse_file_keys"]

_RATE = re.compile(r"(?P<rate>\d+\.?\d*(?:[eE][-+]?\d+)?)\s*Hz", re.IGNORECASE)
_LINES = Quantity("in 0 ... 10000", 0, 10_000)


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a column comes from: columns of the file, a constant, or a rate of rows."""

    names: tuple[str, ...] = ()  #: mean of these; for t seconds and nanoseconds where there are two
    constant: float | None = None
    rate: float | None = None  #: [Hz]


@dataclass(frozen=True, kw_only=True)
class TimeKeys:
    """What is done with stamps that do not increase."""

    order: str = "refuse"  #: or "sort"; or "longest": only the longest stretch in which time does not go back
    repeated: str = "refuse"  #: or "merge": of equal stamps every column keeps its first sample
    missing: str = "refuse"  #: or "drop": rows without time


@dataclass(frozen=True, kw_only=True)
class FileKeys:
    """All keys about the file."""

    csv: CsvFormat = PLAIN
    columns: Mapping[str, Source]
    ignore: tuple[str, ...] | None  #: names of the file; None: all that are not named
    signs: Mapping[str, float]
    blank: Mapping[str, tuple[tuple[float, float], ...]]
    time: TimeKeys = TimeKeys()

    def unread(self, name: str) -> bool:
        """Whether the file's column of this name is not read."""
        if any(name in source.names for source in self.columns.values()):
            return False
        if self.ignore is not None:
            return name in self.ignore
        return name not in ALL_COLUMNS and not name.startswith(REFERENCE)

    @property
    def time_column(self) -> str:
        """The file's name of the column t."""
        source = self.columns.get("t")
        return source.names[0] if source is not None and source.names else "t"


#: A file as this project writes it.
AS_IS = FileKeys(columns={}, ignore=(), signs={}, blank={})


def parse_file_keys(top: Section) -> FileKeys:
    """Take the keys about the file out of the YAML.

    Raises
    ------
    DataError
        With file, line and key.
    """
    ignore = _ignore(top)
    return FileKeys(
        csv=_csv(top),
        columns=_columns(top),
        ignore=ignore,
        signs=_signs(top),
        blank=_blank(top),
        time=_time(top),
    )


def _csv(top: Section) -> CsvFormat:
    section = top.optional("csv")
    if section is None:
        return PLAIN
    separator = section.take("separator", PLAIN.separator)
    if separator not in (",", ";", "\t", " ", "|"):
        raise section.error(
            f'csv.separator must be ",", ";", "\\t", " " or "|", got {shown(separator)}', "separator"
        )
    decimal = section.choice("decimal", (".", ","), PLAIN.decimal)
    if decimal == separator:
        raise section.error(f"csv.decimal and csv.separator are both {decimal!r}: which is which?", "decimal")
    comment, encoding = (section.take(key, getattr(PLAIN, key)) for key in ("comment", "encoding"))
    if not isinstance(comment, str):
        raise section.error(f"csv.comment must be text such as '#', got {shown(comment)}", "comment")
    try:
        codecs.lookup(encoding)
    except (LookupError, TypeError):
        message = f"csv.encoding must be utf-8, latin-1, cp1252, utf-16 or the like, got {shown(encoding)}"
        raise section.error(message, "encoding") from None
    form = CsvFormat(
        separator=separator,
        decimal=decimal,
        skip=int(section.number("skip", _LINES, 0.0)),
        units_row=section.flag("units_row", False),
        comment=comment,
        missing=tuple(str(mark) for mark in _as_list(section.take("missing", []))),
        encoding=encoding,
        incomplete=section.choice("incomplete", ("refuse", "drop"), "refuse"),
    )
    section.finish()
    return form


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _columns(top: Section) -> dict[str, Source]:
    section = top.optional("columns")
    if section is None:
        return {}
    found = {}
    for key, value in section.rest().items():
        if key == "ignore":
            continue
        if key not in ALL_COLUMNS and not str(key).startswith(REFERENCE):
            near = nearest(str(key), ALL_COLUMNS)
            hint = (
                f"did you mean {near!r}?" if near else "left of the colon stands the name of a log's column"
            )
            raise section.error(f"columns.{key}: a log has no such column - {hint}", str(key))
        found[key] = _source(section, key, value)
    return found


def _source(section: Section, key: str, value: Any) -> Source:
    if isinstance(value, bool) or value is None or value == []:
        raise section.error(f"columns.{key} must be the file's name of the column, got {shown(value)}", key)
    if isinstance(value, (int, float)):
        if key == "t":
            raise section.error(
                "columns.t cannot be a constant: name a column, or a rate such as 100 Hz", key
            )
        return Source(constant=float(value))
    if key == "t" and isinstance(value, str) and (rate := _RATE.fullmatch(value.strip())):
        if not float(rate["rate"]) > 0.0:
            raise section.error(f"columns.t must be a rate > 0 Hz, got {shown(value)}", key)
        return Source(rate=float(rate["rate"]))
    names = _as_list(value)
    if not all(isinstance(name, str) for name in names):
        raise section.error(f"columns.{key} must be names of the file's columns, got {shown(value)}", key)
    if key == "t" and len(names) > 2:
        raise section.error(
            f"columns.t takes one column, or seconds and nanoseconds, got {shown(value)}", key
        )
    return Source(names=tuple(names))


def _ignore(top: Section) -> tuple[str, ...] | None:
    """Names under ``columns.ignore``; None: all that are not named."""
    section = top.peek("columns")
    given = section.get("ignore", []) if isinstance(section, dict) else []
    if given == "others":
        return None
    names = _as_list(given)
    if not all(isinstance(name, str) for name in names):
        message = f"columns.ignore must be a list of the file's columns, or others, got {shown(given)}"
        raise top.error(message, "columns")
    return tuple(names)


def _known(section: Section, key: str) -> None:
    if key not in ALL_COLUMNS:
        near = nearest(str(key), ALL_COLUMNS)
        hint = f" - did you mean {near!r}?" if near else ""
        raise section.error(f"{section.name(str(key))}: a log has no such column{hint}", str(key))


def _signs(top: Section) -> dict[str, float]:
    section = top.optional("signs")
    if section is None:
        return {}
    found = {}
    for key, value in section.rest().items():
        _known(section, key)
        if isinstance(value, bool) or value not in (1, -1):
            raise section.error(f"signs.{key} must be 1 or -1, got {shown(value)}", key)
        found[key] = float(value)
    return found


def _blank(top: Section) -> dict[str, tuple[tuple[float, float], ...]]:
    section = top.optional("blank")
    if section is None:
        return {}
    found = {}
    for key, value in section.rest().items():
        _known(section, key)
        found[key] = _spans(section, key, value)
    return found


def _spans(section: Section, key: str, value: Any) -> tuple[tuple[float, float], ...]:
    if value == "all":
        return ((-float("inf"), float("inf")),)
    rows = value if isinstance(value, list) and all(isinstance(row, list) for row in value) else [value]
    spans = []
    for row in rows:
        numbers = isinstance(row, list) and all(
            isinstance(end, (int, float)) and not isinstance(end, bool) for end in row
        )
        if not numbers or len(row) != 2 or not row[0] <= row[1]:
            raise section.error(
                f"blank.{key} must be a list of [from, to] in seconds, or all, got {shown(value)}", key
            )
        spans.append((float(row[0]), float(row[1])))
    return tuple(spans)


def _time(top: Section) -> TimeKeys:
    section = top.optional("time")
    if section is None:
        return TimeKeys()
    keys = TimeKeys(
        order=section.choice("order", ("refuse", "sort", "longest"), "refuse"),
        repeated=section.choice("repeated", ("refuse", "merge"), "refuse"),
        missing=section.choice("missing", ("refuse", "drop"), "refuse"),
    )
    section.finish()
    return keys
