"""How a CSV file is written: encoding, separator, decimal sign, header, units, cells without a number."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from estimators.logs.checking.mends import Line, Remark
from estimators.logs.csv_tables import PLAIN, THOUSANDS, CsvFormat, text_of
from estimators.logs.tables import NUMBER
from offroad_env.errors import DataError

__all__ = ["Sniffed", "sniff"]

_SEPARATORS = (",", ";", "\t", "|", " ")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
#: ISO 8601 and times of day, and dates in other formats: the reader says of these what they should be.
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ].*|\d{1,2}:\d\d:\d\d.*|\d{1,4}[./-]\d{1,2}[./-]\d{1,4}.*\d:\d\d.*")
#: Numbers that loggers write where there is no sample.
_SENTINELS = ("-999", "-9999", "-99999", "9999", "99999", "-32768", "65535", "-999.0", "-9999.0", "999.99")
#: Rows that are looked at, of each file's beginning and middle.
_ROWS = 100
_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
#: Share of the rows in which a column must be a number to be one.
_MOSTLY = 0.5
_MOST_MARKS = 6
#: A column of text has more words than marks for "no sample", or fewer numbers.
_FEW_WORDS, _FEW_NUMBERS = 3, 3
#: A cell that is this share of its column, at least so large, and so many times all others, is no sample.
_REPEATED, _LARGE, _BEYOND = 0.2, 100.0, 20.0
#: Steps of a clock differ from the usual one by this factor at most, in this share of the rows.
_EVEN, _STEADY = 3.0, 0.9


@dataclass(kw_only=True)
class Sniffed:
    """What was found of a file."""

    form: CsvFormat
    names: list[str] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)  #: from a row of units, by name
    texts: tuple[str, ...] = ()  #: columns that hold text, not numbers
    empty: tuple[str, ...] = ()  #: columns without any cell
    rising: tuple[str, ...] = ()  #: columns that rise by even steps, as a clock does
    remarks: list[Remark] = field(default_factory=list)

    def note(self, sentence: str, key: str, value: object, severity: str = "problem") -> None:
        """Keep a finding about the format."""
        self.remarks.append(Remark(severity=severity, sentence=sentence, lines=(Line(f"csv.{key}", value),)))


def sniff(content: bytes, file: str, stated: CsvFormat = PLAIN) -> Sniffed:
    """The format of a file, with a finding for everything that the YAML does not state.

    Raises
    ------
    DataError
        For what is no text, or has no rows of numbers at all.
    """
    found = Sniffed(form=stated)
    text = _decoded(content, file, found)
    lines = text.splitlines()
    _comments(lines, found)
    kept = [line for i, line in enumerate(lines) if i >= found.form.skip and _is_row(line, found.form)]
    if len(kept) < 2:
        raise DataError(f"{file}: has no row of numbers after its header")
    _separator(kept, found)
    _header(lines, found, file)
    _decimal(lines, found)
    _cells(lines, found, file)
    return found


def _decoded(content: bytes, file: str, found: Sniffed) -> str:
    if content.startswith(_UTF_16) and not found.form.encoding.lower().startswith("utf-16"):
        found.form = replace(found.form, encoding="utf-16")
        found.note(f"{file} is UTF-16 text", "encoding", "utf-16")
    try:
        return text_of(content, file, found.form.encoding)
    except DataError:
        text = text_of(content, file, "latin-1")  # refuses what is no text at all
    control = sum((ord(sign) < 32 and sign not in "\t\r\n") or 127 <= ord(sign) < 160 for sign in text[:4000])
    if control > 0.02 * min(len(text), 4000):
        text_of(content, file, found.form.encoding)  # binary: the refusal stands
    found.form = replace(found.form, encoding="latin-1")
    found.note(f"{file} is not UTF-8 text, but reads as Latin-1", "encoding", "latin-1")
    return text


def _is_row(line: str, form: CsvFormat) -> bool:
    return bool(line.strip()) and not (form.comment and line.lstrip().startswith(form.comment))


def _comments(lines: Sequence[str], found: Sniffed) -> None:
    """Lines that begin with a sign of comments, unless the header itself is the only one."""
    if found.form.comment:
        return
    for sign in ("#", "%", "//"):
        count = sum(line.lstrip().startswith(sign) for line in lines)
        if count and count < len(lines):
            found.form = replace(found.form, comment=sign)
            found.note(f"{count} lines begin with {sign}: comments", "comment", sign)
            return


def _sample(lines: Sequence[str]) -> list[str]:
    """Rows of the beginning without the header's neighbourhood, and of the middle."""
    middle = len(lines) // 2
    return [*lines[min(len(lines) - 1, 10) :][:_ROWS], *lines[middle : middle + _ROWS]]


