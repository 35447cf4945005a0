"""The commands that the pages show: found in their text, and how each of them is known to run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from helpers import REPOSITORY

__all__ = ["LISTED", "PAGES", "listed", "normal", "run_by_howto", "shown"]

DOCS = REPOSITORY / "docs"
#: Commands that no test runs: when each ran last, or why it did not.
LISTED = DOCS / "commands_run.yaml"
MADE = ("gallery", "reference", "_build")  # when the site is built
PAGES = [
    REPOSITORY / "README.md",
    *sorted(page for page in DOCS.rglob("*.md") if page.relative_to(DOCS).parts[0] not in MADE),
]
PROGRAMS = "offroad|make|python|pytest|pip|dask"
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: Not a command: an option of several, a command left open, a program of the reader.
NO_COMMAND = re.compile(
    r" [|] |\|ray|\.\.\. --rig|^offroad COMMAND|STUDY|--help$"
    r"|^offroad (log check|data log|data get|estimate --filter)$"
)


def normal(command: str) -> str:
    """A command with one blank between words, without its comment, any log as ``run.csv``."""
    command = re.sub(r"\s+#.*$", "", command)
    return re.sub(r"\bLOG(\.\.\.)?(?=\s|$)", "run.csv", " ".join(command.split()))


def _lines(page: Path) -> Iterator[str]:
    """Lines of the blocks of a shell, and code within a line that has an argument."""
    text = page.read_text(encoding="utf-8")
    for language, block in BLOCK.findall(text):
        if language in ("", "sh", "bash"):
            yield from re.findall(rf"^(?:{PROGRAMS}) .+$", block, flags=re.MULTILINE)
    prose = BLOCK.sub("", text)
    for code in re.findall(rf"`((?:{PROGRAMS}) [^`]+)`", prose):
        # `offroad diagnose` is a name; `make docs` is a command.
        if len(code.split()) > 2 or not code.startswith(("offroad", "pip")):
            yield code


def shown() -> dict[str, str]:
    """Command -> a page that shows it."""
    found: dict[str, str] = {}
    for page in PAGES:
        for line in _lines(page):
            command = normal(line)
            if not NO_COMMAND.search(command):
                found.setdefault(command, str(page.relative_to(REPOSITORY)))
    return found


def run_by_howto() -> set[str]:
    """Commands in the blocks of the how-to pages that `tests/check/test_howto.py` runs."""
    found: set[str] = set()
    for page in (DOCS / "howto").glob("*.md"):
        for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language == "sh":
                found |= {normal(line) for line in block.splitlines()}
    return found


def listed() -> list[dict[str, Any]]:
    """Entries of the list of commands that no test runs."""
    entries: list[dict[str, Any]] = yaml.safe_load(LISTED.read_text(encoding="utf-8"))
    return entries
