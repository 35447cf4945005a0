"""Thousands of damaged files, each read in a process of its own: ``make fuzz``.

Prints what failed: anything but an answer or a sentence, more than 5 s of the processor, more than 1 GB. The
files come from ``tests/fuzz_corpus.py``; number and seed name a file, so that it can be made again.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from fuzz_corpus import READERS, File, crafted, mutations

from offroad_env.errors import OffroadError

TIME, ROOM = 5.0, 1_000_000.0  # [s], [kB]
_ANSWERED, _REFUSED, _FAILED = 0, 1, 2


def read(file: File, folder: Path, report: int) -> int:
    """In a process of its own: how the reader answers; a traceback goes to the pipe ``report``."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(2 * TIME) + 60, int(2 * TIME) + 61))
    try:
        READERS[file.kind](file.make(folder))
    except OffroadError as error:
        if len(str(error)) > 3000:
            os.write(report, b"a sentence of more than 3000 characters")
            return _FAILED
        return _REFUSED
    except BaseException:
        os.write(report, traceback.format_exc()[-3000:].encode())
        return _FAILED
    return _ANSWERED


def judged(file: File) -> tuple[str, float, float, str]:
    """(Outcome, time [s], room [kB], what went wrong) of a file."""
    ours = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with tempfile.TemporaryDirectory() as name:
        incoming, outgoing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(incoming)
            os._exit(read(file, Path(name), outgoing))
        os.close(outgoing)
        with os.fdopen(incoming, "rb") as pipe:
            answer = pipe.read().decode()
        _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    room = max(used.ru_maxrss - ours, 0.0)  # of the child, which begins with ours
    code = os.waitstatus_to_exitcode(status)
    if code not in (_ANSWERED, _REFUSED):
        return "failed", seconds, room, answer or f"ended by signal {-code}"
    if seconds > TIME or room > ROOM:
        return "failed", seconds, room, f"took {seconds:.1f} s and {room / 1e3:.0f} MB"
    return ("read", "refused")[code], seconds, room, ""


def main() -> int:
    """Read them all; 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=2400, help="mutated files, besides those thought out")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for file in mutations(len(READERS), 0):  # what is imported once is no part of a file's time
        with tempfile.TemporaryDirectory() as name:
            read(file, Path(name), os.open(os.devnull, os.O_WRONLY))
    start, outcomes, slowest, largest = time.perf_counter(), Counter[str](), 0.0, 0.0
    failed = 0
    for file in [*crafted(), *mutations(options.files, options.seed)]:
        outcome, seconds, room, wrong = judged(file)
        outcomes[f"{file.kind}: {outcome}"] += 1
        slowest, largest = max(slowest, seconds), max(largest, room)
        if wrong:
            failed += 1
            print(f"FAILED {file.name} (seed {options.seed}): {wrong}", flush=True)
    for name, count in sorted(outcomes.items()):
        print(f"{name:24s} {count}")
    print(
        f"{sum(outcomes.values())} files in {time.perf_counter() - start:.0f} s, {failed} failed; slowest "
        f"{slowest:.1f} s, largest {largest / 1e3:.0f} MB"
    )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
