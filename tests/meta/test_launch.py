"""The command where another project has installed a package named `agents`: one sentence, no traceback."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib

import pytest

from helpers import REPOSITORY

LAUNCH = "from offroad_env.launch import main; main()"


def launched(*first):
    paths = os.pathsep.join(map(str, (*first, REPOSITORY)))
    command = [sys.executable, "-P", "-c", LAUNCH, "--help"]
    return subprocess.run(
        command, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )


def test_the_console_script_is_the_launcher():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["scripts"] == {"offroad": "offroad_env.launch:main"}


def test_the_command_runs_where_agents_is_this_project_s():
    done = launched()
    assert done.returncode == 0, done.stderr
    assert "usage: offroad COMMAND" in done.stdout


@pytest.mark.parametrize("init", ["class Agent: ...\n", '"""Agents of a firm."""\n'])
def test_another_project_s_agents_ends_in_one_sentence(tmp_path, init):
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").write_text(init, encoding="utf-8")
    done = launched(tmp_path)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert f"{tmp_path}/agents/__init__.py is another project's" in done.stderr


def test_files_of_two_projects_in_one_folder_end_in_the_same_sentence(tmp_path):
    """Installed one after the other: the folder is shared, and the last ``__init__.py`` stays."""
    (tmp_path / "agents").symlink_to(merged(tmp_path / "both"), target_is_directory=True)
    assert "is another project's" in launched(tmp_path).stderr


def merged(folder):
    shutil.copytree(REPOSITORY / "agents" / "commands", folder / "commands")
    (folder / "__init__.py").write_text("class Agent: ...\n", encoding="utf-8")
    return folder
