"""YAML read strictly: every error names the file, the line and the key."""

from __future__ import annotations

import re
from typing import Any, TypeVar, overload

import yaml

from estimators.logs.schema import nearest
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.catalogue import Quantity

__all__ = ["KeyedError", "Section", "parse_yaml", "shown"]


class _Loader(yaml.SafeLoader):
    """YAML with 1e5 and 13.19e3 as numbers, which YAML 1.1 reads as text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(text: str, file: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Content of a YAML file, and the line of every key path (``"vehicle.m"``).

    A dotted key (``imu.kinematic: false``) sets one value inside a section and replaces what stands there,
    so that a line at the end of a file changes it.

    Raises
    ------
    DataError
        For a syntax error, a key given twice, or anything but a mapping, with file and line.
    """
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        lines: dict[str, int] = {}
        dotted = _take_dotted(node, file)
        _note_lines(node, "", lines, file)
        data = None if node is None else loader.construct_document(node)
        for key, value in dotted:
            own: dict[str, int] = {}
            _note_lines(value, key.value, own, file)
            _set_dotted(data, key.value, loader.construct_document(value), file, key.start_mark.line + 1)
            lines.update(own | {key.value: key.start_mark.line + 1})
    except DataError:
        raise
    except yaml.YAMLError as error:
        raise DataError(_syntax(error, text, file)) from None
    except (ValueError, TypeError, OverflowError) as error:
        raise DataError(f"{file}: a value cannot be read: {error}") from None
    except RecursionError:
        raise DataError(f"{file}: nested too deeply to be the description of a log") from None
    finally:
        if loader is not None:
            loader.dispose()
    if data is None:
        raise DataError(f"{file}: is empty; it must describe vehicle, soil, terrain, IMU and start")
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


def _take_dotted(node: yaml.Node | None, file: str) -> list[tuple[yaml.ScalarNode, yaml.Node]]:
    """Take the dotted keys of the top mapping out of it, in their order."""
    if not isinstance(node, yaml.MappingNode):
        return []
    dotted: dict[str, tuple[yaml.ScalarNode, yaml.Node]] = {}
    for key, value in node.value:
        if not isinstance(key, yaml.ScalarNode) or "." not in key.value.strip(".") or " " in key.value:
            continue
        if key.value in dotted:
            first = dotted[key.value][0].start_mark.line + 1
            where = f"{file}, line {key.start_mark.line + 1}"
            raise DataError(f"{where}: {key.value} is given twice, first in line {first}")
        dotted[key.value] = key, value
    taken = list(dotted.values())
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


def shown(value: object) -> str:
    """A value as an error quotes it, cut to 40 characters."""
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


class KeyedError(DataError):
    """A refusal of a value in the YAML, with the path of its key (``"vehicle.m"``)."""

    def __init__(self, sentence: str, path: str) -> None:
        super().__init__(sentence)
        self.path = path


_REQUIRED = object()
_Default = TypeVar("_Default")


class Section:
    """One mapping of a YAML file: keys are taken out one by one, and errors name file, line and key."""

    def __init__(self, data: dict[str, Any], lines: dict[str, int], file: str, path: str = "") -> None:
        self._rest, self._lines, self._file, self._path = dict(data), lines, file, path
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._rest

    def given(self, path: str) -> bool:
        """Whether the file holds a key of this full path (``"vehicle.m"``)."""
        return path in self._lines

    def error(self, sentence: str, key: str = "") -> DataError:
        """A `DataError` with file, line and key."""
        full = ".".join(part for part in (self._path, key) if part)
        line = self._lines.get(full, self._lines.get(self._path))
        where = self._file if line is None else f"{self._file}, line {line}"
        return KeyedError(f"{where}: {sentence}", full)

    def name(self, key: str) -> str:
        """The key with the sections that contain it."""
        return f"{self._path}.{key}" if self._path else key

    def take(self, key: str, default: object = _REQUIRED) -> Any:
        """Value of a key; a key without a value is refused."""
        self._known.append(key)
        if key not in self._rest:
            if default is _REQUIRED:
                near = nearest(key, (str(k) for k in self._rest))
                hint = f" - is it {near!r}?" if near else ""
                raise self.error(f"{self.name(key)} is missing{hint}")
            return default
        value = self._rest.pop(key)
        if value is None:
            raise self.error(f"{self.name(key)} has no value", key)
        return value

    def peek(self, key: str) -> Any:
        """Value of a key without taking it; None where it is not there."""
        return self._rest.get(key)

    def section(self, key: str) -> Section:
        """A mapping below this one; must be there."""
        value = self.take(key)
        if not isinstance(value, dict):
            raise self.error(f"{self.name(key)} must hold keys with values, got {shown(value)}", key)
        return Section(value, self._lines, self._file, self.name(key))

    def optional(self, key: str) -> Section | None:
        """A mapping that may be left out; asking makes the key known to the check of spellings."""
        if key in self:
            return self.section(key)
        self.take(key, None)
        return None

    @overload
    def number(self, key: str, quantity: Quantity) -> float: ...

    @overload
    def number(self, key: str, quantity: Quantity, default: _Default) -> float | _Default: ...

    def number(self, key: str, quantity: Quantity, default: object = _REQUIRED) -> object:
        """A number in the range of ``quantity``, or the default."""
        value = self.take(key, default)
        if value is default:
            return value
        return self._checked(key, value, quantity)

    def triple(
        self, key: str, quantity: Quantity, default: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """A list of three numbers in the range of ``quantity``, or the default."""
        value = self.take(key, None)
        if value is None:
            return default
        if not isinstance(value, list) or len(value) != 3:
            raise self.error(f"{self.name(key)} must be a list of 3 numbers, got {shown(value)}", key)
        first, second, third = (self._checked(key, item, quantity) for item in value)
        return first, second, third

    def _checked(self, key: str, value: Any, quantity: Quantity) -> float:
        try:
            return quantity.check(self.name(key), value)
        except InvalidParameter as error:
            raise self.error(str(error), key) from None

    def choice(self, key: str, allowed: tuple[str, ...], default: object = _REQUIRED) -> str:
        """One word of several."""
        value = self.take(key, default)
        if not isinstance(value, str) or value not in allowed:
            near = nearest(value, allowed) if isinstance(value, str) else None
            hint = f" - did you mean {near}?" if near else ""
            names = ", ".join(allowed)
            raise self.error(f"{self.name(key)} must be one of {names}, got {shown(value)}{hint}", key)
        return value

    def flag(self, key: str, default: object = _REQUIRED) -> bool:
        """True or false."""
        value = self.take(key, default)
        if not isinstance(value, bool):
            raise self.error(f"{self.name(key)} must be true or false, got {shown(value)}", key)
        return value

    def rest(self) -> dict[str, Any]:
        """All keys that were not taken."""
        rest, self._rest = self._rest, {}
        return rest

    def finish(self) -> None:
        """Refuse keys that were not taken: a misspelt key must not be lost."""
        for key in self._rest:
            near = nearest(str(key), self._known)
            hint = f"did you mean {near!r}?" if near else f"known: {', '.join(self._known)}"
            raise self.error(f"{self.name(str(key))!r} is not a key of a log - {hint}", str(key))
