"""Commands that are killed at any moment go on, or begin anew, and end as undisturbed ones do."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from helpers import REPOSITORY

#: Random moments at which each command is killed.
MOMENTS = int(os.environ.get("OFFROAD_KILLS", "3"))
#: Measured on a clock, so they differ between two runs of anything.
#: The command itself names its folder, and the stamp those sources that may be edited meanwhile.
CLOCKS = {"seconds", "wall_time", "real_time", "step_time", "env_time", "crc", "before", "stamp", "command"}


class Command(NamedTuple):
    """A command and what it leaves."""

    words: str  #: with {out} and {log}
    results: Callable[[Path], Any]


def without_clocks(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_clocks(item) for key, item in value.items() if key not in CLOCKS}
    return [without_clocks(item) for item in value] if isinstance(value, list) else value


def numbers_of(name: str) -> Callable[[Path], Any]:
    def read(out: Path) -> Any:
        return without_clocks(json.loads((out / name).read_text(encoding="utf-8")))

    return read


def units_of(name: str) -> Callable[[Path], Any]:
    """Units by key; one that is stored twice is an error."""

    def read(out: Path) -> Any:
        found = {}
        for line in (out / name).read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(ValueError):  # the line at which a run was killed
                entry = json.loads(line)
                assert str(entry["key"]) not in found, "a unit is stored twice"
                found[str(entry["key"])] = without_clocks(entry)
        return found

    return read


def weights(out: Path) -> Any:
    with np.load(out / "weights.npz") as table:
        return {name: table[name].tolist() for name in table.files}


COMMANDS = {
    "benchmark": Command(
        "benchmark --tasks brake --agents nominal aware --episodes 6 --forms matched --no-policies "
        "--out {out}",
        units_of("episodes.jsonl"),
    ),
    "train": Command(
        "train --scenario brake --terrain-info none --action-interface direct --total-steps 1536 --n-envs 2 "
        "--threads 1 --n-steps 32 --batch-size 32 --n-epochs 1 --checkpoint-steps 64 --check-episodes 0 "
        "--eval-episodes 0 --resume --out {out}",
        weights,
    ),
    "reproduce": Command("reproduce table1 --rows 1 2 --seeds 1 --out {out}", units_of("table1.jsonl")),
    "diagnose": Command("diagnose {log} --out {out}", numbers_of("diagnosis.json")),
}


def start(words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "agents.commands.cli", *words.split()]
    return subprocess.Popen(
        command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )


def finish(words: str) -> float:
    """Run to the end; returns the time that it took [s]."""
    begin = time.monotonic()
    process = start(words)
    said, _ = process.communicate()
    assert b"Traceback" not in said, said.decode()
    assert process.returncode == 0, said.decode()
    return time.monotonic() - begin


def kill(words: str, after: float) -> bool:
    """Kill the command with all its processes after a time [s]; False where it had ended by then."""
    process = start(words)
    time.sleep(after)
    running = process.poll() is None
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    said, _ = process.communicate()
    assert b"Traceback" not in said, said.decode()
    return running


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    finish(f"drive --scenario track --seed 3 --duration 24 --log {folder / 'run.csv'} --out {folder}")
    return folder / "run.csv"


@pytest.mark.check
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_killed_ends_as_an_undisturbed_one(name, tmp_path, request):
    command = COMMANDS[name]
    log = request.getfixturevalue("log") if "{log}" in command.words else ""
    whole, broken = (command.words.format(out=tmp_path / part, log=log) for part in ("whole", "broken"))
    finish(whole)
    took = finish(command.words.format(out=tmp_path / "again", log=log))  # kernels are compiled now
    expected = command.results(tmp_path / "whole")
    assert command.results(tmp_path / "again") == expected
    moments, kills = random.Random(21), 0
    for attempt in range(100 * MOMENTS):
        if kills == MOMENTS:
            break
        if kill(broken, moments.uniform(0.0, took)):
            kills += 1
        else:  # nothing is left to be interrupted: compare, and begin in a folder of its own
            assert command.results(tmp_path / "broken") == expected
            (tmp_path / "broken").rename(tmp_path / f"broken{attempt}")
    assert kills == MOMENTS
    finish(broken)
    assert command.results(tmp_path / "broken") == expected
