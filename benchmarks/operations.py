"""Arithmetic in an interval of 20 ms of a vehicle: `python benchmarks/operations.py`.

A drive as in `benchmarks/fleet.py` runs without the compiler, on numbers that count what is done with them.
What a compiler merges, leaves out or does twice is not seen; comparisons and indices do not count.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest import mock

import numpy as np
from fleet import COMMAND, full_plant

from offroad_env.physics import numerics
from offroad_env.physics import state as at
from offroad_env.physics.batch import PLAIN_COMMAND, full_rows
from offroad_env.physics.packing import pack
from offroad_env.simulation.simulator import FULL_STEP

#: Intervals that are counted.
INTERVALS = 20
#: Additions and multiplications that stand for an operation: a quotient or root is an estimate that is
#: refined, `fast_exp` and `fast_log` are polynomials; a function of the library, mostly tanh, is two exp.
WEIGHTS = {"add": 1, "multiply": 1, "divide": 10, "sqrt": 10, "exp": 25, "log": 32, "library": 50}
_SIGNS = {
    "add": ("__add__", "__radd__", "__sub__", "__rsub__"),
    "multiply": ("__mul__", "__rmul__"),
    "divide": ("__truediv__", "__rtruediv__"),
}
_FUNCTIONS = {
    "sqrt": "sqrt",
    **dict.fromkeys(("tanh", "asin", "sin", "cos", "atan", "atan2", "pow"), "library"),
}

counts: Counter = Counter()


class Counted(float):
    """A number that counts what is done with it."""

    __array_ufunc__ = None  # numpy's numbers leave the operation to this one

    def __neg__(self) -> Counted:
        return Counted(-float(self))

    def __abs__(self) -> Counted:
        return Counted(abs(float(self)))


def _counting(kind: str, plain: Callable) -> Callable:
    def operation(*arguments: float) -> Counted:
        counts[kind] += 1
        return Counted(plain(*arguments))

    return operation


for _kind, _names in _SIGNS.items():
    for _name in _names:
        setattr(Counted, _name, _counting(_kind, getattr(float, _name)))


def _counted(values: np.ndarray) -> np.ndarray:
    """An array of numbers that count."""
    array = np.empty(values.shape, dtype=object)
    array.flat = [Counted(value) for value in values.flat]
    return array


@contextmanager
def _watched() -> Iterator[None]:
    """Functions of the library count, and scratch of the kernels keeps the numbers that do."""
    empty, patches = np.empty, []
    for name, kind in _FUNCTIONS.items():
        patches.append(mock.patch.object(math, name, _counting(kind, getattr(math, name))))
    for name in ("exp", "log"):
        fast = f"fast_{name}"
        counting = _counting(name, getattr(numerics, fast))
        modules = [module for key, module in sys.modules.items() if key.startswith("offroad_env.physics.")]
        patches += [mock.patch.object(each, fast, counting) for each in modules if hasattr(each, fast)]
    patches.append(mock.patch.object(np, "empty", lambda shape: empty(shape, dtype=object)))
    for patch in patches:
        patch.start()
    try:
        yield
    finally:
        for patch in patches:
            patch.stop()


def count(intervals: int) -> Counter:
    """Operations of a drive."""
    plant, state, warm = full_plant()
    state[at.DRIVE] = COMMAND[1]
    packed = pack(plant)
    fleet = packed._replace(numbers=_counted(packed.numbers[None]), waves=_counted(packed.waves))
    start = _counted(state[None]), _counted(warm[None])
    held = _counted(np.tile(COMMAND, (1, intervals, 1)))
    found = np.zeros((1, 1, at.STATE_SIZE)), np.zeros((1, 1, at.READINGS_SIZE)), np.zeros((1, 2))
    counts.clear()
    with _watched():
        full_rows(fleet, start, held, (FULL_STEP, 4), (0, 1), found, PLAIN_COMMAND)
    if found[2][0, 1] != intervals:
        raise RuntimeError("the vehicle did not come to the end")
    return Counter(counts)


def operations() -> dict[str, float]:
    """Operations in an interval by kind, and all as additions and multiplications; from a new interpreter."""
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, __file__, "--json"]
    done = subprocess.run(command, env=plain, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    return found | {"all": sum(WEIGHTS[kind] * number for kind, number in found.items())}


def main() -> None:
    """Count and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="count in this interpreter (NUMBA_DISABLE_JIT=1)")
    if parser.parse_args().json:
        # The start of a drive is no part of an interval.
        both = count(INTERVALS + 1), count(1)
        print(json.dumps({kind: (both[0][kind] - both[1][kind]) / INTERVALS for kind in both[0]}))
        return
    found = operations()
    for kind, number in found.items():
        print(f"{kind:10s} {number:9.0f}" + (f"  counted {WEIGHTS[kind]} times" if kind in WEIGHTS else ""))


if __name__ == "__main__":
    main()
