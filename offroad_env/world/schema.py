"""What a description in YAML, JSON or a mapping may hold: keys with unit, range, default and meaning.

One `SectionSchema` for each kind of thing. Names of keys, units and meanings are those of the record that is
made (the comments at its fields), ranges those of its factory, so that neither can differ from the code.
pydantic finds all problems of a description at once.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from offroad_env.errors import InvalidParameter
from offroad_env.world.catalogue import Quantity
from offroad_env.world.yaml_text import shown

if TYPE_CHECKING:  # it takes a fifth of the time in which an environment starts, and few read a description
    from pydantic import BaseModel

__all__ = ["CheckedBy", "KeyRow", "Problem", "SchemaError", "SectionSchema", "field_comments"]

#: ``m: float  #: total mass [kg]`` at a field of a record.
_COMMENT = re.compile(r"^    (\w+): [^#\n]*#: (.*)$", re.MULTILINE)
_UNIT = re.compile(r"\[([^\]]+)\]")


class Problem(NamedTuple):
    """One thing that is wrong in a description."""

    key: str  #: path of the key below the section, "imu.rate"; "" where it is the whole
    sentence: str  #: what, the allowed range and the likely mistake


class SchemaError(InvalidParameter):
    """A description that cannot be used; ``problems`` are all that is wrong, the message states them."""

    def __init__(self, where: str, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(f"{where}: " + "; ".join(problem.sentence for problem in self.problems))

    def __reduce__(self) -> tuple[Any, ...]:
        where = str(self).partition(": ")[0]
        return (type(self), (where, self.problems))


class KeyRow(NamedTuple):
    """A row of the reference table."""

    key: str
    unit: str
    allowed: str
    default: str
    meaning: str


class CheckedBy(NamedTuple):
    """``Annotated[type, CheckedBy(function)]``: the function checks and converts what is given."""

    check: Callable[[Any], Any]


@cache
def field_comments(record: type) -> dict[str, str]:
    """Field of a record -> the comment that stands beside it in its source."""
    return dict(_COMMENT.findall(inspect.getsource(record)))


@dataclass(frozen=True, kw_only=True)
class SectionSchema:
    """The keys of one kind of description, from which a record is made."""

    name: str  #: of the section, "soil"
    about: str  #: what it is, in one sentence
    records: tuple[type, ...]  #: whose fields and comments the keys are
    ranges: Mapping[str, Quantity]  #: keys with numbers
    #: values where neither the description nor a base has the key; keys without one are needed
    defaults: Mapping[str, object] = field(default_factory=dict)
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  #: keys with words
    flags: tuple[str, ...] = ()  #: keys that are true or false
    others: Mapping[str, tuple[Any, str]] = field(default_factory=dict)  #: key -> (type, allowed, in words)
    meanings: Mapping[str, str] = field(default_factory=dict)  #: of keys that the record has not, with unit
    bases: Callable[[], Iterable[str]] | None = None  #: names that ``base`` takes; None: there is no base

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys, in the order of the table."""
        base = () if self.bases is None else ("base",)
        return (*base, *self.choices, *self.ranges, *self.flags, *self.others)

    @cached_property
    def model(self) -> type[BaseModel]:
        """The pydantic model; every key may be left out."""
        from pydantic import BeforeValidator, ConfigDict, create_model

        fields: dict[str, Any] = {} if self.bases is None else {"base": (Any, None)}
        for key, words in self.choices.items():
            fields[key] = (Annotated[str | None, BeforeValidator(partial(_one_of, key, words))], None)
        for key, quantity in self.ranges.items():
            fields[key] = (Annotated[float | None, BeforeValidator(partial(_number, key, quantity))], None)
        for key in self.flags:
            fields[key] = (Annotated[bool | None, BeforeValidator(partial(_flag, key))], None)
        for key, (kind, _) in self.others.items():
            if checks := [mark for mark in getattr(kind, "__metadata__", ()) if isinstance(mark, CheckedBy)]:
                kind = Annotated[kind.__origin__, *(BeforeValidator(mark.check) for mark in checks)]
            fields[key] = (kind, None)
        return create_model(self.name, __config__=ConfigDict(extra="forbid"), **fields)

    def check(
        self, given: Mapping[str, Any], where: str | None = None, lines: Mapping[str, int] | None = None
    ) -> dict[str, Any]:
        """The keys that are given, checked one by one, numbers as floats.

        ``where`` begins the message; ``lines`` are those of the keys, where they come from a file.

        Raises
        ------
        SchemaError
            With everything that is wrong, not only the first.
        """
        from pydantic import ValidationError

        if not isinstance(given, Mapping):
            raise InvalidParameter(f"{where or self.name} must hold keys with values, got {shown(given)}")
        try:
            found = self.model.model_validate({str(key): value for key, value in given.items()})
        except ValidationError as error:
            found_lines = lines or {}
            problems = [self._problem(entry) for entry in error.errors()]
            problems.sort(key=lambda problem: found_lines.get(problem.key, 0))
            placed = [
                problem._replace(sentence=f"line {found_lines[problem.key]}: {problem.sentence}")
                if problem.key in found_lines
                else problem
                for problem in problems
            ]
            raise SchemaError(where or self.name, placed) from None
        return {key: getattr(found, key) for key in self.keys if key in found.model_fields_set}

    def _problem(self, error: Any) -> Problem:
        path = ".".join(map(str, error["loc"]))
        if error["type"] == "extra_forbidden":
            near = get_close_matches(path, self.keys, n=1, cutoff=0.4)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(self.keys)}"
            return Problem(path, f"{path!r} is not a key of {self.name} - {hint}")
        cause = error.get("ctx", {}).get("error")
        if cause is not None:
            return Problem(path, str(cause))
        return Problem(path, f"{path}: {error['msg']}, got {shown(error['input'])}")

    def table(self) -> list[KeyRow]:
        """The rows of the reference table."""
        return [self._row(key) for key in self.keys]

    def _row(self, key: str) -> KeyRow:
        if key == "base":
            return KeyRow(
                "base", "-", "a name, a file, or a description", "none", "where the rest comes from"
            )
        comments = {name: text for record in self.records for name, text in field_comments(record).items()}
        comment = self.meanings.get(key) or comments.get(key, "")
        unit = _UNIT.search(comment)
        meaning = _UNIT.sub("", comment, count=1).strip().replace(" ,", ",").replace(" ;", ";")
        default = self.defaults.get(key, "needed")
        return KeyRow(
            key=key,
            unit=unit.group(1) if unit else "-",
            allowed=self._allowed(key),
            default=_default(default),
            meaning=re.sub(r"\s+", " ", meaning),
        )

    def _allowed(self, key: str) -> str:
        if key in self.ranges:
            return self.ranges[key].allowed
        if key in self.choices:
            return ", ".join(self.choices[key])
        return "true, false" if key in self.flags else self.others[key][1]


def _default(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_default, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _number(key: str, quantity: Quantity, value: Any) -> float:
    if value is None:
        raise InvalidParameter(f"{key} has no value")
    return quantity.check(key, value)


def _one_of(key: str, words: tuple[str, ...], value: Any) -> str:
    if value not in words:
        near = get_close_matches(str(value), words, n=1, cutoff=0.5)
        hint = f" - did you mean {near[0]!r}?" if near else ""
        raise InvalidParameter(f"{key} must be one of {', '.join(words)}, got {shown(value)}{hint}")
    return str(value)


def _flag(key: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise InvalidParameter(f"{key} must be true or false, got {shown(value)}")
    return value
