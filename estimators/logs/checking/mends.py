"""Findings with the lines of the YAML that mend them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

__all__ = ["Line", "Remark", "last_lines", "yaml_text"]

_PLAIN = re.compile(r"[A-Za-z_/][\w/.\-]*( [A-Za-z_/^0-9][\w/.^\-]*)*")
_WORDS = {"true", "false", "null", "yes", "no", "on", "off", "none", "y", "n", "~"}


@dataclass(frozen=True)
class Line:
    """One line to add to the YAML: a dotted key with its value."""

    key: str
    value: Any

    def __str__(self) -> str:
        return f"{self.key}: {yaml_text(self.value)}"


@dataclass(frozen=True, kw_only=True)
class Remark:
    """Something that a check found."""

    severity: str  #: "problem" (no command goes on), "warning", "note"
    sentence: str
    lines: tuple[Line, ...] = ()  #: to add to the YAML; empty where no line mends it


def yaml_text(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {yaml_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(yaml_text(item) for item in value) + "]"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS and ": " not in value
        number = re.fullmatch(r"\d+(\.\d+)? (deg|Hz)", value)
        return value if plain or number else json.dumps(value, ensure_ascii=False)
    return repr(value)


def last_lines(remarks: Iterable[Remark]) -> dict[str, Line]:
    """Key -> line, the last one of each key, in the order of the keys' first appearance."""
    found: dict[str, Line] = {}
    for remark in remarks:
        for line in remark.lines:
            found[line.key] = line
    return found
