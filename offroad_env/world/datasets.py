"""Measured data of other people: where it is published, under which licence, and how to get it.

Nothing is bundled and nothing is downloaded unless `fetch` is called. Files live in
``$OFFROAD_DATA`` (put there by the user) or in this project's cache (put there by `fetch`).
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import urlsplit

from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.published_drives import DRIVES, TABLES, is_drive, join_drive
from offroad_env.world.yaml_text import shown

__all__ = ["DATASETS", "UNPUBLISHED", "Dataset", "cache_folder", "describe", "fetch", "locate", "verify"]

#: Seconds without an answer or a byte after which a download is given up.
_TIMEOUT = 30.0
#: A table from which a file is joined is at most so many times as long.
_TABLE_SHARE = 20

_MIT = """\
Permission is hereby granted, free of charge, to any person obtaining a copy of this software and
associated documentation files (the "Software"), to deal in the Software without restriction,
including without limitation the rights to use, copy, modify, merge, publish, distribute, sublicense,
and/or sell copies of the Software, and to permit persons to whom the Software is furnished to do so,
subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial
portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT
LIMITED TO THE WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN
NO EVENT SHALL THE AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY,
WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE
SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Dataset:
    """One file that its publisher serves, pinned by its SHA-256."""

    name: str  #: key in the registry, and folder name below ``OFFROAD_DATA`` and the cache
    title: str  #: what was measured, in one line
    url: str  #: the publisher's address of exactly this version
    file_name: str  #: name of the file on disk
    sha256: str  #: digest of the file, hexadecimal
    size: int  #: length of the file [bytes]
    licence: str  #: short name of the licence
    licence_text: str  #: copyright notice and licence, to be kept with the file
    citation: str  #: how to cite it
    #: Tables below ``url`` from which the files are joined (`published_drives`); empty: one file as
    #: published.
    tables: tuple[str, ...] = ()
    drives: tuple[str, ...] = ()  #: names of the joined files


_F1TENTH_COMMIT = "6a1b907d68999067960553bcec18fbf70b30bf4e"
_CMU_COMMIT = "55a6e92b35cb7a94530e47311fd7c4767fafb835"

#: Datasets that `fetch` and `locate` know.
DATASETS: Mapping[str, Dataset] = MappingProxyType(
    {
        "cmu_single_wheel": Dataset(
            name="cmu_single_wheel",
            title="soil-bin tests of one grousered rover wheel in dry sand, 189 steady trials",
            url="https://raw.githubusercontent.com/robomechanics/3d-terramechanics/"
            f"{_CMU_COMMIT}/raw-data-processing/all_grouser_data.mat",
            file_name="all_grouser_data.mat",
            sha256="0659fdd6657f801aee6bd1ce66dcf8d4b9ab00d4cac8857e7fa9100b0a516d55",
            size=35014,
            licence="MIT",
            licence_text=f"Copyright 2022 Catherine Pavlov, Carnegie Mellon University\n\n{_MIT}",
            citation="C. Pavlov, 3d-terramechanics: data and model of wheels at high slip angle in sand, "
            "Robomechanics Lab, Carnegie Mellon University, 2022, "
            f"github.com/robomechanics/3d-terramechanics, commit {_CMU_COMMIT[:7]}",
        ),
        "f1tenth_indoor": Dataset(
            name="f1tenth_indoor",
            title="three manual drives of a 1:10 car on a hard indoor floor, joined from their tables",
            url=f"https://raw.githubusercontent.com/AhmadAmine998/FrictionMaps/{_F1TENTH_COMMIT}/DataSets/",
            file_name="DS1.csv",
            sha256="074b31d8e1fbef27bd0d094973380ffebbc11fae1166443dbc96c6ed0d59f77d",
            size=991247,
            licence="MIT",
            licence_text=f"Copyright (c) 2022 AhmadAmine998\n\n{_MIT}",
            citation="A. Amine, FrictionMaps: data sets DS1 to DS3, 2022, "
            f"github.com/AhmadAmine998/FrictionMaps, commit {_F1TENTH_COMMIT[:7]}",
            tables=tuple(TABLES.values()),
            drives=tuple(DRIVES),
        ),
    }
)

#: Data of the pages that nobody publishes: name -> what they are and how they were made.
UNPUBLISHED: Mapping[str, str] = MappingProxyType(
    {
        "chrono_scm": "five drives of a multibody vehicle on a soil grid, by Project Chrono, commit 7689fbc",
        "scm_drives": "46 drives of two such vehicles, and 384 trials of single wheels, by the same commit",
    }
)


