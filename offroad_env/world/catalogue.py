"""Named, sourced records (soils, vehicles) and the checks that their factories share."""

from __future__ import annotations

import math
import operator
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType
from typing import Generic, SupportsFloat, TypeVar

from offroad_env.errors import InvalidParameter
from offroad_env.world.yaml_text import shown

__all__ = ["Catalogue", "Entry", "Quantity", "UnknownNameError", "given_fields"]

R = TypeVar("R")


class UnknownNameError(InvalidParameter, KeyError):
    """A catalogue has no entry of this name; the message lists the nearest ones.

    It is a ``KeyError`` too, so that ``name in catalogue`` and ``catalogue.get`` work as for a dict.
    """

    # KeyError shows its argument quoted; the message of this project is a sentence.
    __str__ = Exception.__str__


@dataclass(frozen=True, kw_only=True, slots=True)
class Entry(Generic[R]):
    """One record of a catalogue, with what a reader needs to trust it."""

    name: str  #: key in the catalogue
    record: R  #: the validated record
    title: str  #: what it is, in a few words
    source: str  #: where the numbers come from
    remark: str  #: which numbers are not from that source, and why they are what they are


class Catalogue(Mapping[str, R]):
    """Read-only mapping from names to records; ``entry(name)`` adds title, source and remark.

    Parameters
    ----------
    kind
        What the records are, for messages ("soil").
    entries
        The entries, in the order in which they are listed. Names must differ.
    """

    __slots__ = ("_entries", "_kind")

    def __init__(self, kind: str, entries: Iterable[Entry[R]]) -> None:
        table: dict[str, Entry[R]] = {}
        for entry in entries:
            if entry.name in table:
                raise InvalidParameter(f"the {kind} catalogue has two entries named {entry.name!r}")
            table[entry.name] = entry
        self._kind = kind
        self._entries = MappingProxyType(table)

    def entry(self, name: str) -> Entry[R]:
        """The entry with its title, source and remark.

        Raises
        ------
        UnknownNameError
            If there is none of that name; the message lists the nearest names.
        """
        try:
            return self._entries[name]
        except (KeyError, TypeError):
            raise UnknownNameError(self._unknown(name)) from None

    def register(self, entry: Entry[R]) -> None:
        """Add an entry, or replace one; of one's own, see `world.descriptions.register_soil`."""
        self._entries = MappingProxyType({**self._entries, entry.name: entry})

    def remove(self, name: str) -> None:
        """Take out an entry that was registered."""
        self._entries = MappingProxyType({key: e for key, e in self._entries.items() if key != name})

    def _unknown(self, name: object) -> str:
        wanted = str(name).lower().replace(" ", "_").replace("-", "_")
        near = get_close_matches(wanted, self._entries, n=4, cutoff=0.4)
        words = [word for word in wanted.split("_") if len(word) > 2]
        near += [other for other in self._entries if other not in near and any(w in other for w in words)]
        if near:
            return f"no {self._kind} named {name!r} - did you mean one of {', '.join(near[:5])}?"
        return f"no {self._kind} named {name!r}; known: {', '.join(self._entries)}"

    def __getitem__(self, name: str) -> R:
        return self.entry(name).record

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __repr__(self) -> str:
        width = max((len(name) for name in self._entries), default=0)
        lines = [f"  {name:<{width}}  {entry.title}" for name, entry in self._entries.items()]
        return f"<{len(self)} {self._kind}s; .entry(name) gives the source of each>\n" + "\n".join(lines)

    def __reduce__(self) -> tuple[type[Catalogue[R]], tuple[str, tuple[Entry[R], ...]]]:
        # A mapping proxy does not pickle: rebuild from the entries.
        return (type(self), (self._kind, tuple(self._entries.values())))


@dataclass(frozen=True, slots=True)
class Quantity:
    """Allowed range of one parameter and the mistakes that lead outside it.

    ``mistakes`` are closed intervals, each with the likely mistake behind a value inside it; such a
    value is refused even where it lies within ``low ... high``.
    """

    allowed: str  #: the range as the message shows it, with unit
    low: float
    high: float
    low_open: bool = False
    high_open: bool = False
    mistakes: tuple[tuple[float, float, str], ...] = ()

    def check(self, name: str, value: SupportsFloat) -> float:
        """Return ``value`` as a float, or refuse it.

        Raises
        ------
        InvalidParameter
            Naming the parameter, its value, the allowed range and the likely mistake.
        """
        # The short way for what is as it should be.
        if type(value) is float and self.low < value < self.high and not self._mistaken(value):
            return value
        number = self._number(name, value)
        for low, high, mistake in self.mistakes:
            if low <= number <= high:
                raise InvalidParameter(f"{name} must be {self.allowed}, got {number:g} - {mistake}?")
        above = operator.gt if self.low_open else operator.ge
        below = operator.lt if self.high_open else operator.le
        if not (above(number, self.low) and below(number, self.high)):
            raise InvalidParameter(f"{name} must be {self.allowed}, got {number:g}")
        return number

    def _mistaken(self, number: float) -> bool:
        """Whether a number lies where there is a likely mistake behind it."""
        for low, high, _ in self.mistakes:  # noqa: SIM110 - a generator would cost more than the rest
            if low <= number <= high:
                return True
        return False

    def _number(self, name: str, value: SupportsFloat) -> float:
        if isinstance(value, (str, bytes, bool)):
            raise InvalidParameter(f"{name} must be a number {self.allowed}, got {shown(value)}")
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            raise InvalidParameter(f"{name} must be one number {self.allowed}, got {shown(value)}") from None
        if not math.isfinite(number):
            raise InvalidParameter(f"{name} must be {self.allowed}, got {number}")
        return number


def given_fields(
    factory: str, fields: Mapping[str, float | None], known: Collection[str]
) -> dict[str, float]:
    """Fields of a record that were given to its factory, in the order of ``known``; None: not given.

    Raises
    ------
    TypeError
        As for any misspelt keyword, if the record has no such field; the message names the nearest one.
    """
    for name in fields:
        if name not in known:
            near = get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f" - did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"
            raise TypeError(f"{factory}() got an unexpected field {name!r}{hint}")
    return {name: value for name in known if (value := fields.get(name)) is not None}
