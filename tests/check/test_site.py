"""The documentation site is built without a warning, and its links and examples hold."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.check
def test_the_site_is_built_without_a_warning_and_every_example_runs(tmp_path):
    pytest.importorskip("sphinx_gallery", reason="needs the extra docs")
    for part in ("docs", "examples"):
        ignored = shutil.ignore_patterns("gallery", "reference", "sg_execution_times.rst", "__pycache__")
        shutil.copytree(ROOT / part, tmp_path / part, ignore=ignored)
    for file in ("README.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / file, tmp_path)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", "site"]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    examples = sorted((ROOT / "examples").glob("plot_*.py"))
    assert len(examples) >= 8
    for example in examples:
        page = (tmp_path / "site/gallery" / f"{example.stem}.html").read_text(encoding="utf-8")
        assert f"sphx_glr_{example.stem}_001.png" in page, example
    # Offline a page has all: scripts, styles, pictures and the letters of its equations lie beside it.
    assert list((tmp_path / "site/_static/mathjax").rglob("MathJax_Math-Italic.woff"))
    for page in (tmp_path / "site").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(https?://[^"]+)"', text)
        assert not loaded, page
