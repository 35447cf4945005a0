"""The README: its example runs, and what it names exists."""

from __future__ import annotations

import re

import pytest

from agents.commands.cli import COMMANDS
from helpers import REPOSITORY, run_fresh

README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
DOCS = REPOSITORY / "docs"
#: Folders that are made when the site is built.
MADE = ("gallery", "reference", "_build")
PAGES = [
    REPOSITORY / "README.md",
    *sorted(page for page in DOCS.rglob("*.md") if page.relative_to(DOCS).parts[0] not in MADE),
]


@pytest.mark.check
def test_the_example_is_short_and_runs():
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(example.strip().splitlines()) <= 15
    said = run_fresh(example)
    assert re.fullmatch(r"\d+ m in \d+\.\d s, n = 0\.7, estimate \d\.\d\d\n", said)


def test_the_line_of_terramechanics_runs():
    (imports,) = re.findall(r"`(from offroad_env import SOILS.*?)`", README)
    (call,) = re.findall(r"`(wheel_forces\(.*?)`", README)
    assert float(run_fresh(f"{imports}\nprint({call}.sinkage)")) > 0.0


def test_the_readme_fits_on_a_screen_and_a_half():
    assert len(README.splitlines()) < 80


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_file_that_a_page_links_to_exists(page):
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    # What the site makes when it is built, its builder checks.
    here = [link for link in links if "://" not in link and "gallery/" not in link]
    missing = [link for link in here if not (page.parent / link).exists()]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_place_that_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    places = re.findall(r"`((?:offroad_env|estimators|agents|tests|benchmarks|docs)(?:/[\w.]+)*)`", text)
    assert [place for place in places if not (REPOSITORY / place).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_command_that_a_page_names_exists(page):
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"`offroad ([a-z][a-z-]*)", text))
    assert named <= set(COMMANDS)
    targets = set(
        re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), flags=re.M)
    )
    assert set(re.findall(r"(?:^|`)make ([a-z-]+)", text, flags=re.M)) <= targets


def test_pictures_are_small():
    images = list((REPOSITORY / "docs" / "images").iterdir())
    assert images
    allowed = {".gif": 2_500_000}
    assert all(image.stat().st_size < allowed.get(image.suffix, 300_000) for image in images)


def test_the_readme_names_the_clash_of_the_import_name():
    assert "package named `agents`" in README
