"""Compares the results of two commits leaf by leaf, for `golden`.

A case belongs to a class, which says what may differ:

moved
    Nothing: only the place of the code has changed.
open_loop
    Numbers by 1e-9, relative: sums were merged, nothing is iterated.
fitted
    Numbers that iterations have found: by 1 % of the standard deviation that is stated beside them (`sd`,
    `deviation`, or the interval `low` ... `high`). What has none beside it - losses, statistics, curves - by
    1e-5, relative: a unit of the sixth digit, to which reports are rounded.

Where numbers may differ, those inside of sentences may by one unit of their last digit. Strings are equal
otherwise; so are booleans, whole numbers, and which leaves there are.

What differs beyond that is listed one by one, each with its reason, in a YAML file of entries:

- ``case``: glob over the names of cases; ``path``: glob over the path of a leaf as it is printed (default:
  all); ``reason``: why. And one of
- ``rename: {old: new}``: words of keys and strings in the base's results that are called otherwise now;
- ``move: {old: new}``: keys of the base that lead to a leaf, joined by dots, and those that lead there now:
  ``mse: score.mse`` is a level deeper;
- ``arguments: {old: new}``: the same for the words of the commands, which are those of the base;
- ``allow: added | removed | changed``: leaves that may come, go or change; ``changed`` with
  ``tolerance: 0.001`` holds the change to that size, relative;
- ``allow: open_loop | fitted``: leaves for which that class holds in place of their case's.

An entry that nothing needs is an error, so that the list cannot rot - but for one with ``varies: true``,
which not every machine needs: policies multiply matrices by the processor's own routines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase, translate
from pathlib import Path
from typing import Any

import yaml

__all__ = ["CLASSES", "Comparison", "Entry", "compare", "read_entries", "renamed_words", "unused"]

CLASSES = ("moved", "open_loop", "fitted")
OPEN_LOOP, SHARE_OF_SD, UNSTATED = 1e-9, 0.01, 1e-5
#: Numbers below this are zero with rounding errors, by class.
FLOOR = {"open_loop": 1e-12, "fitted": 1e-9}
_Z = 1.959964  #: of a 95 % interval

#: Paths whose leaves depend on the machine's speed, the day or the place, and why.
LEFT_OUT = {
    "*.stamp": "digest of the sources",
    "*.made_by": "versions",
    "*.version": "versions",
    "*.command": "names files",
    "*.real_time": "simulated over processor time",
    "*.real_time_factor": "simulated over processor time",
    "*.seconds": "run time",
    "*.microseconds": "run time",
    "*core seconds.*": "run time",
    "*.wall_time": "run time",
    "*.step_time": "run time",
    "*.env_time": "run time",
    "*.periods_per_second": "run time",
}
_LEFT_OUT = re.compile("|".join(map(translate, LEFT_OUT)))
#: Paths of numbers that are written with few digits, with one unit of the last one.
ROUNDED = {"*cosines.*": 1.001e-3}

#: Numbers that a standard deviation beside them is of; the others there may be of another unit.
_STATED = ("value", "size", "n", "gain", "low", "high", "sd", "deviation")
#: Lists of (number, standard deviation).
_PAIRS = ("sizes", "evidence")

Leaf = str | int | float | bool | None
Place = tuple[str | int, ...]
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class BadEntryError(ValueError):
    """The list of differences is not what it should be."""


@dataclass
class Entry:
    """A difference that is meant, see above."""

    case: str
    reason: str
    path: str = "*"
    allow: str = ""
    tolerance: float = math.inf
    rename: Mapping[str, str] = field(default_factory=dict)
    move: Mapping[str, str] = field(default_factory=dict)
    arguments: Mapping[str, str] = field(default_factory=dict)
    varies: bool = False  #: the machine decides whether it is needed
    used: int = 0  #: leaves or words that needed it

    def __post_init__(self) -> None:
        if not self.case or not self.reason:
            raise BadEntryError(f"an entry needs case and reason: {self}")
        if sum(map(bool, (self.allow, self.rename, self.move, self.arguments))) != 1:
            raise BadEntryError(f"an entry needs one of allow, rename, move and arguments: {self}")
        if self.allow not in ("", "added", "removed", "changed", *CLASSES[1:]):
            raise BadEntryError(f"allow must be added, removed, changed, open_loop or fitted: {self}")

    def covers(self, case: str, name: str) -> bool:
        """Whether a leaf of a case is meant."""
        return fnmatchcase(case, self.case) and fnmatchcase(name, self.path)

    def __str__(self) -> str:
        words = self.rename or self.move or self.arguments
        what = self.allow or ", ".join(f"{a} -> {b}" for a, b in words.items())
        return f"{self.case}: {self.path}: {what} - {self.reason}"


def read_entries(path: Path) -> list[Entry]:
    """The list of differences; a file that is not there is an empty one."""
    found = yaml.safe_load(path.read_text(encoding="utf-8")) if path.is_file() else None
    try:
        return [Entry(**entry) for entry in found or ()]
    except TypeError as error:
        raise BadEntryError(f"{path.name}: {error}") from error


def unused(entries: Sequence[Entry], compared: Sequence[str], known: Sequence[str]) -> list[Entry]:
    """Entries that nothing needed although every case that they speak of was compared."""
    return [
        entry
        for entry in entries
        if not (entry.used or entry.varies)
        and all(name in compared for name in known if fnmatchcase(name, entry.case))
    ]


def renamed_words(text: str, words: Mapping[str, str]) -> str:
    """``text`` with whole words replaced, all at once."""
    if not words:
        return text
    pattern = "|".join(re.escape(word) for word in sorted(words, key=len, reverse=True))
    return re.sub(rf"(?<!\w)(?:{pattern})(?!\w)", lambda match: words[match[0]], text)


def moved_place(place: Place, moves: Mapping[str, str]) -> Place:
    """``place`` with the first row of keys that ``moves`` names replaced."""
    for old, new in moves.items():
        keys = tuple(old.split("."))
        for i in range(len(place) - len(keys) + 1):
            if place[i : i + len(keys)] == keys:
                return (*place[:i], *new.split("."), *place[i + len(keys) :])
    return place


@dataclass
class Comparison:
    """What came out of one case."""

    case: str
    kind: str
    leaves: int = 0
    identical: int = 0
    within: int = 0  #: differ, by less than their class takes
    allowed: int = 0  #: differ, and an entry says so
    largest: float = 0.0  #: difference within the class, as a share of what it takes
    where: str = ""  #: its leaf
    different: list[str] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        """In a few words."""
        if self.different:
            return f"DIFFERENT: {len(self.different)} of {self.leaves} leaves"
        meant = f", {self.allowed} as listed" if self.allowed else ""
        if self.within:
            largest = f"{self.within} leaves, largest {self.largest:.2g} of it: {self.where}"
            return f"within tolerance ({largest}){meant}"
        return f"identical ({self.identical} leaves){meant}"


def leaves_of(value: Any, place: Place = ()) -> Iterator[tuple[Place, Leaf]]:
    """Every leaf of a JSON value with its place; what is empty is a leaf, too."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from leaves_of(item, (*place, key))
    else:
        yield place, ("{}" if isinstance(value, dict) else "[]" if isinstance(value, list) else value)


