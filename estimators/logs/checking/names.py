"""Findings about the file and the names of its columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from estimators.logs import bags
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.checking.naming import Match, column_of, match_columns, named_unit
from estimators.logs.checking.sniffing import Sniffed, sniff
from estimators.logs.checking.topics import topic_remarks
from estimators.logs.file_keys import AS_IS, FileKeys, parse_file_keys
from estimators.logs.parquet import parquet_names
from estimators.logs.reading import parse_description
from estimators.logs.schema import ALL_COLUMNS, REFERENCE, RIG_COLUMNS, VEHICLE_INPUTS
from estimators.logs.tables import MOST_LOG
from estimators.logs.unit_conversion import conversion
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.files import open_file

__all__ = ["file_names", "log_columns", "name_remarks"]

#: A format is judged by the beginning of a file [bytes].
_SNIFFED = 16_000_000
#: More columns than these are ignored as "others".
_MOST_NAMED = 8
_STEERING_WHEEL = ("wheel", "lenkrad", "volant")


def _keys(text: str) -> FileKeys:
    """Keys about the file as the YAML states them; a YAML that cannot be read states none."""
    try:
        return parse_file_keys(parse_description(text.encode(), ""))
    except DataError:
        return AS_IS


def name_remarks(path: Path, text: str) -> list[Remark]:
    """Format of the file, columns under other names, columns that are none of a log.

    Raises
    ------
    DataError
        For a file that no line of the YAML makes readable.
    """
    if bags.is_bag(path):
        return topic_remarks(path, text)
    keys = _keys(text)
    sniffed = _sniffed(path, keys)
    names = sniffed.names
    if set(names) & set(RIG_COLUMNS) >= {"slip", "load"}:
        return sniffed.remarks
    mapped = {name for source in keys.columns.values() for name in source.names}
    useless = {*sniffed.texts, *sniffed.empty}
    free = [name for name in names if name not in mapped and name not in (keys.ignore or ())]
    open_ = [name for name in free if not name.startswith(REFERENCE) and name not in useless]
    stated = _stated_units(text)
    matches, rest = match_columns(open_, keys.columns)
    remarks = sniffed.remarks + _mapped_units(keys, sniffed, stated) + _matched(matches, sniffed, stated)
    if not any(match.column == "t" for match in matches) and not {"t"} & {*keys.columns, *names}:
        clock = next((name for name in sniffed.rising if name in rest), None)
        if clock is not None:
            remarks.append(_clock(clock, stated))
            rest.remove(clock)
    rest += [name for name in free if name in useless and not name.startswith(REFERENCE)]
    rest = [name for name in names if name in {*rest}]
    if rest and keys.ignore is not None:
        remarks.append(_ignored(rest, keys, useless, sniffed))
    return remarks


def _sniffed(path: Path, keys: FileKeys) -> Sniffed:
    with open_file(path, most=MOST_LOG) as file:
        if path.suffix.lower() == ".parquet":
            return Sniffed(form=keys.csv, names=parquet_names(file, str(path)))
        content = file.read(_SNIFFED)
    if len(content) == _SNIFFED:
        content = content[: content.rfind(b"\n") + 1]  # the last row may be cut off
    return sniff(content, str(path), keys.csv)


def _stated_units(text: str) -> set[str]:
    try:
        units: Any = parse_description(text.encode(), "").peek("units")
    except DataError:
        return set()
    return set(units) if isinstance(units, dict) else set()


def _matched(matches: Iterable[Match], sniffed: Sniffed, stated: set[str]) -> list[Remark]:
    remarks = []
    for match in matches:
        column, lines = match.column, []
        if match.source != column:
            lines.append(Line(f"columns.{column}", match.source))
        unit = match.unit or _row_unit(sniffed.units.get(match.first), column)
        if unit and column not in stated:
            lines.append(Line(f"units.{column}", unit))
        if not lines:
            continue
        meaning = VEHICLE_INPUTS[column].meaning
        sentence = f"column {_quoted(match)} is {column} ({meaning})" + (f", in {unit}" if unit else "")
        if match.others:
            sentence += f"; {', '.join(map(repr, match.others))} could be it, too"
        remarks.append(Remark(severity="problem", sentence=sentence, lines=tuple(lines)))
        words = match.first.lower()
        if column == "steer" and any(word in words for word in _STEERING_WHEEL) and "road" not in words:
            remarks.append(_steering_wheel(match.first))
    return remarks


def _mapped_units(keys: FileKeys, sniffed: Sniffed, stated: set[str]) -> list[Remark]:
    """Units that the file's own names state of the columns that the YAML maps."""
    remarks = []
    for column, source in keys.columns.items():
        units = {_own_unit(name, column, sniffed) for name in source.names}
        unit = units.pop() if len(units) == 1 and column in ALL_COLUMNS else None
        if unit is not None and column not in stated:
            sentence = f"column {', '.join(map(repr, source.names))} is {column}, in {unit}"
            line = Line(f"units.{column}", unit)
            remarks.append(Remark(severity="problem", sentence=sentence, lines=(line,)))
    return remarks


