"""What all commands share: where results go, and how they get there whole."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from offroad_env.errors import OffroadError
from offroad_env.world.files import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console
    from rich.table import Table

__all__ = [
    "OutputError",
    "Record",
    "Results",
    "console",
    "only_writer",
    "plain",
    "printable",
    "recorded",
    "say",
    "table",
    "write_bytes",
    "write_json",
]

#: What a terminal would obey instead of showing: control characters but tab and line feed, and marks that
#: turn the direction of writing.
_COMMANDS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
#: Longest name that is printed whole [characters].
_LONGEST_NAME = 400
_LONG_NAME = re.compile(rf"\S{{{_LONGEST_NAME + 1},}}")

#: Width of tables that are written to a file or a pipe [characters].
_FILE_WIDTH = 120


@dataclass
class Record:
    """What a command shows while it runs."""

    lines: list[str] = field(default_factory=list)
    tables: list[tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], int]] = field(default_factory=list)
    figures: list[tuple[str, bytes, str]] = field(default_factory=list)  #: name, PNG, caption


_RECORD: ContextVar[Record | None] = ContextVar("record", default=None)


@contextmanager
def recorded() -> Iterator[Record]:
    """Within it, what goes to the screen and into figures is kept as well."""
    record = Record()
    token = _RECORD.set(record)
    try:
        yield record
    finally:
        _RECORD.reset(token)


class OutputError(OffroadError, OSError):
    """A result cannot be written where it was asked for."""

    # OSError shows its arguments in its own way; the message of this project is a sentence.
    __str__ = Exception.__str__


def console() -> Console:
    """Standard output: tables and colours on a terminal, plain text elsewhere."""
    import sys

    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)


def printable(text: str) -> str:
    """Text of which parts come from files: terminal commands are escaped, very long names are cut."""
    text = _LONG_NAME.sub(lambda name: f"{name[0][:_LONGEST_NAME]}... ({len(name[0])} characters)", text)
    return _COMMANDS.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def say(line: str, screen: Console | None = None) -> None:
    """Print a line of text as it is, however long, on a ``screen`` that a progress bar may share."""
    if (record := _RECORD.get()) is not None:
        record.lines.append(line)
    (screen or console()).print(printable(line), markup=False, soft_wrap=True)


def table(title: str, heading: Sequence[str], rows: Iterable[Sequence[str]], *, texts: int = 1) -> Table:
    """A table for the terminal; the first ``texts`` columns are aligned left, numbers right."""
    from rich.markup import escape
    from rich.table import Table

    cells = tuple(tuple(row) for row in rows)
    if (record := _RECORD.get()) is not None:
        record.tables.append((title, tuple(heading), cells, texts))
    result = Table(
        title=escape(printable(title)),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        show_header=any(heading),
    )
    for index, name in enumerate(heading):
        result.add_column(escape(printable(name)), justify="left" if index < texts else "right")
    for row in cells:
        result.add_row(*(escape(printable(cell)) for cell in row))
    return result


def plain(value: Any) -> Any:
    """``value`` as what JSON can hold: records and arrays opened, numbers that are not finite None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy arrays and scalars, without importing NumPy
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file whole or not at all; a device or a pipe is written to.

    Raises
    ------
    OutputError
        When the folder cannot be made or written to.
    """
    try:
        write_file(path, content)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    return path


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Within it no other process enters the same for this path; its end, however sudden, gives it free.

    Raises
    ------
    OutputError
        If another process is within, or the folder cannot be written to.
    """
    lock = path.parent / f".{path.name}.lock"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    try:
        _lock(handle, path)
        yield
    finally:
        os.close(handle)  # which also unlocks


def _lock(handle: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not on Windows
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(
            f"another process is writing {path}: wait for its end, or give another folder (--out)"
        ) from None
    except OSError:  # a file system without locks
        return


def write_json(path: Path, content: Any) -> Path:
    """Write ``content`` as JSON; what is not finite becomes null.

    Raises
    ------
    OutputError
        As `write_bytes`.
    """
    text = json.dumps(plain(content), indent=1, allow_nan=False)
    return write_bytes(path, f"{text}\n".encode())


@dataclass(kw_only=True)
class Results:
    """Arguments of every command that writes something."""

    out: Path = Path("out")  #: folder for what the command writes
    json: Path | None = None  #: also write the numbers to this file

    def save_figure(self, figure: Figure, name: str, caption: str = "") -> Path:
        """Write a figure as ``<out>/<name>.png`` and say so; a study's page shows it with the caption."""
        import io

        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=130)
        if (record := _RECORD.get()) is not None:
            record.figures.append((name, buffer.getvalue(), caption))
        path = write_bytes(self.out / f"{name}.png", buffer.getvalue())
        say(f"figure: {path}")
        return path

    def save_numbers(self, numbers: Any) -> None:
        """Write the numbers to ``--json``, if asked for, and say so."""
        if self.json is not None:
            say(f"numbers: {write_json(self.json, numbers)}")
