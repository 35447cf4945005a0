"""Parquet files as tables of columns."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from estimators.logs.parquet_pages import pages
from estimators.logs.tables import Table
from offroad_env.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["PARQUET_EXTRA", "parquet_bytes", "parquet_names", "read_parquet"]

PARQUET_EXTRA = 'reading and writing Parquet needs pyarrow: pip install "offroad-bekker[data]"'

#: Most numbers that a file may hold, and most bytes of its columns: some kilobytes can state billions.
_MOST_NUMBERS, _MOST_BYTES = 40_000_000, 1_000_000_000
#: Number of an encoding in the format: each text is what the one before begins with, and some more.
_DELTA_BYTE_ARRAY = 7


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise DataError(PARQUET_EXTRA) from None
    return pyarrow, pyarrow.parquet


@contextmanager
def _reading(file: str) -> Iterator[None]:
    """Whatever fails inside is said in one sentence."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:  # a damaged file fails anywhere inside pyarrow, in many ways
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise DataError(f"{file}: is a damaged Parquet file: {reason}") from None


def read_parquet(
    stream: BinaryIO,
    file: str,
    numbers: Callable[[Table, str, Iterable[str]], np.ndarray],
    unread: Callable[[str], bool],
) -> Table:
    """Columns of a Parquet file: integers, floats, dates or text with numbers; null is NaN.

    Parameters
    ----------
    stream
        The open file.
    numbers
        What makes numbers of a column of text, (table, name, cells).
    unread
        Whether the column of this name is left out; its cells may be anything.

    Raises
    ------
    DataError
        One sentence with file, column, row; also where pyarrow is not installed.
    """
    start = stream.read(4)
    if not start:
        raise DataError(f"{file}: is empty")
    if start != b"PAR1":
        raise DataError(f"{file}: is not a Parquet file")
    pyarrow, parquet = _pyarrow()
    with _reading(file):
        opened = parquet.ParquetFile(stream)
        fields = [(field.name, field.type) for field in opened.schema_arrow]
        count = opened.metadata.num_rows
        _refuse_bomb(opened.metadata, file)
        _refuse_pages(opened.metadata, stream, file)
        if count == 0:
            raise DataError(f"{file}: has columns but no row of numbers")
        # A text stays what the file holds once: it may stand in every one of a million rows.
        texts = [name for name, kind in fields if _is_text(kind, pyarrow.types)]
        opened = parquet.ParquetFile(stream, read_dictionary=texts)
    table = Table(file=file, columns={}, rows=np.arange(1, count + 1))
    seen: set[str] = set()
    for name, kind in fields:
        if name in seen:
            raise table.error("two columns have this name", column=name)
        seen.add(name)
        if unread(name):
            continue
        if not _is_readable(kind, pyarrow.types):
            raise table.error(f"holds {kind} values, not numbers", column=name, index=0)
        with _reading(file):
            column = opened.read(columns=[name]).column(0)
            found = _numbers(table, name, column, pyarrow, numbers)
        if len(found) != count:
            raise DataError(f"{file}: is a damaged Parquet file: {name} has {len(found)} of {count} rows")
        table.columns[name] = found
    return table


def _refuse_bomb(metadata: Any, file: str) -> None:
    """Refuse what would take gigabytes once it is unpacked."""
    cells = metadata.num_rows * metadata.num_columns
    size = sum(metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
    if cells > _MOST_NUMBERS or size > _MOST_BYTES:
        raise DataError(
            f"{file}: states {metadata.num_rows} rows of {metadata.num_columns} columns, {size / 1e6:.3g} MB "
            f"unpacked; at most {_MOST_NUMBERS} numbers and {_MOST_BYTES / 1e6:g} MB are read"
        )


def _refuse_pages(metadata: Any, stream: BinaryIO, file: str) -> None:
    """The same by what the pages themselves state, which is what the reader takes room for."""
    size = values = 0
    for group in range(metadata.num_row_groups):
        for index in range(metadata.num_columns):
            column = metadata.row_group(group).column(index)
            start = column.data_page_offset
            if column.has_dictionary_page and 0 < column.dictionary_page_offset < start:
                start = column.dictionary_page_offset
            for page in pages(stream, start, start + column.total_compressed_size):
                size, values = size + page.size, values + page.values
                if page.encoding == _DELTA_BYTE_ARRAY:  # of which a page may hold the square of its length
                    raise DataError(
                        f"{file}: {column.path_in_schema} holds text as differences: write it plainly"
                    )
                if size > _MOST_BYTES or values > _MOST_NUMBERS:
                    raise DataError(
                        f"{file}: its pages hold more than {_MOST_BYTES / 1e6:g} MB, or more than "
                        f"{_MOST_NUMBERS} numbers, which is not what the file states at its end"
                    )


def _is_text(kind: Any, types: Any) -> bool:
    return bool(types.is_string(kind) or types.is_large_string(kind))


def _is_readable(kind: Any, types: Any) -> bool:
    if types.is_dictionary(kind):
        return _is_readable(kind.value_type, types)
    tests = (
        types.is_floating, types.is_integer, types.is_boolean, types.is_null, types.is_timestamp,
        types.is_duration, types.is_string, types.is_large_string,
    )  # fmt: skip
    return any(test(kind) for test in tests)


def parquet_names(stream: BinaryIO, file: str) -> list[str]:
    """Names of the columns of a Parquet file.

    Raises
    ------
    DataError
        If it is none.
    """
    _, parquet = _pyarrow()
    with _reading(file):
        return list(parquet.read_schema(stream).names)


def _numbers(
    table: Table,
    name: str,
    column: Any,
    pyarrow: Any,
    numbers: Callable[[Table, str, Iterable[str]], np.ndarray],
) -> np.ndarray:
    kind, types = column.type, pyarrow.types
    if types.is_dictionary(kind):
        return _of_dictionary(table, name, column, pyarrow, numbers)
    if types.is_timestamp(kind) or types.is_duration(kind):
        seconds = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
        stamps: np.ndarray = column.cast(pyarrow.int64()).cast(pyarrow.float64(), safe=False).to_numpy()
        return seconds * stamps
    if _is_text(kind, types):
        cells = column.to_pylist()
        return numbers(table, name, ("" if cell is None else cell for cell in cells))
    if types.is_boolean(kind):
        column = column.cast(pyarrow.uint8())
    found: np.ndarray = column.cast(pyarrow.float64(), safe=False).to_numpy().copy()
    return found


def _of_dictionary(
    table: Table,
    name: str,
    column: Any,
    pyarrow: Any,
    numbers: Callable[[Table, str, Iterable[str]], np.ndarray],
) -> np.ndarray:
    """Numbers of a column in which every value is stored once, with its places."""
    merged = column.unify_dictionaries().combine_chunks()
    chunks = merged.chunks if hasattr(merged, "chunks") else [merged]
    parts: list[np.ndarray] = []
    for chunk in chunks:
        places = chunk.indices.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        present = ~np.isnan(places)
        own = np.where(present, places, 0.0).astype(np.int64)
        used, first = np.unique(own[present], return_index=True)
        rows = table.rows[np.flatnonzero(present)[first]]  # where each value stands first
        values = pyarrow.chunked_array([chunk.dictionary.take(pyarrow.array(used))])
        part = Table(file=table.file, columns={}, rows=rows)
        looked_up = np.full(len(chunk.dictionary) + 1, np.nan)
        looked_up[used] = _numbers(part, name, values, pyarrow, numbers)
        parts.append(np.where(present, looked_up[own], np.nan))
    return np.concatenate(parts) if parts else np.empty(0)


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
