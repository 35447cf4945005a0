"""Thousands of damaged files, each read in a process of its own: ``make fuzz``.

Prints what failed: anything but an answer or a sentence, errors that a library writes without raising them,
more than 5 s of the processor, more than 1 GB. The files come from ``tests/fuzz_corpus.py``; number and seed
name a file, so that it can be made again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
# The packages before the folders of tests that have the same names.
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from fuzz_corpus import READERS, File, crafted, mutations  # noqa: E402 - found by the line above

from offroad_env.errors import OffroadError  # noqa: E402 - as above

TIME, ROOM = 5.0, 1_000_000.0  # [s], [kB]


class Judged(NamedTuple):
    """How a file was answered."""

    outcome: str  #: "read", "refused" or "failed"
    seconds: float  #: of the processor [s]
    room: float  #: most memory taken while it was read [kB]
    wrong: str  #: what failed; "" for nothing


def memory(name: str) -> float:
    """A line of the process's own status, ``VmRSS`` or ``VmHWM`` [kB]."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(name):
            return float(line.split()[1])
    return 0.0


def read(file: File, folder: Path, report: int) -> None:
    """In a process of its own: make the file, read it, and write how it was answered to a pipe."""
    path = file.make(folder)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the maximum begins anew
    before, start, wrong = memory("VmRSS"), time.process_time(), ""
    limit = int(start + 2.0 * TIME) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
    outcome = "read"
    try:
        READERS[file.kind](path)
    except OffroadError as error:
        outcome = "refused"
        if len(str(error)) > 3000:
            wrong = "a sentence of more than 3000 characters"
    except BaseException:
        wrong = traceback.format_exc()[-3000:]
    seconds, room = time.process_time() - start, memory("VmHWM") - before
    if not wrong and (seconds > TIME or room > ROOM):
        wrong = f"took {seconds:.1f} s and {room / 1e3:.0f} MB"
    os.write(report, json.dumps(["failed" if wrong else outcome, seconds, max(room, 0.0), wrong]).encode())


def judged(file: File) -> Judged:
    """A file, read in a new process; whatever that writes to standard error counts as a failure."""
    with tempfile.TemporaryDirectory() as name:
        incoming, outgoing = os.pipe()
        messages = Path(name) / "messages"
        child = os.fork()
        if child == 0:
            os.close(incoming)
            # An interpreter writes there what it cannot raise.
            os.dup2(os.open(messages, os.O_WRONLY | os.O_CREAT), sys.stderr.fileno())
            (folder := Path(name) / "files").mkdir()
            read(file, folder, outgoing)
            os._exit(0)
        os.close(outgoing)
        with os.fdopen(incoming, "rb") as pipe:
            answer = pipe.read().decode()
        _, status, used = os.wait4(child, 0)
        said = messages.read_text(encoding="utf-8", errors="replace")
    if not answer:
        seconds = used.ru_utime + used.ru_stime
        return Judged("failed", seconds, 0.0, f"ended by {os.waitstatus_to_exitcode(status)}: {said}")
    found = Judged(*json.loads(answer))
    return found._replace(outcome="failed", wrong=said) if said else found


def main() -> int:
    """Read them all; 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=2400, help="mutated files, besides those thought out")
    parser.add_argument("--only", default="", help="files whose name contains this text")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for file in mutations(len(READERS), 0):  # what is imported once is no part of a file's time
        with tempfile.TemporaryDirectory() as name, contextlib.suppress(OffroadError):
            READERS[file.kind](file.make(Path(name)))
    start, outcomes, slowest, largest = time.perf_counter(), Counter[str](), 0.0, 0.0
    failed = 0
    for file in [*crafted(), *mutations(options.files, options.seed)]:
        if options.only not in file.name:
            continue
        found = judged(file)
        outcomes[f"{file.kind}: {found.outcome}"] += 1
        slowest, largest = max(slowest, found.seconds), max(largest, found.room)
        if found.wrong:
            failed += 1
            print(f"FAILED {file.name} (seed {options.seed}): {found.wrong}", flush=True)
    for name, count in sorted(outcomes.items()):
        print(f"{name:24s} {count}")
    print(
        f"{sum(outcomes.values())} files in {time.perf_counter() - start:.0f} s, {failed} failed; slowest "
        f"{slowest:.1f} s, largest {largest / 1e3:.0f} MB"
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
