"""Long studies in units that are kept: what was interrupted goes on where it stopped.

A unit is a key - which filter, which row, which seed - and its result is a dict of plain numbers.
Results are appended to a file of JSON lines as they come. Each line carries a stamp of the sources
that it was made with: after a change of those, the unit is run again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from agents.reports.output import OutputError, console
from offroad_env.errors import InvalidParameter
from offroad_env.physics._jit import cache_folder

__all__ = ["Key", "Result", "checked_rows", "checked_seeds", "run_units", "stamp_of"]

Key = tuple[Any, ...]
Result = dict[str, Any]


@cache
def stamp_of(*modules: str) -> str:
    """Stamp of the sources of these modules and of all that they import."""
    return "-".join(cache_folder(module).name[:10] for module in modules)


def _read(path: Path, stamps: dict[Key, str]) -> dict[Key, Result]:
    """Results of earlier runs that still hold; a line that was cut off is no result."""
    found: dict[Key, Result] = {}
    if not path.is_file():
        return found
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
            key = tuple(entry["key"])
            if stamps.get(key) == entry["stamp"]:
                found[key] = entry["result"]
        except (ValueError, KeyError, TypeError):
            continue
    return found


def _end_line(path: Path) -> None:
    """Close a last line that an interrupted run has left open."""
    if path.is_file() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n"):
        with path.open("a", encoding="utf-8") as file:
            file.write("\n")


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
    """
    from joblib import Parallel, delayed
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    done = _read(path, stamps)
    missing = [key for key in stamps if key not in done]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _end_line(path)
        with path.open("a", encoding="utf-8") as file, Progress(*columns, console=console()) as bar:
            task = bar.add_task(label, total=len(stamps), completed=len(done))
            tasks = (delayed(_one)(work, key) for key in missing)
            for key, result in Parallel(n_jobs=n_jobs, return_as="generator_unordered")(tasks):
                # Infinite numbers stay what they are: this file is read by this function only.
                line = {"key": key, "stamp": stamps[key], "result": result}
                file.write(f"{json.dumps(line)}\n")
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
