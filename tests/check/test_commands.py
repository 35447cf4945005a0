"""Every command that a page shows is understood: its name, study and options exist."""

from __future__ import annotations

import re
import shlex

import pytest
import tyro

from agents.commands.cli import main
from helpers import REPOSITORY

DOCS = REPOSITORY / "docs"
MADE = ("gallery", "reference", "_build")
PAGES = [
    REPOSITORY / "README.md",
    *sorted(page for page in DOCS.rglob("*.md") if page.relative_to(DOCS).parts[0] not in MADE),
]


def commands() -> dict[str, str]:
    """Command as it is written -> a page that shows it: lines of code blocks, and code within a line."""
    found = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(re.findall(r"^```(?:sh)?\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE))
        prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
        shown = re.findall(r"^offroad (.+)$", blocks, flags=re.MULTILINE)
        shown += [" ".join(one.split()) for one in re.findall(r"`offroad ([^`]+)`", prose)]
        for command in shown:
            # An option of several, a command left open, a mere name of a command.
            if not re.search(r"[|]|\.\.\. --rig|^COMMAND|STUDY", command) and " " in command:
                found[command] = page.name
    return found


def words(command: str) -> list[str]:
    return [word.removesuffix("...") for word in shlex.split(command, comments=True)]


#: A mere name without its arguments, and a file that the reader has and this folder has not.
LEFT_OPEN = re.compile(r"Missing (from|value)|cannot be read: No such file")


class UnderstoodError(Exception):
    """The arguments were parsed; nothing is run."""


@pytest.mark.check
def test_every_command_of_the_pages_is_understood(monkeypatch, capsys):
    parse = tyro.cli

    def only_parse(*arguments, **options):
        parse(*arguments, **options)
        raise UnderstoodError

    monkeypatch.setattr(tyro, "cli", only_parse)
    shown, refused = commands(), []
    assert len(shown) > 100
    for command, page in shown.items():
        try:
            main(words(command))
        except UnderstoodError:
            continue
        except SystemExit:
            said = capsys.readouterr().err
            if not LEFT_OPEN.search(said):
                refused.append(f"{page}: offroad {command}\n{said[-600:]}")
    assert not refused, "\n".join(refused)
