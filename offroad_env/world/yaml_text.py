"""YAML as all of the project reads it: numbers as people write them, no key twice, errors with a line."""

from __future__ import annotations

import re
import reprlib
from typing import Any

import yaml

from offroad_env.errors import DataError

__all__ = ["parse_yaml", "shown"]


#: Most values of a file, each counted as often as an alias repeats it: a few lines of aliases of aliases
#: would be billions.
_MOST_VALUES = 10_000
#: Longest text that is parsed [characters].
_LONGEST = 1_000_000


class _Loader(yaml.SafeLoader):
    """YAML with 1e5 and 13.19e3 as numbers, which YAML 1.1 reads as text, and with bounded aliases."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._values = 0
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """A node, or what an alias stands for, counted."""
        before, is_alias = self._values, self.check_event(yaml.AliasEvent)
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]  # PyYAML has no types for this
        self._values += 1
        node = super().compose_node(parent, index)
        if is_alias:
            if id(node) not in self._sizes:
                raise yaml.MarkedYAMLError(
                    problem="an alias inside of what it names", problem_mark=event.start_mark
                )
            self._values += self._sizes[id(node)]
        else:
            self._sizes[id(node)] = self._values - before
        if self._values > _MOST_VALUES:
            raise yaml.MarkedYAMLError(
                problem=f"more than {_MOST_VALUES} values, counting what aliases repeat",
                problem_mark=event.start_mark,
            )
        return node


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(
    text: str, file: str, *, about: str, dotted: bool = False
) -> tuple[dict[str, Any], dict[str, int]]:
    """Content of a YAML file, and the line of every key path (``"vehicle.m"``).

    ``about`` completes the sentence "it must describe ...". With ``dotted``, a dotted key
    (``imu.kinematic: false``) sets one value inside a section and replaces what stands there or in an earlier
    such line, so that a line at the end of a file changes it.

    Raises
    ------
    DataError
        For a syntax error, a key given twice, or anything but a mapping, with file and line.
    """
    loader = None
    if len(text) > _LONGEST:
        raise DataError(f"{file}: has {len(text)} characters; at most {_LONGEST} of YAML are read")
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        lines: dict[str, int] = {}
        apart = _take_dotted(node) if dotted else []
        _note_lines(node, "", lines, file)
        data = None if node is None else loader.construct_document(node)
        for key, value in apart:
            own: dict[str, int] = {}
            _note_lines(value, key.value, own, file)
            _set_dotted(data, key.value, loader.construct_document(value), file, key.start_mark.line + 1)
            lines.update(own | {key.value: key.start_mark.line + 1})
    except DataError:
        raise
    except yaml.YAMLError as error:
        raise DataError(_syntax(error, text, file)) from None
    except (ValueError, TypeError, OverflowError, LookupError, AttributeError) as error:
        # A tag that does not fit its value (`!!bool 7`, `!!timestamp foo`) fails inside the parser like this.
        raise DataError(f"{file}: a value cannot be read: {str(error)[:120]}") from None
    except RecursionError:
        raise DataError(f"{file}: nested too deeply to describe {about}") from None
    finally:
        if loader is not None:
            loader.dispose()
    if data is None:
        raise DataError(f"{file}: is empty; it must describe {about}")
    if not isinstance(data, dict):
        raise DataError(f"{file}, line 1: must hold keys with values (vehicle: ...), got {shown(data)}")
    return data, lines


def _syntax(error: yaml.YAMLError, text: str, file: str) -> str:
    mark, position = getattr(error, "problem_mark", None), getattr(error, "position", None)
    line = mark.line + 1 if mark else text.count("\n", 0, position) + 1 if position else None
    where = "" if line is None else f", line {line}"
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML"
    return f"{file}{where}: YAML syntax: {problem}"


def _note_lines(node: yaml.Node | None, path: str, lines: dict[str, int], file: str) -> None:
    """Lines of all keys; refuses a key that stands twice in one mapping (YAML would keep the last)."""
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        name = f"{path}.{key.value}" if path else str(key.value)
        line = key.start_mark.line + 1
        if name in lines:
            raise DataError(f"{file}, line {line}: {name} is given twice, first in line {lines[name]}")
        lines[name] = line
        _note_lines(value, name, lines, file)


def _take_dotted(node: yaml.Node | None) -> list[tuple[yaml.ScalarNode, yaml.Node]]:
    """Take the dotted keys of the top mapping out of it, in their order."""
    if not isinstance(node, yaml.MappingNode):
        return []
    taken = [
        (key, value)
        for key, value in node.value
        if isinstance(key, yaml.ScalarNode) and "." in key.value.strip(".") and " " not in key.value
    ]
    node.value = [pair for pair in node.value if not any(pair[0] is key for key, _ in taken)]
    return taken


def _set_dotted(data: Any, path: str, value: Any, file: str, line: int) -> None:
    """Set the value at a dotted path; sections that are missing are made."""
    *sections, last = path.split(".")
    inner = data
    for name in sections:
        if not isinstance(inner, dict):
            break
        inner = inner.setdefault(name, {})
    if not isinstance(inner, dict):
        raise DataError(
            f"{file}, line {line}: {path} sets a value inside {shown(inner)}, which is no section"
        )
    inner[last] = value


class _Short(reprlib.Repr):
    """``repr`` that never takes long: of nested and repeated values the beginning."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother, self.maxlong = 3, 60, 60, 60

    def repr_int(self, x: int, level: int) -> str:
        """A number with thousands of digits cannot be written out."""
        return repr(x) if x.bit_length() <= 200 else f"a number of {x.bit_length()} bits"


_SHORT = _Short()


def shown(value: object) -> str:
    """A value as an error quotes it, cut to 40 characters."""
    text = _SHORT.repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
