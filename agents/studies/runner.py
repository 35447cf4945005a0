"""Long studies in units that are kept: what was interrupted goes on where it stopped.

A unit is a key - which filter, which row, which seed - and its result is a dict of plain numbers.
Results are appended to a file of JSON lines as they come. Each line carries a stamp of the sources
that it was made with: after a change of those, the unit is run again.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from agents.reports.output import OutputError, console, only_writer
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import cache_folder
from offroad_env.world.files import open_file

__all__ = ["Key", "Result", "checked_rows", "checked_seeds", "run_units", "stamp_of"]

#: Longest file of results [bytes].
_LONGEST = 2_000_000_000

Key = tuple[Any, ...]
Result = dict[str, Any]


@cache
def stamp_of(*modules: str) -> str:
    """Stamp of the sources of these modules and of all that they import."""
    return "-".join(cache_folder(module).name[:10] for module in modules)


def _line(key: Key, stamp: str, result: Result) -> str:
    """A unit as a line with its own check sum: a damaged number must not count."""
    # Infinite numbers stay what they are: this file is read by this module only.
    unit = {"key": key, "stamp": stamp, "result": result}
    return json.dumps({**unit, "crc": _check_sum(unit)})


def _check_sum(unit: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(unit).encode())


def _entry(line: str) -> tuple[Key, str, Result]:
    """(key, stamp, result) of a line; one of many errors where it is none."""
    entry = json.loads(line)
    if entry.pop("crc") != _check_sum(entry):
        raise ValueError("damaged")
    return tuple(entry["key"]), entry["stamp"], entry["result"]


def _read(path: Path, stamps: dict[Key, str]) -> dict[Key, Result]:
    """Results of earlier runs that still hold; a line that is cut off or damaged is no result."""
    found: dict[Key, Result] = {}
    if not path.exists():
        return found
    with open_file(path, most=_LONGEST) as file:
        for line in file:
            try:
                key, stamp, result = _entry(line.decode())
                if stamps.get(key) == stamp:
                    found[key] = result
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                continue
    return found


def _end_line(path: Path) -> None:
    """Close a last line that an interrupted run has left open."""
    if not path.is_file() or path.stat().st_size == 0:
        return
    with path.open("rb+") as file:
        file.seek(-1, os.SEEK_END)
        if file.read(1) != b"\n":
            file.write(b"\n")


def run_units(
    path: Path,
    work: Callable[..., Result],
    stamps: dict[Key, str],
    *,
    label: str,
    n_jobs: int = 2,
) -> dict[Key, Result]:
    """Result of every unit: read from ``path``, or run and appended to it.

    Parameters
    ----------
    path
        File of JSON lines.
    work
        Called with the parts of a key; a function of a module, so that other processes find it.
    stamps
        Key -> stamp of the sources behind its result, see `stamp_of`; the order is that of the work.
    label
        Of the progress bar.
    n_jobs
        Local processes; 1 runs in this one.

    Raises
    ------
    OutputError
        If the file cannot be written, or another process is writing it.
    """
    with only_writer(path):
        return _run_missing(path, work, stamps, label, n_jobs)


def _run_missing(
    path: Path, work: Callable[..., Result], stamps: dict[Key, str], label: str, n_jobs: int
) -> dict[Key, Result]:
    """What is not in the file yet."""
    from joblib import Parallel, delayed
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    done = _read(path, stamps)
    missing = [key for key in stamps if key not in done]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        _end_line(path)
        with path.open("a", encoding="utf-8") as file, Progress(*columns, console=console()) as bar:
            task = bar.add_task(label, total=len(stamps), completed=len(done))
            tasks = (delayed(_one)(work, key) for key in missing)
            for key, result in Parallel(n_jobs=n_jobs, return_as="generator_unordered")(tasks):
                file.write(f"{_line(key, stamps[key], result)}\n")
                file.flush()
                done[key] = result
                bar.advance(task)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    except KeyboardInterrupt:
        kept = f"{len(done)} of {len(stamps)} {label} are kept in {path}"
        raise KeyboardInterrupt(f"{kept}: the same command goes on from there") from None
    return {key: done[key] for key in stamps}


def _one(work: Callable[..., Result], key: Key) -> tuple[Key, Result]:
    return key, work(*key)


def checked_rows(rows: Sequence[int], last: int = 8) -> tuple[int, ...]:
    """Row numbers as asked for, each once.

    Raises
    ------
    InvalidParameter
        For no row, or one outside 1 ... ``last``.
    """
    if not rows or not all(1 <= row <= last for row in rows):
        raise InvalidParameter(f"rows must be one or more of 1 ... {last}, got {tuple(rows)}")
    return tuple(dict.fromkeys(rows))


def checked_seeds(seeds: int, known: Sequence[int]) -> tuple[int, ...]:
    """The first ``seeds`` of the ``known`` ones.

    Raises
    ------
    InvalidParameter
        For fewer than 1, or more than there are.
    """
    if not 1 <= seeds <= len(known):
        raise InvalidParameter(f"seeds must be in [1, {len(known)}], got {seeds}")
    return tuple(known[:seeds])
