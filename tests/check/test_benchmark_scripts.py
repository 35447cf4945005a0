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
