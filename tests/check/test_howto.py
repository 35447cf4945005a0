"""What a how-to page shows runs from an empty folder, and so do the first commands of the scenarios."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import REPOSITORY

HOWTO = sorted((REPOSITORY / "docs" / "howto").glob("*.md"))
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def environment(folder: Path) -> dict[str, str]:
    """This interpreter's `offroad` first on the path, whether or not the package is installed."""
    command = folder / "bin" / "offroad"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m agents.commands.cli "$@"\n')
    command.chmod(0o755)
    path = os.pathsep.join([str(command.parent), os.environ["PATH"]])
    # Agents of one's own lie in the folder of the call.
    modules = os.pathsep.join([str(REPOSITORY), str(folder), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PATH": path, "PYTHONPATH": modules}


def test_every_page_shows_something_that_runs():
    assert len(HOWTO) >= 9
    assert [page.name for page in HOWTO if not BLOCK.search(page.read_text(encoding="utf-8"))] == []


@pytest.mark.check
@pytest.mark.parametrize("page", HOWTO, ids=lambda page: page.stem)
def test_the_snippets_of_a_page_run(page, tmp_path):
    variables = environment(tmp_path)
    for language, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        command = [sys.executable, "-c", code] if language == "python" else ["sh", "-e", "-c", code]
        done = subprocess.run(
            command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
