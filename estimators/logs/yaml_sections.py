"""YAML read strictly: every error names the file, the line and the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar, overload

from estimators.logs.schema import nearest
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.catalogue import Quantity
from offroad_env.world.yaml_text import shown

__all__ = ["KeyedError", "Section"]


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

    def beside(self, file: str) -> str:
        """The path of a file that is named relative to this one's folder."""
        path = Path(self._file).parent / file
        return str(path) if path.is_file() else file

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