def name_of(place: Place) -> str:
    """A place as it is printed and matched."""
    return ".".join(map(str, place))


def left_out(name: str) -> bool:
    """Whether a leaf depends on the machine's speed, the day or the place."""
    return _LEFT_OUT.fullmatch(name) is not None


def compare(case: str, kind: str, base: Any, new: Any, entries: Sequence[Entry] = ()) -> Comparison:
    """Two results of a case, leaf by leaf; counts in ``entries`` which of them were needed."""
    entries = [entry for entry in entries if fnmatchcase(case, entry.case)]
    old = _renamed(case, dict(leaves_of(base)), [entry for entry in entries if entry.rename or entry.move])
    now = dict(leaves_of(new))
    result = Comparison(case, kind)
    for place in dict.fromkeys([*old, *now]):
        name = name_of(place)
        if left_out(name):
            continue
        result.leaves += 1
        meant = [entry for entry in entries if entry.allow and entry.covers(case, name)]
        if place not in now or place not in old:
            word, side = ("added", now) if place in now else ("removed", old)
            useful = [entry for entry in meant if entry.allow == word]
            _settle(result, f"{name}: {word}: {_short(side[place])}", useful)
        else:
            _compare_leaf(result, place, (old, now), meant)
    return result


def _renamed(case: str, leaves: dict[Place, Leaf], entries: Sequence[Entry]) -> dict[Place, Leaf]:
    if not entries:
        return leaves
    result: dict[Place, Leaf] = {}
    for place, leaf in leaves.items():
        name, new_place, new_leaf = name_of(place), place, leaf
        for entry in entries:
            if entry.covers(case, name) and not left_out(name):
                before = (new_place, new_leaf)
                new_place = moved_place(new_place, entry.move)
                new_place = tuple(
                    renamed_words(key, entry.rename) if isinstance(key, str) else key for key in new_place
                )
                new_leaf = renamed_words(new_leaf, entry.rename) if isinstance(new_leaf, str) else new_leaf
                entry.used += before != (new_place, new_leaf)
        if new_place in result:
            raise BadEntryError(f"{case}: by a rename two leaves are called {name_of(new_place)}")
        result[new_place] = new_leaf
    return result