def fetch(
    name: str,
    *,
    registry: Mapping[str, Dataset] = DATASETS,
    progress: Any = False,
    folder: Path | None = None,
) -> Path:
    """Download a dataset into the cache, unless it is there, and check its SHA-256.

    Parameters
    ----------
    name
        Key in ``registry``.
    registry
        Known datasets.
    progress
        False, True for a bar on the terminal, or an object with ``total``, ``update(n)``,
        ``reset()`` and ``close()``.
    folder
        Cache to use; default `cache_folder`.

    Returns
    -------
    Path
        The file, whose digest is the registered one. ``LICENSE.txt`` and ``CITATION.txt`` lie
        beside it.

    Raises
    ------
    DataError
        Without a network, or when what arrives is not the registered file. Nothing is left
        behind then, and a good file that was there stays.
    """
    import pooch  # not a cost of importing offroad_env

    dataset = _known(name, registry)
    target = (cache_folder() if folder is None else Path(folder)) / dataset.name
    path = target / dataset.file_name
    if dataset.tables:
        return _fetch_drives(dataset, target, progress)
    if path.is_file() and _digest(path) == dataset.sha256:
        return path
    fresh = not target.exists()
    bar = _Bar(dataset.file_name) if progress is True else progress
    try:
        with _quiet(pooch.get_logger()):
            pooch.retrieve(
                dataset.url,
                known_hash=f"sha256:{dataset.sha256}",
                fname=dataset.file_name,
                path=target,
                downloader=_Download(dataset.size, bar),
            )
        (target / "LICENSE.txt").write_text(dataset.licence_text + "\n", encoding="utf-8")
        (target / "CITATION.txt").write_text(dataset.citation + "\n", encoding="utf-8")
    except (OSError, ValueError) as error:  # requests' exceptions are OSErrors
        if fresh:
            with suppress(OSError):
                target.rmdir()
        raise DataError(_failure(dataset, error)) from error
    finally:
        if isinstance(bar, _Bar):
            bar.close()
    return path


