"""Every command that a page shows is understood, and those of less than a minute run to their end."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from agents.commands.cli import main
from helpers import REPOSITORY
from page_commands import listed, run_by_howto, shown

#: What stands for a file, a soil or a filter of the reader.
STAND_INS = {"NAME": "dry_sand", "ID": "online_joint_ukf"}
#: A task with a vehicle of one's own, as the pages describe them.
LANE = """
scenario:
  name: lane
  corridor: 2.5
  target_speed: 4
  time_limit: 30
  course: {path: sine, length: [60, 90], amplitude: 3, wavelength: 70, roughness: B}
vehicle: {base: mrzr, m: 1450}
"""
#: Makes the log that the pages call run.csv.
LOG = "offroad drive --scenario track --agent stanley --duration 30 --log run.csv"
#: Longest run of a command [s]; the machine may be busy with others.
LONGEST = 600


def words(command: str) -> list[str]:
    return [word.removesuffix("...") for word in shlex.split(command, comments=True)]


#: A mere name without its arguments, and a file that the reader has and this folder has not.
NO_FILE = "cannot be read: No such file"
LEFT_OPEN = re.compile(rf"Missing (from|value)|{NO_FILE}")


class UnderstoodError(Exception):
    """The arguments were parsed; nothing is run."""


@pytest.fixture
def only_parsed(monkeypatch):
    """Commands end when their arguments are understood."""
    parse = tyro.cli

    def only_parse(*arguments, **options):
        parse(*arguments, **options)
        raise UnderstoodError

    monkeypatch.setattr(tyro, "cli", only_parse)


@pytest.mark.check
@pytest.mark.usefixtures("only_parsed")
def test_every_command_of_the_pages_is_understood(capsys):
    refused = []
    commands = {name: page for name, page in shown().items() if name.startswith("offroad ")}
    assert len(commands) > 100
    for command, page in commands.items():
        try:
            main(words(command)[1:])
        except UnderstoodError:
            continue
        except SystemExit:
            said = capsys.readouterr().err
            if not LEFT_OPEN.search(said):
                refused.append(f"{page}: {command}\n{said[-600:]}")
    assert not refused, "\n".join(refused)


def short() -> list[str]:
    """Commands that no how-to page runs and that the list of long ones leaves to this test; the log first."""
    left = set(shown()) - run_by_howto() - {entry["command"] for entry in listed()}
    assert LOG in left
    return [LOG, *sorted(left - {LOG})]


def test_few_commands_are_left_to_be_run_here():
    assert 20 < len(short()) < 60


@pytest.mark.usefixtures("only_parsed")
def test_commands_that_are_run_here_lack_no_argument(capsys):
    # Where a page means a name, it has one word, or is listed: told here in seconds, not by the run below.
    lacking = []
    for command in short():
        if command.startswith("offroad "):
            with pytest.raises((UnderstoodError, SystemExit)) as ended:
                main(words(command)[1:])
            if ended.type is SystemExit and NO_FILE not in capsys.readouterr().err:
                lacking.append(command)
    assert not lacking


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with what the reader has: a task of one's own; the log is made by the first command."""
    made = tmp_path_factory.mktemp("commands")
    (made / "lane.yaml").write_text(LANE, encoding="utf-8")
    return made


@pytest.mark.check
@pytest.mark.parametrize("command", short())
def test_a_short_command_runs_to_its_end(command, folder, tmp_path):
    program, *words = [STAND_INS.get(word, word) for word in shlex.split(command)]
    module = ["-m", "agents.commands.cli"] if program == "offroad" else []
    paths = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, *module, *words],
        # A template never takes the place of a description that is there.
        cwd=tmp_path if command.startswith("offroad log template") else folder,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
        timeout=LONGEST,
    )
    assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-3000:]
