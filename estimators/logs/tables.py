"""CSV and Parquet files as columns of numbers, exact, with the row of every value."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from offroad_env.errors import DataError

__all__ = ["PARQUET_EXTRA", "Table", "csv_text", "parquet_bytes", "parse_csv", "parse_parquet", "read_bytes"]

PARQUET_EXTRA = 'reading and writing Parquet needs pyarrow: pip install "offroad-bekker[data]"'

_MAGIC = (
    (b"PAR1", "is a Parquet file: name it .parquet"),
    (b"PK\x03\x04", "is a zip archive or spreadsheet: save the sheet as CSV"),
    (b"\x1f\x8b", "is compressed (gzip): unpack it first"),
    (b"\xff\xfe", "is UTF-16 text: save it as UTF-8"),
    (b"\xfe\xff", "is UTF-16 text: save it as UTF-8"),
    (b"#ROSBAG", "is a ROS bag: name it .bag"),
)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns of a file. ``rows[i]`` is what a reader of the file calls the row of value i.

    In a CSV file that is the line (the header is line 1), in a Parquet file the row, counted from 1.
    """

    file: str
    columns: dict[str, np.ndarray]
    rows: np.ndarray

    def error(self, sentence: str, *, column: str = "", index: int | None = None) -> DataError:
        """A `DataError` that says where: file, column, row."""
        where = [self.file]
        if column:
            where.append(f"column {column!r}")
        if index is not None:
            where.append(f"row {self.rows[index]}")
        return DataError(f"{', '.join(where)}: {sentence}")


def read_bytes(path: Path) -> bytes:
    """Content of a file, or a `DataError` that says why not."""
    try:
        return path.read_bytes()
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder, not a file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from None


def _text(content: bytes, file: str) -> str:
    """The bytes as text, or one sentence about what they are instead."""
    for magic, sentence in _MAGIC:
        if content.startswith(magic):
            raise DataError(f"{file}: {sentence}")
    if not content.strip(b"\xef\xbb\xbf \t\r\n"):
        raise DataError(f"{file}: is empty")
    zero = content.find(b"\0")
    if zero >= 0:
        row = content.count(b"\n", 0, zero) + 1
        raise DataError(f"{file}, row {row}: holds a zero byte: this is no text file (binary, or damaged)")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise DataError(
            f"{file}, row {row}: byte 0x{content[error.start]:02x} is not UTF-8 text: a binary file, or "
            "saved in another encoding"
        ) from None


