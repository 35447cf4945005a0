"""What several test modules need and no fixture should own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["REPOSITORY", "data_root", "measured_data", "run_fresh", "unlabelled"]

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


def unlabelled(figure: Figure) -> list[str]:
    """Axes of a figure whose numbers are shown without a quantity and a unit, such as ``speed [m/s]``.

    Names as ticks (a task, a filter) need no label, nor does an axis that shares its numbers with a
    neighbour and shows none.
    """
    return [
        f"axes {number} ({axes.get_title(loc='left') or axes.get_title()!r}), {which}: {label!r}"
        for number, axes in enumerate(figure.axes)
        for which, label, numbers in (
            ("x", axes.get_xlabel(), _numbers(axes, "x")),
            ("y", axes.get_ylabel(), _numbers(axes, "y")),
        )
        if numbers and not re.search(r"\w.*\[.+\]", label, re.DOTALL)
    ]


def _numbers(axes: Axes, which: str) -> bool:
    """Whether an axis shows numbers."""
    from matplotlib.category import StrCategoryFormatter
    from matplotlib.ticker import FixedFormatter, FuncFormatter, NullFormatter

    axis = axes.xaxis if which == "x" else axes.yaxis
    shown = any(axis.get_tick_params().get(name) for name in ("labelbottom", "labelleft", "labelright"))
    there = axes.get_visible() and axes.axison and axis.get_visible()
    if not (there and shown and len(axis.get_majorticklocs())):
        return False
    formatter = axis.get_major_formatter()
    if isinstance(formatter, FixedFormatter | FuncFormatter):
        texts = [label.get_text() for label in axis.get_majorticklabels()]
        return any(re.fullmatch(r"[-\d.]+", text) for text in texts)
    return not isinstance(formatter, NullFormatter | StrCategoryFormatter)
