"""Commands in places that do not help: full disk, closed output, other locales, no home, names that bite."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.reports.output import printable, say
from helpers import REPOSITORY


def offroad(*arguments, shell="", **environment):
    """What a command answers in a new process; ``shell`` is what a shell puts behind it."""
    command = f'exec "{sys.executable}" -m agents.commands.cli {" ".join(arguments)} {shell}'
    return subprocess.run(
        ["/bin/sh", "-c", command],
        capture_output=True,
        check=False,
        cwd=REPOSITORY,
        env={**os.environ, **environment},
    )


def test_a_full_device_as_output_is_one_sentence():
    done = offroad("soil", "--list", shell="> /dev/full")
    assert done.returncode == 1
    assert done.stderr.decode().startswith("offroad: cannot write: No space left on device")
    assert b"Traceback" not in done.stderr


@pytest.mark.check
@pytest.mark.parametrize("shell", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_closed_streams_are_no_error(shell):
    done = offroad("soil", "--list", shell=shell)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr


@pytest.mark.check
@pytest.mark.parametrize(
    "locale",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"LC_ALL": "POSIX", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
    ],
    ids=["C", "ASCII"],
)
def test_a_locale_without_other_letters_replaces_them(locale):
    done = offroad("soil", "--list", **locale)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert b"dry_sand" in done.stdout


@pytest.mark.check
def test_a_home_that_does_not_exist_costs_the_cache_alone(tmp_path):
    home = tmp_path / "file"
    home.write_text("no folder")
    done = offroad("soil", "--list", HOME=str(home), XDG_CACHE_HOME="", OFFROAD_CACHE="")
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr


@pytest.mark.check
@pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="needs a folder in which not even root makes files"
)
def test_a_home_that_is_read_only_costs_the_cache_alone():
    done = offroad("soil", "--list", HOME="/proc", XDG_CACHE_HOME="", OFFROAD_CACHE="", MPLCONFIGDIR="")
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr


#: Commands that keep results, and a limit on the length of files [blocks of 512 bytes] that stops each.
LIMITED = {
    "benchmark": (
        "benchmark --tasks brake --agents nominal aware --episodes 2 --forms matched --no-policies "
        "--out {out}",
        2,
    ),
    "train": (
        "train --scenario brake --terrain-info none --action-interface direct --total-steps 128 --n-envs 2 "
        "--threads 1 --n-steps 32 --batch-size 32 --n-epochs 1 --checkpoint-steps 64 --check-episodes 0 "
        "--eval-episodes 0 --resume --out {out}",
        16,
    ),
    "reproduce": ("reproduce table1 --rows 1 --seeds 1 --out {out}", 2),
    "drive": ("drive --scenario brake --duration 2 --log {out}/run.csv --out {out}", 4),
}


@pytest.mark.check
@pytest.mark.parametrize("name", LIMITED)
def test_a_full_disk_is_one_sentence_and_the_command_goes_on_where_there_is_room(name, tmp_path):
    """A limit on the length of files stands for the end of the disk."""
    words, blocks = LIMITED[name]
    words = words.format(out=tmp_path)
    program = f'ulimit -f {blocks}; exec "{sys.executable}" -m agents.commands.cli {words}'
    # There is no list of fonts yet, and for one command nothing is compiled: both find no room either.
    fresh = {"MPLCONFIGDIR": str(tmp_path / "fonts")}
    if name == "reproduce":
        fresh["OFFROAD_CACHE"] = str(tmp_path / "cache")
    done = subprocess.run(
        ["/bin/sh", "-c", program],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
        env={**os.environ, **fresh},
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines()
    first_time = [
        line for line in lines if line.startswith(("compiled kernels cannot", "OffroadBekker compiles"))
    ]
    assert len(first_time) == len(set(first_time))
    (sentence,) = [line for line in lines if line not in first_time]
    assert re.match(r"offroad: .*(cannot write|cannot be written)", sentence), done.stderr
    assert offroad(*words.split()).returncode == 0


@pytest.mark.check
def test_numbers_go_to_a_pipe_and_leave_it_a_pipe(tmp_path):
    done = offroad("soil", "clay", "--out", str(tmp_path), "--json", "/dev/stdout")
    assert done.returncode == 0, done.stderr
    assert b'"' in done.stdout


def test_names_cannot_command_the_terminal_nor_fill_it(capsys):
    assert printable("\x1b[2J\x07 \u202eabc\tx\n") == "\\x1b[2J\\x07 \\u202eabc\tx\n"
    long = printable("a" * 100_000 + " b")
    assert len(long) < 500
    assert long.endswith("... (100000 characters) b")
    say("\x1b]0;title\x07")
    assert capsys.readouterr().out == "\\x1b]0;title\\x07\n"


def test_a_refusal_shows_the_name_of_a_file_without_obeying_it(tmp_path):
    name = tmp_path / "\x1b[31mrun.csv"
    name.write_text("t\n")
    done = offroad("log", "draw", f"'{name}'")
    assert done.returncode == 1
    assert b"\x1b" not in done.stderr
    assert b"\\x1b[31mrun.csv" in done.stderr