def _fields(line: str, separator: str) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=separator == " "))
    except (csv.Error, StopIteration):
        return [line]
    return [cell.strip() for cell in row if cell] if separator == " " else [cell.strip() for cell in row]


def _is_number(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell))


def _separator(lines: Sequence[str], found: Sniffed) -> None:
    """The separator that gives most rows one width, and numbers in their cells."""
    best, score = found.form.separator, 0.0
    for separator in _SEPARATORS:
        rows = [_fields(line, separator) for line in _sample(lines)]
        width, count = Counter(map(len, rows)).most_common(1)[0]
        cells = [cell for row in rows if len(row) == width for cell in row]
        good = sum(_is_number(cell) or bool(_DECIMAL_COMMA.fullmatch(cell)) or not cell for cell in cells)
        value = count / len(rows) * good / max(len(cells), 1) * min(width - 1, 3)
        if width > 1 and value > 1.02 * score:
            best, score = separator, value
    if best != found.form.separator:
        found.form = replace(found.form, separator=best)
        found.note(f"columns are separated by {_WORDS[best]}", "separator", best)


def _header(lines: Sequence[str], found: Sniffed, file: str) -> None:
    """The header: the first row of the usual width that holds names, and a row of units after it."""
    form = found.form
    rows = [(i, _fields(line, form.separator)) for i, line in enumerate(lines) if _is_row(line, form)]
    width = Counter(len(row) for _, row in rows[len(rows) // 2 :]).most_common(1)[0][0]
    wide = [(i, row) for i, row in rows if i >= form.skip and abs(len(row) - width) <= 1]
    if not wide:
        raise DataError(f"{file}: no row has the width of the others: is this a table?")
    start, header = wide[0]
    if all(_is_number(cell) or _DECIMAL_COMMA.fullmatch(cell) for cell in header if cell):
        raise DataError(
            f"{file}, row {start + 1}: holds numbers: the first row must name the columns (t, steer, "
            "...). No line "
            "of the YAML can: write the names into the file"
        )
    if start > form.skip and any(_is_row(line, form) for line in lines[form.skip : start]):
        found.form = form = replace(form, skip=start)
        found.note(f"the header is line {start + 1}: {start} lines stand before it", "skip", start)
    found.names = [name.strip() or f"column {i}" for i, name in enumerate(header, start=1)]
    if len(wide) > 2 and not form.units_row:
        second, third = wide[1][1], wide[2][1]
        numbers = sum(map(_is_number, second))
        if numbers == 0 and any(_is_number(cell) or _DECIMAL_COMMA.fullmatch(cell) for cell in third):
            found.form = replace(form, units_row=True)
            found.note("the row after the header holds units, not numbers", "units_row", True)
    if found.form.units_row and len(wide) > 1:
        pairs = zip(found.names, wide[1][1], strict=False)
        found.units = {name: unit.strip("[]() ") for name, unit in pairs if unit.strip("[]() -")}


def _rows(lines: Sequence[str], form: CsvFormat, width: int) -> tuple[list[list[str]], int]:
    """Rows of numbers of the full width, and how many rows have another one."""
    rows = [_fields(line, form.separator) for line in lines[form.skip :] if _is_row(line, form)][
        1 + form.units_row :
    ]
    full = [row for row in rows if len(row) == width]
    return full, len(rows) - len(full)


def _decimal(lines: Sequence[str], found: Sniffed) -> None:
    if found.form.separator == "," or found.form.decimal == ",":
        return
    rows, _ = _rows(lines[: found.form.skip + _ROWS], found.form, len(found.names))
    cells = [cell for row in rows for cell in row if cell]
    commas = sum(bool(_DECIMAL_COMMA.fullmatch(cell)) for cell in cells)
    points = sum(bool(_is_number(cell) and "." in cell) for cell in cells)
    if commas > points:
        found.form = replace(found.form, decimal=",")
        found.note("numbers have a decimal comma", "decimal", ",")


def _cells(lines: Sequence[str], found: Sniffed, file: str) -> None:
    """Rows of another width, columns of text, and marks for missing samples."""
    form, names = found.form, found.names
    rows, others = _rows(lines, form, len(names))
    if not rows:
        raise DataError(f"{file}: no row has the {len(names)} cells of the header")
    if others and form.incomplete == "refuse":
        found.form = form = replace(form, incomplete="drop")
        found.note(f"{others} rows have more or fewer cells than the header", "incomplete", "drop")
    texts, empty, rising, marks = [], [], [], Counter[str]()
    for name, column in zip(names, zip(*rows, strict=True), strict=True):
        cells = [cell.replace(",", ".") if form.decimal == "," else cell for cell in column]
        wrong = Counter(cell for cell in cells if cell and not _is_number(cell) and cell not in form.missing)
        if _rises(cells):
            rising.append(name)
        thousands = next((cell for cell in wrong if THOUSANDS.fullmatch(cell)), None)
        if not any(cells):
            empty.append(name)
        elif thousands is not None:
            found.remarks.append(_separated(name, column[cells.index(thousands)]))
        elif 0 < len(wrong) <= _FEW_WORDS and len(set(filter(_is_number, cells))) >= _FEW_NUMBERS:
            marks += wrong
        elif wrong and sum(wrong.values()) > (1.0 - _MOSTLY) * sum(bool(cell) for cell in cells):
            if not all(_DATE.match(cell) for cell in wrong):
                texts.append(name)
        else:
            marks += wrong
        marks += _sentinels(cells, form)
    found.texts, found.empty, found.rising = tuple(texts), tuple(empty), tuple(rising)
    if marks:
        kept = [mark for mark, _ in marks.most_common(_MOST_MARKS)]
        shown = ", ".join(f"{mark!r} ({marks[mark]})" for mark in kept)
        found.form = replace(form, missing=(*form.missing, *kept))
        found.note(f"cells that are no samples: {shown}", "missing", [*form.missing, *kept])


def _separated(name: str, cell: str) -> Remark:
    sentence = (
        f"column {name!r} has thousands separators ({cell!r}): write its numbers without them; no line of "
        "the YAML can"
    )
    return Remark(severity="problem", sentence=sentence)


def _rises(cells: Sequence[str]) -> bool:
    """Whether a column is a clock by its numbers: it rises by even steps, which no counter of rows has."""
    if len(cells) < _FEW_NUMBERS or not all(_is_number(cell) for cell in cells):
        return False
    values = [float(cell) for cell in cells]
    steps = sorted(after - before for before, after in pairwise(values))
    usual = steps[len(steps) // 2]
    even = sum(usual / _EVEN <= step <= usual * _EVEN for step in steps)
    return usual > 0.0 and not steps[0] == steps[-1] == 1.0 and even >= _STEADY * len(steps)


def _sentinels(cells: Sequence[str], form: CsvFormat) -> Counter[str]:
    """Numbers that stand for "no sample": far beyond all others of their column, more than once."""
    count = Counter(cells)
    found = Counter[str]()
    usual, times = count.most_common(1)[0]
    repeated = _is_number(usual) and times > _REPEATED * len(cells) and abs(float(usual)) > _LARGE
    for mark in dict.fromkeys((*_SENTINELS, *([usual] if repeated else []))):
        if count[mark] < 2 or mark in form.missing:
            continue
        rest = [abs(float(cell)) for cell in cells if _is_number(cell) and cell != mark]
        finite = [value for value in rest if value == value and value not in (float("inf"),)]
        least = 2.0 if mark in _SENTINELS else _BEYOND
        if finite and least * max(finite) < abs(float(mark)):
            found[mark] = count[mark]
    return found