def _compare_leaf(
    result: Comparison,
    place: Place,
    sides: tuple[dict[Place, Leaf], dict[Place, Leaf]],
    meant: Sequence[Entry],
) -> None:
    old, new = (side[place] for side in sides)
    if _identical(old, new):
        result.identical += 1
        return
    share = share_of_tolerance(place, *sides, result.kind)
    if share <= 1.0:
        result.within += 1
        if share >= result.largest:
            result.largest, result.where = share, f"{name_of(place)}: {_short(old)} -> {_short(new)}"
        return
    useful = [
        entry
        for entry in meant
        if (entry.allow == "changed" and _relative(old, new) <= entry.tolerance)
        or (entry.allow in CLASSES and share_of_tolerance(place, *sides, entry.allow) <= 1.0)
    ]
    much = f" ({_relative(old, new):.1e} relative)" if _is_number(old) and _is_number(new) else ""
    _settle(result, f"{name_of(place)}: {_short(old)} -> {_short(new)}{much}", useful)


def _settle(result: Comparison, said: str, useful: Sequence[Entry]) -> None:
    """A leaf that differs: listed, or a fault."""
    if useful:
        result.allowed += 1
        useful[0].used += 1
    else:
        result.different.append(said)


def _is_number(leaf: Leaf) -> bool:
    return isinstance(leaf, int | float) and not isinstance(leaf, bool)


def _is_finite(leaf: Leaf) -> bool:
    return _is_number(leaf) and math.isfinite(leaf)


def _identical(old: Leaf, new: Leaf) -> bool:
    if _is_number(old) and _is_number(new):
        return old == new or (math.isnan(old) and math.isnan(new))
    return type(old) is type(new) and old == new


def _relative(old: Leaf, new: Leaf) -> float:
    """Difference over the larger of both; infinite where they are no numbers."""
    if not (_is_finite(old) and _is_finite(new)):
        return math.inf
    return abs(old - new) / max(abs(old), abs(new), 1e-300)


def share_of_tolerance(
    place: Place, old_leaves: Mapping[Place, Leaf], new_leaves: Mapping[Place, Leaf], kind: str
) -> float:
    """How much of what a class takes a leaf differs by; infinite where nothing may differ."""
    old, new = old_leaves[place], new_leaves[place]
    if kind == "moved":
        return math.inf
    if isinstance(old, str) and isinstance(new, str):
        return 1.0 if same_text(old, new) else math.inf
    counts = isinstance(old, int) and isinstance(new, int)
    if counts or not (_is_finite(old) and _is_finite(new)):
        return math.inf
    size = max(abs(old), abs(new))
    limit = max(FLOOR[kind], OPEN_LOOP * size)
    if kind == "fitted":
        deviation = stated_deviation(place, old_leaves)
        limit = max(limit, UNSTATED * size if deviation is None else SHARE_OF_SD * deviation)
    name = name_of(place)
    limit = max([limit, *(unit for pattern, unit in ROUNDED.items() if fnmatchcase(name, pattern))])
    return abs(old - new) / limit


def stated_deviation(place: Place, leaves: Mapping[Place, Leaf]) -> float | None:
    """The standard deviation that stands beside a number: in its record, its row or its pair."""
    at = next((i for i in reversed(range(len(place))) if isinstance(place[i], str)), None)
    if at is None:
        return None

    def beside(key: str) -> float | None:
        leaf = leaves.get((*place[:at], key, *place[at + 1 :]))
        return float(leaf) if _is_finite(leaf) else None

    key = place[at]
    if key in _PAIRS and place[-1] in (0, 1):
        second = leaves.get((*place[:-1], 1))
        third = (*place[:-1], 2) in leaves
        return abs(float(second)) if _is_number(second) and not third else None
    if key.startswith("evidence_"):
        return beside("evidence_sd")
    if (own := beside(f"{key}_sd")) is not None:
        return abs(own)
    if key not in _STATED:
        return None
    for other in ("sd", "deviation"):
        if (own := beside(other)) is not None:
            return abs(own)
    low, high = beside("low"), beside("high")
    return None if low is None or high is None else abs(high - low) / (2.0 * _Z)


def same_text(old: str, new: str) -> bool:
    """Whether two sentences differ by one unit in the last digit of measures and percentages at most."""
    if _NUMBER.sub("#", old) != _NUMBER.sub("#", new):
        return False
    for first, second in zip(_NUMBER.finditer(old), _NUMBER.finditer(new), strict=True):
        count = not any(mark in first[0] + second[0] for mark in ".e")
        if first[0] != second[0] and count and not old[first.end() :].lstrip().startswith("%"):
            return False
        unit = min(_last_digit(first[0]), _last_digit(second[0]))
        if abs(float(first[0]) - float(second[0])) > 1.001 * unit:
            return False
    return True


def _last_digit(number: str) -> float:
    """What the last digit of a printed number is worth."""
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def _short(leaf: Leaf) -> str:
    text = repr(leaf)
    return text if len(text) <= 90 else f"{text[:87]}..."