def _own_unit(name: str, column: str, sniffed: Sniffed) -> str | None:
    unit = named_unit(name)[1] or sniffed.units.get(name)
    return _row_unit("ms" if column == "t" and unit == "m/s" else unit, column)


def _clock(name: str, stated: set[str]) -> Remark:
    unit = None if "t" in stated else _own_unit(name, "t", Sniffed(form=AS_IS.csv))
    return Remark(
        severity="problem",
        sentence=f"no column is named as a time; {name!r} rises by even steps: is it t?",
        lines=(Line("columns.t", name), *([Line("units.t", unit)] if unit else [])),
    )


def _quoted(match: Match) -> str:
    return repr(match.source) if isinstance(match.source, str) else " and ".join(map(repr, match.source))


def _steering_wheel(name: str) -> Remark:
    return Remark(
        severity="warning",
        sentence=(
            f"{name!r} may be the angle of the steering wheel: then divide by the steering ratio in "
            "units.steer, as "
            "0.0625 deg for 16 to 1"
        ),
    )


def _row_unit(unit: str | None, column: str) -> str | None:
    """The unit of a row of units, unless it is the log's own or none of the column."""
    if not unit:
        return None
    try:
        found = conversion(unit, ALL_COLUMNS[column])
    except InvalidParameter:
        return None
    return unit if found.factor != 1.0 or found.over_radius else None


def _ignored(rest: Sequence[str], keys: FileKeys, useless: set[str], sniffed: Sniffed) -> Remark:
    names = [*(keys.ignore or ()), *rest]
    value: Any = names if len(names) <= _MOST_NAMED else "others"
    shown = ", ".join(map(repr, rest[:6])) + (f" and {len(rest) - 6} more" if len(rest) > 6 else "")
    why = "is no column of a log" if len(rest) == 1 else "are no columns of a log"
    texts = [name for name in rest if name in sniffed.texts and (column_of(name) or name in ALL_COLUMNS)]
    if texts:
        why += f" ({', '.join(map(repr, texts))} holds text)"
    known = [name for name in rest if name in ALL_COLUMNS]
    if value == "others" and known:  # the key leaves out unknown names only
        value = names
    if known:
        why += f" ({', '.join(known)} without a number)"
    return Remark(severity="problem", sentence=f"{shown} {why}", lines=(Line("columns.ignore", value),))


def file_names(path: Path, text: str) -> list[str]:
    """The file's own names of its columns, as the YAML lets it be read; none of a bag.

    Raises
    ------
    DataError
        As `name_remarks`.
    """
    return [] if bags.is_bag(path) else _sniffed(path, _keys(text)).names


def log_columns(path: Path, names: Sequence[str], text: str) -> list[str]:
    """Columns of a log that a file with these ``names`` has once the YAML is applied; raw ones included."""
    keys = _keys(text)
    if bags.is_bag(path):
        topics = bags.parse_topics(parse_description(text.encode(), ""))
        return [source.column for source in topics.sources]
    return [*keys.columns, *(name for name in names if name in VEHICLE_INPUTS)]