def parse_csv(content: bytes, file: str) -> Table:
    """Columns of a CSV file: a header, comma, decimal point; an empty cell or nan is NaN.

    Raises
    ------
    DataError
        One sentence with file, column, row.
    """
    text = _text(content, file)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    cells: list[list[str]] = []
    lines: list[int] = []
    names: list[str] = []
    try:
        for row in reader:
            if not row:  # a blank line
                continue
            if not names:
                names = _header(row, file)
                continue
            _check_width(row, names, reader.line_num, file)
            cells.append(row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise DataError(f"{file}, row {reader.line_num}: not CSV: {error}") from None
    if not cells:
        raise DataError(f"{file}: has a header but no row of numbers")
    table = Table(file=file, columns={}, rows=np.array(lines))
    for name, column in zip(names, zip(*cells, strict=True), strict=True):
        table.columns[name] = _numbers(table, name, column)
    return table


def _header(row: list[str], file: str) -> list[str]:
    names = [name.strip() for name in row]
    if len(names) == 1 or all(";" in name for name in names):
        for sign, word in ((";", "semicolons"), ("\t", "tabs"), (" ", "spaces")):
            if sign in row[0].strip():
                raise DataError(
                    f"{file}, row 1: columns are separated by {word}: a log has commas between columns and a "
                    "point in numbers"
                )
    if all(_NUMBER.fullmatch(name) for name in names):
        raise DataError(f"{file}, row 1: holds numbers: the first row must name the columns (t, steer, ...)")
    if names[0].startswith("#"):
        raise DataError(f"{file}, row 1: is a comment: the first row must name the columns (t, steer, ...)")
    seen: set[str] = set()
    for position, name in enumerate(names, start=1):
        if not name:
            raise DataError(f"{file}, row 1: column {position} has no name")
        if name in seen:
            raise DataError(f"{file}, column {name!r}, row 1: two columns have this name")
        seen.add(name)
    return names


def _check_width(row: list[str], names: list[str], line: int, file: str) -> None:
    if len(row) < len(names):
        raise DataError(
            f"{file}, column {names[len(row)]!r}, row {line}: the row ends after {len(row)} of {len(names)} "
            "values: was the file cut off?"
        )
    if len(row) > len(names):
        raise DataError(
            f"{file}, row {line}: has {len(row)} values for {len(names)} columns: a comma inside a number?"
        )


def _numbers(table: Table, name: str, cells: Iterable[str]) -> np.ndarray:
    cells = list(cells)
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
        if stripped and not _NUMBER.fullmatch(stripped):
            raise table.error(_not_a_number(stripped), column=name, index=i)
        values.append(float(stripped) if stripped else math.nan)
    return np.array(values)


def _not_a_number(cell: str) -> str:
    shown = cell if len(cell) <= 24 else cell[:21] + "..."
    if re.fullmatch(r"[-+]?\d+,\d+", cell):
        return f"{shown!r} has a decimal comma: a log has a decimal point"
    if cell.lower() in ("na", "n/a", "null", "none", "-", "--", "missing"):
        return f"{shown!r} is not a number: leave the cell empty where there is no sample"
    return f"{shown!r} is not a number"


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise DataError(PARQUET_EXTRA) from None
    return pyarrow, pyarrow.parquet


def parse_parquet(content: bytes, file: str) -> Table:
    """Columns of a Parquet file: integers or floats; null is NaN.

    Raises
    ------
    DataError
        One sentence with file, column, row; also where pyarrow is not installed.
    """
    if not content:
        raise DataError(f"{file}: is empty")
    if not content.startswith(b"PAR1"):
        raise DataError(f"{file}: is not a Parquet file")
    pyarrow, parquet = _pyarrow()
    try:
        read = parquet.read_table(pyarrow.BufferReader(content))
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{file}: is a damaged Parquet file: {reason}") from None
    if read.num_rows == 0:
        raise DataError(f"{file}: has columns but no row of numbers")
    table = Table(file=file, columns={}, rows=np.arange(1, read.num_rows + 1))
    for name, column in zip(read.column_names, read.columns, strict=True):
        if name in table.columns:
            raise table.error("two columns have this name", column=name)
        table.columns[name] = _arrow_numbers(table, name, column, pyarrow)
    return table


def _arrow_numbers(table: Table, name: str, column: Any, pyarrow: Any) -> np.ndarray:
    kind = column.type
    if pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind) or pyarrow.types.is_null(kind):
        numbers: np.ndarray = column.cast(pyarrow.float64(), safe=False).to_numpy().copy()
        return numbers
    values = column.to_pylist()
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return _numbers(table, name, ("" if value is None else value for value in values))
    first = next((i for i, value in enumerate(values) if value is not None), 0)
    raise table.error(f"holds {kind} values, not numbers", column=name, index=first)


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    """CSV text of the columns. Floats are written with as many digits as reading them back exactly needs."""
    written = [["" if math.isnan(v) else repr(v) for v in values.tolist()] for values in columns.values()]
    lines = [",".join(columns), *map(",".join, zip(*written, strict=True))]
    return "\n".join(lines) + "\n"


def parquet_bytes(columns: Mapping[str, np.ndarray]) -> bytes:
    """Content of a Parquet file with the columns; NaN becomes null.

    Raises
    ------
    DataError
        Where pyarrow is not installed.
    """
    pyarrow, parquet = _pyarrow()
    arrays = {name: pyarrow.array(values, from_pandas=True) for name, values in columns.items()}
    sink = io.BytesIO()
    parquet.write_table(pyarrow.table(arrays), sink)
    return sink.getvalue()
