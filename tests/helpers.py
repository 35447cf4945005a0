"""What several test modules need and no fixture should own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

__all__ = ["REPOSITORY", "data_root", "measured_data", "run_fresh"]

REPOSITORY = Path(__file__).resolve().parents[1]


def data_root() -> Path:
    """Folder of the measured data: OFFROAD_DATA, else ``shared/data`` beside the repository."""
    return Path(os.environ.get("OFFROAD_DATA") or REPOSITORY.parent / "shared" / "data")


def measured_data(name: str) -> Path:
    """Folder of one measured data set; the calling test is skipped where it is not at hand."""
    folder = data_root() / name
    if not folder.is_dir():
        pytest.skip(f"data set {name} is not in {data_root()}: set OFFROAD_DATA to the folder that holds it")
    return folder


def run_fresh(code: str) -> str:
    """Standard output [text] of ``code`` in a new interpreter that has imported nothing yet.

    Raises
    ------
    AssertionError
        If the interpreter fails, with what it wrote to standard error.
    """
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    return done.stdout
