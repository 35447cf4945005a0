"""From logs to files, whole or not at all."""

from __future__ import annotations

import hashlib
import os
from os import PathLike
from pathlib import Path

import numpy as np
import yaml

from estimators.logs.config_writing import config_yaml
from estimators.logs.csv_tables import csv_text
from estimators.logs.description_files import description_to_write
from estimators.logs.log import Log
from estimators.logs.mcap import mcap_bytes, mcap_topics
from estimators.logs.parquet import parquet_bytes
from offroad_env.errors import DataError
from offroad_env.world.files import create_beside, is_stream

__all__ = ["content_hash", "write_log"]


def write_log(path: str | PathLike[str], log: Log) -> Path:
    """Write a log and its YAML; reading them back gives the same numbers bit for bit
    (stamps of an MCAP file to the nanosecond, from zero).

    Parameters
    ----------
    path
        ``run.csv``, ``run.parquet`` or ``run.mcap``; ``run.yaml`` comes beside it. Files are replaced, but
        never the description of another data file: where ``run.yaml`` is that of ``run.csv`` and another
        would be needed, the one of ``run.mcap`` is ``run.mcap.yaml``.

    Returns
    -------
    Path of the data file.

    Raises
    ------
    DataError
        If the name has another ending, or the folder cannot be written. Nothing is left half.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".parquet", ".mcap"):
        raise DataError(f"{path}: a log is written as .csv, .parquet or .mcap, got {suffix or 'no ending'!r}")
    text = config_yaml(log.config)
    if suffix == ".mcap":
        text += yaml.safe_dump({"topics": mcap_topics(log)}, sort_keys=False)
    if suffix == ".mcap":
        content = mcap_bytes(log)
    else:
        content = (parquet_bytes if suffix == ".parquet" else _csv_bytes)(_columns(log))
    # The description first: whoever sees the data file sees a whole log.
    description = description_to_write(path, text.encode())
    _replace_both(((description, text.encode()), (path, content)))
    return path


def _csv_bytes(columns: dict[str, np.ndarray]) -> bytes:
    return csv_text(columns).encode()


def content_hash(log: Log) -> str:
    """SHA-256 that `read_log` gives to the log after it is written as CSV."""
    digest = hashlib.sha256(csv_text(_columns(log)).encode())
    digest.update(b"\0" + config_yaml(log.config).encode())
    return digest.hexdigest()


def _columns(log: Log) -> dict[str, np.ndarray]:
    time = {} if log.t is None else {"t": log.t}
    return {**time, **log.channels, **log.references}


def _replace_both(files: tuple[tuple[Path, bytes], ...]) -> None:
    """Write all contents beside their targets, then rename: a failure leaves the old files."""
    written: list[tuple[str, Path]] = []
    try:
        for name, content in files:
            if is_stream(name):
                raise DataError(f"{name}: is a device or pipe; a log is two ordinary files")
            target = Path(os.path.realpath(name))
            handle, temporary = create_beside(target)
            written.append((temporary, target))
            with os.fdopen(handle, "wb") as file:
                file.write(content)
        for temporary, target in written:
            os.replace(temporary, target)
    except OSError as error:
        raise DataError(f"{files[-1][0]}: cannot be written: {error.strerror or error}") from None
    finally:
        for temporary, _ in written:
            Path(temporary).unlink(missing_ok=True)
