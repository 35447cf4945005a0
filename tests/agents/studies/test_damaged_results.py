"""Results that are kept survive what happens to files: damage, two writers, a full disk."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys

import pytest

from agents.reports.output import OutputError, only_writer
from agents.studies.runner import run_units
from helpers import REPOSITORY

UNITS = {(i,): "stamp" for i in range(6)}
CALLS = []


def square(i):
    CALLS.append(i)
    return {"square": i * i}


def run(path):
    CALLS.clear()
    return run_units(path, square, UNITS, label="squares", n_jobs=1)


EXPECTED = {(i,): {"square": i * i} for i in range(6)}


@pytest.mark.parametrize(
    ("damage", "again"),
    [
        (lambda lines: lines, []),
        (lambda lines: [*lines[:2], lines[2][:20], *lines[3:]], [2]),
        (lambda lines: [*lines[:4], lines[4].replace(b"16", b"17"), lines[5]], [4]),
        (lambda lines: [b"\xff\xfe" * 50, *lines[1:]], [0]),
        (lambda lines: [b"[" * 100_000, *lines], []),
        (lambda lines: [b'{"key": {}, "stamp": 3}', b"null", b"3", *lines], []),
        (lambda lines: lines[:3], [3, 4, 5]),
        (lambda lines: [*lines, *lines], []),
        (lambda lines: [], [0, 1, 2, 3, 4, 5]),
    ],
    ids=["whole", "cut", "a digit", "no text", "nested", "other kinds", "lost", "twice", "empty"],
)
def test_damaged_lines_are_computed_anew_and_no_others(tmp_path, damage, again):
    path = tmp_path / "units.jsonl"
    run(path)
    lines = path.read_bytes().splitlines()
    path.write_bytes(b"\n".join(damage(lines)))
    assert run(path) == EXPECTED
    assert again == CALLS
    assert run(path) == EXPECTED
    assert CALLS == []


def test_no_unit_is_stored_twice(tmp_path):
    path = tmp_path / "units.jsonl"
    run(path)
    run(path)
    keys = [tuple(json.loads(line)["key"]) for line in path.read_text().splitlines()]
    assert sorted(keys) == sorted(UNITS)


def test_a_second_process_in_one_folder_is_told_apart_in_a_sentence(tmp_path):
    path = tmp_path / "units.jsonl"
    code = (
        "from pathlib import Path\n"
        "from agents.reports.output import only_writer\n"
        f"with only_writer(Path({str(path)!r})):\n    print('in', flush=True)\n    input()\n"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "in\n"
        with pytest.raises(OutputError, match=r"another process is writing .*units\.jsonl: wait"):
            run(path)
        other.kill()  # its end, however sudden, gives the folder free
        other.wait()
    assert run(path) == EXPECTED


def test_one_process_may_write_one_after_the_other(tmp_path):
    for _ in range(2):
        with only_writer(tmp_path / "x"):
            pass


def test_a_full_disk_is_one_sentence_and_nothing_that_was_stored_is_lost(tmp_path):
    """The limit on the length of files stands for the end of the disk."""
    path = tmp_path / "units.jsonl"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (250, limits[1]))
        with pytest.raises(OutputError, match=r"cannot write .*units\.jsonl: File too large"):
            run(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    stored = len(path.read_bytes().splitlines()) - 1  # the last one is cut off
    assert stored >= 2
    assert run(path) == EXPECTED
    assert list(range(stored, 6)) == CALLS
