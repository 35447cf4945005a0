"""Every script of ``benchmarks`` starts from any folder, without settings of the caller."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from helpers import REPOSITORY

#: Scripts with arguments; the others run at once, or are modules of one of these.
SCRIPTS = sorted(
    path.name
    for path in (REPOSITORY / "benchmarks").glob("*.py")
    if "argparse" in path.read_text(encoding="utf-8")
)


@pytest.mark.check
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_says_what_it_does(name, tmp_path):
    surroundings = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "benchmarks" / name), "--help"],
        cwd=tmp_path,
        env=surroundings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "usage:" in done.stdout


def test_most_scripts_are_asked():
    assert len(SCRIPTS) > 10


@pytest.mark.check
def test_the_pictures_of_pages_are_drawn_from_their_tables(tmp_path):
    script = REPOSITORY / "benchmarks" / "page_figures.py"
    command = [sys.executable, str(script), "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    drawn = {path.name for path in tmp_path.glob("*.png")}
    assert drawn == {"benchmark.png", "diagnosis_rates.png", "mismatch.png", "speed.png"}
