"""What the pages of a Parquet file take once they are unpacked, by their own headers.

The sizes at the end of a file are statements that a reader need not believe; room is taken by what stands at
the head of each page. Headers are Thrift structures in the compact protocol
(https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md) with the fields of
https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

__all__ = ["Page", "pages"]

#: Longest header of a page [bytes]: its statistics may hold a value.
_LONGEST = 1_000_000
#: Kinds of fields of the compact protocol.
_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 11, 12
#: Deepest nesting; the format has three levels.
_DEEPEST = 8


class Page(NamedTuple):
    """What the header of a page states."""

    size: int  #: unpacked [bytes]
    values: int
    encoding: int  #: as numbered by the format; -1 for a page of no data


class _Header:
    """Reads one structure."""

    def __init__(self, content: bytes) -> None:
        self.content, self.place = content, 0

    def byte(self) -> int:
        """The next one; `IndexError` at the end."""
        self.place += 1
        return self.content[self.place - 1]

    def number(self) -> int:
        """An unsigned number of seven bits a byte."""
        value, shift = 0, 0
        while shift < 70:
            byte = self.byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
        raise ValueError("a number of a page's header has no end")

    def integer(self) -> int:
        """A signed number."""
        value = self.number()
        return (value >> 1) ^ -(value & 1)

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Fields by number."""
        if depth > _DEEPEST:
            raise ValueError("a page's header is nested too deeply")
        fields: dict[int, Any] = {}
        last = 0
        while head := self.byte():
            last = last + (head >> 4) if head >> 4 else self.integer()
            fields[last] = self.value(head & 15, depth)
        return fields

    def value(self, kind: int, depth: int) -> Any:
        """A field; of lists, sets and maps, which no size depends on, nothing is kept."""
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind == _STRUCT:
            return self.struct(depth + 1)
        if kind in (_LIST, _SET, _MAP):
            raise ValueError("a page's header holds a list")
        if kind in (_BYTE, _DOUBLE, _BINARY):
            length = {_BYTE: 1, _DOUBLE: 8}.get(kind) or self.number()
            self.place += length
            return None
        return self.integer()


def pages(stream: BinaryIO, start: int, end: int) -> Iterator[Page]:
    """The pages of a column that stand between two places of a file.

    Raises
    ------
    ValueError, IndexError
        If one of their headers is damaged.
    """
    while start < end:
        stream.seek(start)
        header = _Header(stream.read(min(end - start, _LONGEST)))
        fields = header.struct()
        data = fields.get(5) or fields.get(8) or fields.get(7) or {}
        size, packed = int(fields[2]), int(fields[3])
        if size < 0 or packed < 0:
            raise ValueError("a page has a negative size")
        encoding = data.get(4 if 8 in fields else 2, -1) if 5 in fields or 8 in fields else -1
        yield Page(size, int(data.get(1, 0)), int(encoding))
        start += header.place + packed
