"""Files that a user may have been given: size and kind are checked before anything is read.

A FIFO or a device has no end, an archive of a kilobyte may hold gigabytes, and a parser fails in a dozen
ways on what is damaged. Each failure becomes one sentence.
"""

from __future__ import annotations

import io
import json
import os
import secrets
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from offroad_env.errors import DataError

__all__ = [
    "MOST_ARRAYS",
    "MOST_TEXT",
    "create_beside",
    "is_stream",
    "open_file",
    "parse_json",
    "read_arrays",
    "read_file",
    "read_json",
    "read_text",
    "require_keys",
    "write_file",
]

#: Longest file of settings: YAML, JSON, the source of an agent [bytes].
MOST_TEXT = 1_000_000
#: Most that the arrays of one archive may take once unpacked [bytes].
MOST_ARRAYS = 500_000_000


@contextmanager
def open_file(path: str | os.PathLike[str], *, most: int) -> Iterator[BinaryIO]:
    """An ordinary file of at most ``most`` bytes, open for reading.

    Raises
    ------
    DataError
        For a folder, device, pipe or socket, a file that is too long, or one that cannot be opened.
    """
    path = Path(path)
    try:
        # Not blocking: to open a pipe that nobody writes to would wait for ever.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except ValueError:
        raise DataError(f"{str(path)!r}: is no name of a file") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from None
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(file.fileno())
        if stat.S_ISDIR(found.st_mode):
            raise DataError(f"{path}: is a folder, not a file")
        if not stat.S_ISREG(found.st_mode):
            raise DataError(
                f"{path}: is a device, pipe or socket, not an ordinary file: copy it into one first"
            )
        if found.st_size > most:
            raise DataError(
                f"{path}: has {found.st_size / 1e6:.3g} MB; at most {most / 1e6:.3g} MB of this kind are read"
            )
        yield file


def read_file(path: str | os.PathLike[str], *, most: int) -> bytes:
    """Content of an ordinary file of at most ``most`` bytes.

    Raises
    ------
    DataError
        As `open_file`.
    """
    with open_file(path, most=most) as file:
        try:
            return file.read(most)
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_text(path: str | os.PathLike[str], *, most: int = MOST_TEXT) -> str:
    """Content of a file of UTF-8 text, a byte order mark left out.

    Raises
    ------
    DataError
        As `open_file`; also for what is no UTF-8.
    """
    try:
        return read_file(path, most=most).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not UTF-8 text") from None


def read_json(path: str | os.PathLike[str], *, most: int = MOST_TEXT) -> dict[str, Any]:
    """The object that a JSON file holds.

    Raises
    ------
    DataError
        As `read_text`; also for what is no JSON, or no object.
    """
    return parse_json(read_text(path, most=most), str(path))


def parse_json(text: str, file: str) -> dict[str, Any]:
    """The object that JSON text holds.

    Raises
    ------
    DataError
        For anything else.
    """
    try:
        content = json.loads(text)
    except RecursionError:
        raise DataError(f"{file}: is nested too deeply") from None
    except ValueError as error:
        raise DataError(f"{file}: is not JSON: {str(error)[:120]}") from None
    if not isinstance(content, dict):
        raise DataError(f"{file}: must hold a JSON object, holds a {type(content).__name__}")
    return content


def read_arrays(path: str | os.PathLike[str], *, most: int = MOST_ARRAYS) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` file: numbers only, never Python objects.

    Raises
    ------
    DataError
        As `open_file`; also for what is no such archive, is damaged, or would take more than ``most`` bytes.
    """
    with open_file(path, most=most) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
                if sum(entry.file_size for entry in entries) > most:
                    raise DataError(f"{path}: its arrays would take more than {most / 1e6:.3g} MB")
                return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
        except DataError:
            raise
        except Exception as error:  # a damaged archive fails anywhere inside the readers, in many ways
            reason = " ".join(str(error).split())[:120] or type(error).__name__
            raise DataError(f"{path}: is no .npz file of numbers, or damaged: {reason}") from None


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array; the header is checked against the length of what follows before room is taken for it."""
    with archive.open(entry) as member:
        content = member.read(entry.file_size + 1)
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = (
        np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    )
    shape, _, kind = read_header(stream)
    count = 1
    for length in shape:
        count *= length
    if count * kind.itemsize != len(content) - stream.tell():
        raise ValueError(f"{entry.filename} holds another number of values than it states")
    stream.seek(0)
    found: np.ndarray = np.lib.format.read_array(stream, allow_pickle=False)
    return found


def is_stream(path: Path) -> bool:
    """Whether something is there that is written to, not replaced: a device, a pipe, standard output."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not stat.S_ISREG(mode) and not stat.S_ISDIR(mode)


def write_file(path: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file whole or not at all: into a temporary neighbour, then renamed.

    A link is followed; a device, pipe or standard output is written to. ``private``: for the owner alone.

    Raises
    ------
    OSError
        When the folder cannot be made or written to; what was there before stays.
    """
    if is_stream(path):
        with path.open("wb") as stream:
            stream.write(content)
        return
    path = Path(os.path.realpath(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = create_beside(path, private=private)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def create_beside(path: Path, *, private: bool = False) -> tuple[int, str]:
    """A new file beside ``path``, to be renamed to it: its descriptor and its name.

    Whoever may read the file that is there may read this one; where there is none, whom the process lets
    (umask). ``private``: the owner alone.

    Raises
    ------
    OSError
        When the folder cannot be written to.
    """
    name = str(path.parent / f".{path.name[:100]}.{secrets.token_hex(8)}.part")
    handle = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o666)
    try:
        if not private and path.exists():
            os.chmod(name, stat.S_IMODE(path.stat().st_mode))
    except BaseException:
        os.close(handle)
        os.unlink(name)
        raise
    return handle, name


def require_keys(content: Mapping[str, Any], kinds: Mapping[str, type | tuple[type, ...]], file: str) -> None:
    """Refuse content of a file in which a key is missing or holds another kind of value.

    Raises
    ------
    DataError
    """
    for key, kind in kinds.items():
        if not isinstance(content.get(key), kind):
            raise DataError(f"{file}: {key} is missing or of the wrong kind: another version, or damaged?")
