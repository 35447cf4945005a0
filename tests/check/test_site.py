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


pytestmark = pytest.mark.check

WIDTHS = (390, 800, 1020, 1170, 1300, 1400, 1500)
#: What is wrong with a page: wider than the screen, with a picture that is missing, with a broken equation.
WRONG = """() => [
  document.documentElement.scrollWidth > innerWidth ? `${document.documentElement.scrollWidth} px wide` : "",
  ...[...document.images].filter(one => one.complete && !one.naturalWidth).map(one => one.src),
  ...[...document.querySelectorAll(".MathJax_Error, mjx-merror")].map(one => one.textContent),
].filter(Boolean)"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built anew."""
    pytest.importorskip("sphinx_gallery", reason="needs the extra docs")
    folder = tmp_path_factory.mktemp("site")
    for part in ("docs", "examples"):
        ignored = shutil.ignore_patterns("gallery", "reference", "sg_execution_times.rst", "__pycache__")
        shutil.copytree(ROOT / part, folder / part, ignore=ignored)
    for file in ("README.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / file, folder)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", "site"]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return folder / "site"


def test_the_site_is_built_without_a_warning_and_every_example_runs(site):
    examples = sorted((ROOT / "examples").glob("plot_*.py"))
    assert len(examples) >= 8
    for example in examples:
        page = (site / "gallery" / f"{example.stem}.html").read_text(encoding="utf-8")
        assert f"sphx_glr_{example.stem}_001.png" in page, example


def test_every_page_of_the_site_opens_offline(site):
    """Scripts, styles, pictures and the letters of its equations lie beside it."""
    assert list((site / "_static/mathjax").rglob("MathJax_Math-Italic.woff"))
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(https?://[^"]+)"', text)
        assert not loaded, page


def test_a_click_on_a_picture_shows_it_in_full_size(site):
    for page in ("paper_table", "diagnosis", "details/detection_delay"):
        text = (site / f"{page}.html").read_text(encoding="utf-8")
        pictures = re.findall(r'<img [^>]*src="[./]*_images/', text)
        assert pictures
        assert len(re.findall(r'<a class="reference internal" href="[./]*_images/', text)) == len(pictures), (
            page
        )


def test_the_gallery_begins_with_a_first_episode_and_ends_with_what_is_not_run(site):
    text = (site / "gallery/index.html").read_text(encoding="utf-8")
    shown = list(dict.fromkeys(re.findall(r"sphx_glr_(\w+)_thumb", text)))
    assert shown[0] == "plot_first_episode"
    run = [name.startswith("plot_") for name in shown]
    assert run == sorted(run, reverse=True)


@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_of_the_site_is_wider_than_the_screen(browser, site, width):
    context = browser.new_context(viewport={"width": width, "height": 844}, offline=True)
    page = context.new_page()
    pages = [*site.glob("*.html"), *site.glob("details/*.html"), *site.glob("howto/*.html")]
    found = {}
    for path in pages:
        page.goto(path.as_uri(), wait_until="load")
        if wrong := page.evaluate(WRONG):
            found[path.name] = wrong
    context.close()
    assert not found


def test_a_wide_picture_scrolls_on_a_phone(browser, site):
    context = browser.new_context(viewport={"width": 390, "height": 844}, offline=True)
    page = context.new_page()
    page.goto((site / "paper_table.html").as_uri())
    widths = page.eval_on_selector_all("article p.figure img", "all => all.map(one => one.clientWidth)")
    context.close()
    assert widths
    assert min(widths) > 600