def _fetch_drives(dataset: Dataset, target: Path, progress: Any) -> Path:
    """Download the tables of every drive, join them, and keep the joined files."""
    import pooch

    paths = [target / f"{drive}.csv" for drive in dataset.drives]
    if all(_is_joined(path) for path in paths):
        return paths[0]
    texts: dict[Path, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for path in paths:
            tables = {}
            for key, name in TABLES.items():
                bar = _Bar(f"{path.stem}/{name}") if progress is True else progress
                try:
                    with _quiet(pooch.get_logger()):
                        file = pooch.retrieve(
                            f"{dataset.url}{path.stem}/{name}",
                            known_hash=None,  # the joined table is checked
                            fname=f"{path.stem}_{name}",
                            path=folder,
                            downloader=_Download(_TABLE_SHARE * dataset.size, bar),
                        )
                    tables[key] = Path(file).read_text(encoding="utf-8")
                except (OSError, ValueError) as error:
                    raise DataError(_failure(dataset, error)) from error
                finally:
                    if isinstance(bar, _Bar):
                        bar.close()
            texts[path] = join_drive(tables)
            if not is_drive(path.stem, texts[path]):
                raise DataError(
                    f"{dataset.name}: what the publisher sent does not join to the registered "
                    f"{path.name}; nothing "
                    "was kept - damaged on the way, or an intercepting proxy?"
                )
    try:
        target.mkdir(parents=True, exist_ok=True)
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
        (target / "LICENSE.txt").write_text(dataset.licence_text + "\n", encoding="utf-8")
        (target / "CITATION.txt").write_text(dataset.citation + "\n", encoding="utf-8")
    except OSError as error:
        raise DataError(_failure(dataset, error)) from error
    return paths[0]


def _is_joined(path: Path) -> bool:
    """Whether a file is the joined drive of its name."""
    try:
        return is_drive(path.stem, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return False


def locate(name: str, *, registry: Mapping[str, Dataset] = DATASETS, folder: Path | None = None) -> Path:
    """Find a dataset on this machine, without ever downloading it.

    Looks below ``$OFFROAD_DATA`` (``<name>/original/<file>``, then ``<name>/<file>``), then in the
    cache of `fetch`.

    Parameters
    ----------
    name
        Key in ``registry``.
    registry
        Known datasets.
    folder
        Cache to look into; default `cache_folder`.

    Returns
    -------
    Path
        The file, whose digest is the registered one.

    Raises
    ------
    DataError
        When it is nowhere, or when the file that is there is not the registered one.
    """
    dataset = _known(name, registry)
    places = []
    own = os.environ.get("OFFROAD_DATA")
    if own:
        places += [Path(own) / name / "original" / dataset.file_name, Path(own) / name / dataset.file_name]
    places.append((cache_folder() if folder is None else Path(folder)) / name / dataset.file_name)
    for path in places:
        if path.is_file():
            verify(name, path, registry=registry)
            return path
    raise DataError(
        f"{name} is not on this machine (looked for {', '.join(str(p) for p in places)}) - run: offroad data "
        f"get {name}, or set OFFROAD_DATA to the folder that holds {name}/"
    )


def verify(name: str, path: Path, *, registry: Mapping[str, Dataset] = DATASETS) -> None:
    """Refuse a file that is not, byte for byte, the published one.

    Raises
    ------
    DataError
        When the file is missing or its SHA-256 is not the registered one.
    """
    dataset = _known(name, registry)
    if not path.is_file():
        raise DataError(f"{path}: no such file - get it with: offroad data get {name}")
    joined = bool(dataset.tables) and path.stem in dataset.drives and _is_joined(path)
    if not joined and _digest(path) != dataset.sha256:
        raise DataError(
            f"{path} is not the published {dataset.file_name} ({path.stat().st_size} bytes, expected "
            f"{dataset.size}; its SHA-256 differs) - damaged, or another version? Delete it and run: "
            f"offroad data get {name}"
        )


def describe(name: str, *, registry: Mapping[str, Dataset] = DATASETS) -> str:
    """Title, address, citation and full licence of a dataset, for display."""
    dataset = _known(name, registry)
    return (
        f"{dataset.name}: {dataset.title}\n"
        f"from     {dataset.url} ({dataset.size / 1000:.0f} kB)\n"
        f"cite     {dataset.citation}\n"
        f"licence  {dataset.licence}\n\n{dataset.licence_text}"
    )


def cache_folder() -> Path:
    """Where `fetch` puts files: ``$OFFROAD_CACHE``, else the user's cache folder."""
    base = os.environ.get("OFFROAD_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "offroad-bekker"
    )
    return Path(base) / "data"


def _known(name: str, registry: Mapping[str, Dataset]) -> Dataset:
    if name in registry:
        return registry[name]
    if name in UNPUBLISHED:
        raise InvalidParameter(
            f"name={name!r}: nobody publishes these ({UNPUBLISHED[name]}); put them into OFFROAD_DATA, where "
            "commands take them as logs"
        )
    near = get_close_matches(str(name), registry, n=1, cutoff=0.4)
    hint = f" - did you mean {near[0]!r}?" if near else ""
    raise InvalidParameter(f"name must be one of {', '.join(registry)}, got {shown(name)}{hint}")


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _failure(dataset: Dataset, error: Exception) -> str:
    """One sentence for what went wrong, by kind: wrong content, refused, no connection, no disk."""
    import requests

    host = urlsplit(dataset.url).netloc
    if isinstance(error, requests.HTTPError) and error.response is not None:
        return (
            f"{dataset.name} could not be downloaded: {host} answered {error.response.status_code} "
            f"{error.response.reason} for {dataset.url}"
        )
    if isinstance(error, requests.RequestException):
        return (
            f"{dataset.name} could not be downloaded: no connection to {host} - check the network, or set "
            f"OFFROAD_DATA to a folder that holds {dataset.name}/original/{dataset.file_name}"
        )
    if isinstance(error, ValueError):
        return (
            f"{dataset.name}: what {host} sent is not the published {dataset.file_name} (its SHA-256 differs "
            "from the registered one); nothing was kept - damaged on the way, or an intercepting proxy?"
        )
    return f"{dataset.name} could not be stored: {error}"


@contextmanager
def _quiet(logger: logging.Logger) -> Iterator[None]:
    """Silence pooch's own log lines while a download runs; errors arrive as exceptions anyway."""
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


class _Download:
    """Downloads a file, and no more of it than there should be: what pooch calls a downloader.

    Parameters
    ----------
    most
        Bytes after which the answer is given up.
    bar
        With ``total``, ``update``, ``reset`` and ``close``, or False.
    """

    def __init__(self, most: int, bar: Any) -> None:
        self._most, self._bar = most, bar

    def __call__(self, url: str, output_file: str, _: Any) -> None:
        """Write what ``url`` answers into the file.

        Raises
        ------
        ValueError
            If it is longer than it should be; the file is then cut off there.
        """
        import requests

        with requests.get(url, stream=True, timeout=_TIMEOUT) as answer, open(output_file, "wb") as file:
            answer.raise_for_status()
            received = 0
            if self._bar:
                stated = answer.headers.get("content-length", "")
                self._bar.total = int(stated) if stated.isdigit() else self._most
            for piece in answer.iter_content(chunk_size=8192):
                received += len(piece)
                if received > self._most:
                    raise ValueError(f"more than {self._most} bytes")
                file.write(piece)
                if self._bar:
                    self._bar.update(len(piece))
        if self._bar:
            self._bar.close()


class _Bar:
    """Download bar on the terminal, in the shape that pooch calls."""

    def __init__(self, label: str) -> None:
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

        self.total = 0
        self._progress = Progress(TextColumn("{task.description}"), BarColumn(), DownloadColumn())
        self._task = self._progress.add_task(label, total=None)
        self._progress.start()

    def update(self, n: int) -> None:
        self._progress.update(self._task, advance=n, total=self.total)

    def reset(self) -> None:
        self._progress.reset(self._task, total=self.total)

    def close(self) -> None:
        self._progress.stop()
