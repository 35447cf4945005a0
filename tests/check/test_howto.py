"""What a how-to page shows runs from an empty folder, and so does the Python of the other pages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from helpers import REPOSITORY

HOWTO = sorted((REPOSITORY / "docs" / "howto").glob("*.md"))
#: Pages with Python whose blocks build on each other, but for those that need measured data.
OTHERS = sorted(
    page
    for page in (*(REPOSITORY / "docs").glob("*.md"), *(REPOSITORY / "docs" / "details").glob("*.md"))
    if "```python\n" in page.read_text(encoding="utf-8") and page.name != "f1tenth_checks.md"
)
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


@pytest.mark.check
@pytest.mark.parametrize("page", OTHERS, ids=lambda page: page.stem)
def test_the_python_of_a_page_runs(page, tmp_path):
    blocks = [
        code for language, code in BLOCK.findall(page.read_text(encoding="utf-8")) if language == "python"
    ]
    # What needs a graphics processor is left out; learning is cut short.
    code = "\n".join(block for block in blocks if "cuda" not in block)
    code = code.replace("100_000", "64").replace('device="cpu"', 'n_steps=4, batch_size=16, device="cpu"')
    (tmp_path / "buggy.yaml").write_text("vehicle: {base: mrzr, m: 1500}")
    command = [sys.executable, "-c", code]
    variables = environment(tmp_path)
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
