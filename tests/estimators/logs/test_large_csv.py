"""A long log needs little more room than its numbers, and time in proportion to its rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bad_logs import DESCRIPTION, HEADER, good_rows, write

from helpers import run_fresh

PROGRAM = """
import time
from estimators.logs import read_log

def peak():
    # Not getrusage: its maximum begins with that of the process which has started this one.
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

room = peak()
start = time.process_time()
log = read_log({path!r})
print(len(log), time.process_time() - start, peak(), room)
"""


needs_proc = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")


def long_log(folder, rows):
    columns = HEADER[:11]
    values = np.random.default_rng(5).normal(0.0, 0.1, (rows, 10))
    values[:, 3:5] += 12.0
    with (folder / "run.csv").open("w") as file:
        file.write(",".join(columns) + "\n")
        for i in range(rows):
            file.write(f"{0.01 * i!r}," + ",".join(map(repr, values[i].tolist())) + "\n")
    content = (folder / "run.csv").read_bytes()
    write(folder, content, DESCRIPTION)
    return folder / "run.csv"


def cost(path):
    rows, seconds, room, before = run_fresh(PROGRAM.format(path=str(path))).split()
    return int(rows), float(seconds), 1024 * int(room), 1024 * int(before)


@needs_proc
@pytest.mark.check
def test_a_log_of_eleven_columns_takes_less_than_three_hundred_bytes_a_row(tmp_path):
    assert len(good_rows()[0]) >= 11
    rows, _, room, before = cost(long_log(tmp_path, 100_000))
    assert rows == 100_000
    assert room - before < 300 * rows


@needs_proc
@pytest.mark.check
def test_a_million_rows_are_read_in_half_a_gigabyte_and_linear_time(tmp_path):
    times = {}
    for count in (250_000, 1_000_000):
        (folder := tmp_path / str(count)).mkdir()
        rows, times[count], room, _ = cost(long_log(folder, count))
        assert rows == count
        assert room < 0.5e9
    assert times[1_000_000] < 1.5 * 4.0 * times[250_000]
