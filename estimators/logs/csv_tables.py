"""CSV files as columns of numbers, exact, with the line of every value; CSV text of columns."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import BinaryIO

import numpy as np

from estimators.logs.tables import NUMBER, Table
from offroad_env.errors import DataError

__all__ = ["PLAIN", "THOUSANDS", "CsvFormat", "csv_text", "numbers_of", "parse_csv", "text_of"]

_MAGIC = (
    (b"PAR1", "is a Parquet file: name it .parquet"),
    (b"PK\x03\x04", "is a zip archive or spreadsheet: save the sheet as CSV"),
    (b"\x1f\x8b", "is compressed (gzip): unpack it first"),
    (b"#ROSBAG", "is a ROS bag: name it .bag"),
    (b"\x89MCAP", "is an MCAP file: name it .mcap"),
)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_MARKS = ("na", "n/a", "null", "none", "-", "--", "missing")
#: Bytes that could not be decoded.
_NO_TEXT = re.compile("[\udc80-\udcff]")
#: Rows that are turned into numbers at a time, and the longest line of a table [characters].
_PIECE, _LONGEST_LINE = 2_000, 1_000_000
#: A number with separators between thousands and a decimal sign.
THOUSANDS = re.compile(r"[-+]?\d{1,3}([,.' ]\d{3})+[.,]\d+")
_FOREIGN_DATE = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}\D.*\d:\d\d.*")
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:\.\d*)?)")


@dataclass(frozen=True, kw_only=True)
class CsvFormat:
    """How a CSV file is written: the section ``csv`` of the YAML."""

    separator: str = ","  #: between columns; " " stands for any number of spaces
    decimal: str = "."  #: in numbers
    skip: int = 0  #: lines before the header
    units_row: bool = False  #: whether the row after the header holds units
    comment: str = ""  #: lines that begin with this are no rows
    missing: tuple[str, ...] = ()  #: cells that mean "no sample", besides empty ones
    encoding: str = "utf-8"  #: name that Python's codecs know
    incomplete: str = "refuse"  #: rows with too few or too many cells: "refuse" or "drop"


#: The format in which this project writes.
PLAIN = CsvFormat()


def text_of(content: bytes, file: str, encoding: str = "utf-8") -> str:
    """The bytes as text.

    Raises
    ------
    DataError
        One sentence about what they are instead.
    """
    _refuse_magic(content[:8], file, encoding)
    if not content.strip(b"\xef\xbb\xbf \t\r\n"):
        raise DataError(f"{file}: is empty")
    wide = encoding.lower().startswith("utf-16")
    zero = -1 if wide else content.find(b"\0")
    if zero >= 0:
        row = content.count(b"\n", 0, zero) + 1
        raise DataError(f"{file}, row {row}: holds a zero byte: this is no text file (binary, or damaged)")
    try:
        return content.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise _wrong_byte(content[error.start], row, file, encoding) from None
    except UnicodeError as error:
        raise DataError(f"{file}: is not {encoding.upper()} text: {str(error)[:80]}") from None


def _refuse_magic(start: bytes, file: str, encoding: str) -> None:
    """Refuse files of another kind by their first bytes."""
    for magic, sentence in _MAGIC:
        if start.startswith(magic):
            raise DataError(f"{file}: {sentence}")
    if start.startswith(_UTF_16) and not encoding.lower().startswith("utf-16"):
        raise DataError(f"{file}: is UTF-16 text: save it as UTF-8, or add csv.encoding: utf-16 to the YAML")


def parse_csv(
    content: bytes | BinaryIO,
    file: str,
    form: CsvFormat = PLAIN,
    *,
    unread: Callable[[str], bool] | None = None,
    time: str | None = None,
) -> Table:
    """Columns of a CSV file; an empty cell or nan is NaN.

    An open file is read piece by piece: what stays is eight bytes a number.

    Parameters
    ----------
    form
        How the file is written; default: a header, comma, decimal point.
    unread
        Whether the column of this name is left out; its cells may be anything.
    time
        Column in which dates (ISO 8601) and times of day are read as seconds.

    Raises
    ------
    DataError
        One sentence with file, column, row.
    """
    stream = io.BytesIO(content) if isinstance(content, bytes) else content
    names: list[str] = []
    pieces: list[Table] = []
    for names, numbers, cells in _pieces(_lines(stream, file, form), file, form):
        kept = [i for i, row in enumerate(cells) if len(row) == len(names)]
        if len(kept) < len(cells) and form.incomplete != "drop":
            wrong = next(i for i, row in enumerate(cells) if len(row) != len(names))
            _refuse_width(cells[wrong], names, numbers[wrong], file)
        piece = Table(file=file, columns={}, rows=np.array([numbers[i] for i in kept], dtype=np.int64))
        for name, column in zip(names, zip(*(cells[i] for i in kept), strict=True), strict=False):
            if unread is None or not unread(name):
                piece.columns[name] = numbers_of(piece, name, column, form, dates=name == time)
        if kept:
            pieces.append(piece)
    if not names:
        raise DataError(f"{file}: is empty")
    if not pieces:
        raise DataError(f"{file}: has a header but no row of numbers")
    return _joined(pieces)


def _joined(pieces: list[Table]) -> Table:
    """The pieces of a table one below the other; they are used up."""
    table = Table(file=pieces[0].file, columns={}, rows=np.concatenate([piece.rows for piece in pieces]))
    for name in list(pieces[0].columns):
        table.columns[name] = np.concatenate([piece.columns.pop(name) for piece in pieces])
    return table


def _lines(stream: BinaryIO, file: str, form: CsvFormat) -> Iterator[str]:
    """The lines of the text, read as they are asked for; those that are no rows are empty.

    Emptied, not removed: the rows keep their numbers.
    """
    encoding = form.encoding
    wide = encoding.lower().startswith("utf-16")
    _refuse_magic(stream.read(8), file, encoding)
    stream.seek(0)
    # Bytes that are no text become signs that no text has, so that the row can be named.
    codec = "utf-8-sig" if encoding == "utf-8" else encoding
    text = io.TextIOWrapper(stream, encoding=codec, errors="surrogateescape", newline="")
    try:
        number = 0
        while line := text.readline(_LONGEST_LINE):
            number += 1
            if len(line) == _LONGEST_LINE and not line.endswith(("\n", "\r")):
                raise DataError(f"{file}, row {number}: has {_LONGEST_LINE} characters: is this a table?")
            if "\0" in line and not wide:
                raise DataError(
                    f"{file}, row {number}: holds a zero byte: this is no text file (binary, or damaged)"
                )
            if not line.isascii() and (wrong := _NO_TEXT.search(line)):
                raise _wrong_byte(ord(wrong[0]) & 0xFF, number, file, encoding)
            skipped = number <= form.skip or (form.comment and line.lstrip().startswith(form.comment))
            yield "\n" if skipped else line
    except UnicodeError as error:
        raise DataError(f"{file}: is not {encoding.upper()} text: {str(error)[:80]}") from None
    finally:
        with suppress(ValueError):  # the file is closed already where a reader gave up half way
            text.detach()


def _wrong_byte(byte: int, row: int, file: str, encoding: str) -> DataError:
    return DataError(
        f"{file}, row {row}: byte 0x{byte:02x} is not {encoding.upper()} text: a binary "
        "file, or saved in another encoding (csv.encoding: latin-1 in the YAML?)"
    )


def _pieces(
    lines: Iterator[str], file: str, form: CsvFormat
) -> Iterator[tuple[list[str], list[int], list[list[str]]]]:
    """Names of the columns, and some of the rows after them with the numbers of their lines."""
    reader = csv.reader(lines, strict=True, delimiter=form.separator, skipinitialspace=form.separator == " ")
    names: list[str] = []
    numbers: list[int] = []
    rows: list[list[str]] = []
    units = form.units_row
    try:
        for row in reader:
            if form.separator == " ":
                row = [cell for cell in row if cell]
            if not row or (not names and not any(cell.strip() for cell in row)):
                continue
            if not names:
                names = _header(row, file, form)
            elif units:
                units = False
            else:
                rows.append(row)
                numbers.append(reader.line_num)
            if len(rows) == _PIECE:
                yield names, numbers, rows
                numbers, rows = [], []
    except csv.Error as error:
        raise DataError(f"{file}, row {reader.line_num}: not CSV: {error}") from None
    if names:
        yield names, numbers, rows


def _header(row: list[str], file: str, form: CsvFormat) -> list[str]:
    names = [name.strip() for name in row]
    if len(names) == 1 or all(";" in name for name in names):
        for sign, word, key in ((";", "semicolons", ";"), ("\t", "tabs", "\\t"), (" ", "spaces", " ")):
            if sign != form.separator and sign in row[0].strip():
                raise DataError(
                    f"{file}, row 1: columns are separated by {word}: a log has commas between columns and a "
                    f'point in numbers, or csv.separator: "{key}" in its YAML'
                )
    if all(NUMBER.fullmatch(name) for name in names):
        raise DataError(f"{file}, row 1: holds numbers: the first row must name the columns (t, steer, ...)")
    if names[0].startswith("#"):
        raise DataError(
            f"{file}, row 1: is a comment: the first row must name the columns (t, steer, ...), or "
            'csv.comment: "#" must be in the YAML'
        )
    seen: set[str] = set()
    for position, name in enumerate(names, start=1):
        name = names[position - 1] = name or f"column {position}"
        if name in seen:
            raise DataError(f"{file}, column {name!r}, row 1: two columns have this name")
        seen.add(name)
    return names


def _refuse_width(row: Sequence[str], names: Sequence[str], line: int, file: str) -> None:
    likely = "csv.incomplete: drop in the YAML leaves such rows out"
    if len(row) < len(names):
        raise DataError(
            f"{file}, column {names[len(row)]!r}, row {line}: the row ends after {len(row)} of {len(names)} "
            f"values: was the file cut off? ({likely})"
        )
    raise DataError(
        f"{file}, row {line}: has {len(row)} values for {len(names)} columns: a comma inside a number? "
        f"({likely})"
    )


def numbers_of(
    table: Table, name: str, cells: Iterable[str], form: CsvFormat = PLAIN, *, dates: bool = False
) -> np.ndarray:
    """The cells of a column as numbers.

    Raises
    ------
    DataError
        For the first cell that is none, with its row.
    """
    cells = list(cells)
    if form.decimal == ",":
        cells = [cell.replace(",", ".") for cell in cells]
    if form.missing:
        marks = {mark.strip() for mark in form.missing}
        values_of_marks = {float(mark) for mark in marks if NUMBER.fullmatch(mark)}
        cells = ["" if _is_mark(cell.strip(), marks, values_of_marks) else cell for cell in cells]
    try:
        values = [float(cell) if cell else math.nan for cell in cells]
        plain = not any("_" in cell for cell in cells)  # float() takes 1_000 for a number
    except ValueError:
        plain = False
    if plain:
        return np.array(values)
    values = []
    for i, cell in enumerate(cells):
        stripped = cell.strip()
        found = _number(stripped, dates)
        if found is None:
            raise table.error(_not_a_number(stripped), column=name, index=i)
        values.append(found)
    return np.array(values)


def _is_mark(cell: str, marks: set[str], values: set[float]) -> bool:
    """Whether a cell means that there is no sample: as text, or as the number of a mark."""
    return cell in marks or (bool(values) and NUMBER.fullmatch(cell) is not None and float(cell) in values)


def _number(cell: str, dates: bool) -> float | None:
    """The number in a cell, None where it is none; with ``dates`` a date or time of day in seconds."""
    if not cell:
        return math.nan
    if NUMBER.fullmatch(cell):
        return float(cell)
    if not dates:
        return None
    clock = _CLOCK.fullmatch(cell)
    if clock:
        return 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3])
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _not_a_number(cell: str) -> str:
    shown = cell if len(cell) <= 24 else cell[:21] + "..."
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        return f'{shown!r} has a decimal comma: a log has a decimal point, or csv.decimal: "," in its YAML'
    if THOUSANDS.fullmatch(cell):
        return f"{shown!r} has a thousands separator: write the number without it"
    if _FOREIGN_DATE.fullmatch(cell):
        return (
            f"{cell[:30]!r} is a date in another format than ISO 8601 (2024-06-10T23:59:45.250): write it so"
        )
    if cell.lower() in _MARKS:
        return (
            f"{shown!r} is not a number: leave the cell empty where there is no sample, or name it under "
            "csv.missing in the YAML"
        )
    return f"{shown!r} is not a number"


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    """CSV text of the columns. Floats are written with as many digits as reading them back exactly needs."""
    written = [["" if math.isnan(v) else repr(v) for v in values.tolist()] for values in columns.values()]
    lines = [",".join(columns), *map(",".join, zip(*written, strict=True))]
    return "\n".join(lines) + "\n"
