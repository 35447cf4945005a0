"""Tables of columns with the row of every value; Parquet files."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from offroad_env.errors import DataError

__all__ = ["NUMBER", "PARQUET_EXTRA", "Table", "parquet_bytes", "parquet_names", "read_bytes", "read_parquet"]

PARQUET_EXTRA = 'reading and writing Parquet needs pyarrow: pip install "offroad-bekker[data]"'

#: What a cell with a number looks like.
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


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


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise DataError(PARQUET_EXTRA) from None
    return pyarrow, pyarrow.parquet


def read_parquet(
    content: bytes,
    file: str,
    numbers: Callable[[Table, str, Iterable[str]], np.ndarray],
    unread: Callable[[str], bool],
) -> Table:
    """Columns of a Parquet file: integers, floats or dates; null is NaN.

    Parameters
    ----------
    numbers
        What makes numbers of a column of text, (table, name, cells).
    unread
        Whether the column of this name is left out; its cells may be anything.

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
        if not unread(name):
            table.columns[name] = _arrow_numbers(table, name, column, pyarrow, numbers)
    return table


def parquet_names(content: bytes, file: str) -> list[str]:
    """Names of the columns of a Parquet file.

    Raises
    ------
    DataError
        If it is none.
    """
    pyarrow, parquet = _pyarrow()
    try:
        return list(parquet.read_schema(pyarrow.BufferReader(content)).names)
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{file}: is a damaged Parquet file: {reason}") from None


def _arrow_numbers(
    table: Table,
    name: str,
    column: Any,
    pyarrow: Any,
    numbers: Callable[[Table, str, Iterable[str]], np.ndarray],
) -> np.ndarray:
    kind, types = column.type, pyarrow.types
    if types.is_timestamp(kind) or types.is_duration(kind):
        seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        stamps: np.ndarray = column.cast(pyarrow.int64()).cast(pyarrow.float64(), safe=False).to_numpy()
        return seconds * stamps
    if types.is_floating(kind) or types.is_integer(kind) or types.is_null(kind) or types.is_boolean(kind):
        if types.is_boolean(kind):
            column = column.cast(pyarrow.uint8())
        found: np.ndarray = column.cast(pyarrow.float64(), safe=False).to_numpy().copy()
        return found
    values = column.to_pylist()
    if types.is_string(kind) or types.is_large_string(kind):
        return numbers(table, name, ("" if value is None else value for value in values))
    first = next((i for i, value in enumerate(values) if value is not None), 0)
    raise table.error(f"holds {kind} values, not numbers", column=name, index=first)


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
