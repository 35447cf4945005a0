"""Windows of a run, which are simulated one by one, and their use: fit, hold-out test or report."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

__all__ = ["FIT", "REPORT", "SELECT", "SHORTEST", "Windows", "cut", "stretches_of"]

#: Use of a window: the search, its hold-out tests, and the report, which is evaluated once at the end.
FIT, SELECT, REPORT = 0, 1, 2
#: Shares of the time, and the least time between them [s].
_SHARES = (0.6, 0.2, 0.2)
_APART = 5.0
#: A shorter run is all for the search, without a hold-out test [s].
SHORTEST = 20.0
#: Wanted length of a window [s]: long enough for a wrong force to change the speed visibly.
_LENGTH = 4.0
#: The actuators' inputs before the first row are unknown; their effect lasts about so long [s].
_LEAD_IN = 1.0
#: Least length of a stretch between two interruptions that gets a start of its own [s].
_LEAST = 1.0


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Windows of one run on its grid of instants; row i of the records of window w is instant first + i."""

    first: np.ndarray  #: (W,) index of the first instant
    count: np.ndarray  #: (W,) steps of the grid
    use: np.ndarray  #: (W,) FIT, SELECT or REPORT

    @property
    def begin(self) -> np.ndarray:
        """(W + 1,) first record of every window, and the number of records."""
        return np.concatenate([[0], np.cumsum(self.count + 1)])

    def only(self, use: int) -> Windows:
        """The windows for one use."""
        keep = self.use == use
        return Windows(first=self.first[keep], count=self.count[keep], use=self.use[keep])

    def __len__(self) -> int:
        return len(self.first)


def _pieces(start: int, stop: int, length: float) -> list[tuple[int, int]]:
    """``start ... stop`` in equal windows as near to the wanted length as they divide it."""
    count = max(round((stop - start) / length), 1)
    edges = np.linspace(start, stop, count + 1).round().astype(int)
    return list(pairwise(edges))


def stretches_of(usable: np.ndarray, lead: int, shortest: int) -> list[tuple[int, int]]:
    """Stretches of usable steps that are long enough, each without its first ``lead`` steps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]])))
    pairs = zip(edges[::2] + lead, edges[1::2], strict=True)
    return [(int(a), int(b)) for a, b in pairs if b - a >= shortest]


def _parts(start: int, stop: int, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Pieces of the steps ``start ... stop``, counted through the stretches alone."""
    parts, before = [], 0
    for a, b in stretches:
        low, high = max(start - before, 0), min(stop - before, b - a)
        if high > low:
            parts.append((a + low, a + high))
        before += b - a
    return parts


def cut(
    steps: int,
    step: float,
    whole: int | None = None,
    usable: np.ndarray | None = None,
    scale: float = 1.0,
) -> Windows:
    """Windows over a run of ``steps`` steps of ``step`` [s].

    Parameters
    ----------
    whole
        What the whole run is for, where several runs share the work; else it is divided by time:
        the search gets the first part, then the hold-out test, then the report, with 5 s left out
        between.
    usable
        (steps,) false where nothing may be simulated; default everywhere. Windows lie in one
        stretch each, and the time is that of the stretches.
    scale
        Of the length of a window.
    """
    lead = round(_LEAD_IN / step)
    if usable is None:
        stretches, shortest = [(lead, steps)], 1
    else:
        shortest = round(_LEAST / step)
        stretches = stretches_of(usable, lead, shortest)
    total = sum(b - a for a, b in stretches)
    if whole is None and (lead + total) * step < SHORTEST:
        whole = FIT
    if whole is not None:
        blocks = [(0, total, whole)]
    else:
        gap = round(_APART / step)
        ends = np.round(max(total - 2 * gap, 0) * np.cumsum(_SHARES)).astype(int)
        starts = np.array([0, ends[0] + gap, ends[1] + 2 * gap])
        lengths = np.diff(np.concatenate([[0], ends]))
        blocks = [(int(a), int(a + n), use) for use, (a, n) in enumerate(zip(starts, lengths, strict=True))]
    rows = [
        (a, b - a, use)
        for start, stop, use in blocks
        for low, high in _parts(start, stop, stretches)
        for a, b in _pieces(low, high, scale * _LENGTH / step)
        if b - a >= shortest
    ]
    table = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return Windows(first=table[:, 0], count=table[:, 1], use=table[:, 2])
