"""Tables of columns with the row of every value."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import DataError

__all__ = ["MOST_LOG", "NUMBER", "Table"]

#: Longest file of a log [bytes].
MOST_LOG = 1_000_000_000

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
