"""Where a description comes from: a mapping, inline YAML, or a YAML file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from offroad_env.errors import DataError, InvalidParameter
from offroad_env.world.files import read_text
from offroad_env.world.schema import SectionSchema
from offroad_env.world.yaml_text import parse_yaml, shown

__all__ = ["Document", "is_name", "open_document", "recalled", "remember"]

_SUFFIXES = (".yaml", ".yml")
#: Environment variable with what was registered: processes that are started later inherit it.
_VARIABLE = "OFFROAD_BEKKER_REGISTERED"


@dataclass(frozen=True, kw_only=True)
class Document:
    """A description and its place."""

    content: Mapping[str, Any]
    where: str  #: begins an error's message
    folder: Path | None = None  #: of the file that it stands in
    lines: Mapping[str, int] = field(default_factory=dict)  #: key -> line of the file
    name: str = "own"  #: of what is described, where it states none: that of the file

    def check(self, schema: SectionSchema) -> dict[str, Any]:
        """The checked keys of a section; see `SectionSchema.check`."""
        return schema.check(self.content, self.where, self.lines)

    def beside(self, value: Any) -> Any:
        """A value with the path of a file made relative to this one's folder."""
        if self.folder is None or not isinstance(value, str) or not value.lower().endswith(_SUFFIXES):
            return value
        path = self.folder / value
        return path if path.is_file() else value

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Within it, what a factory refuses is said with the place of the description."""
        try:
            yield
        except InvalidParameter as error:
            if str(error).startswith(self.where):
                raise
            raise InvalidParameter(f"{self.where}: {error}") from error


def is_name(given: object) -> bool:
    """Whether it is a name in a catalogue: text that is neither a file nor inline YAML."""
    return isinstance(given, str) and not given.lower().endswith(_SUFFIXES) and not given.startswith("{")


def open_document(given: Any, section: str) -> Document:
    """The description of a section.

    Parameters
    ----------
    given
        A mapping; inline YAML, ``"{base: clay, n: 0.6}"``; or a file ``*.yaml``, which holds the keys
        themselves or a mapping of that section's name, as the YAML of a log does.
    section
        "soil", "vehicle", ...

    Raises
    ------
    DataError
        For a file that cannot be read, or is no YAML.
    InvalidParameter
        For anything else.
    """
    if isinstance(given, Mapping):
        return Document(content=given, where=section)
    if isinstance(given, str) and given.startswith("{"):
        content, _ = parse_yaml(given, section, about=f"a {section}")
        return Document(content=content, where=section)
    if not isinstance(given, str | os.PathLike):
        raise InvalidParameter(
            f"{section} must be a name, an object of its factory, a mapping or a YAML file, "
            f"got {shown(given)}"
        )
    path = Path(given)
    try:
        text = read_text(path)
    except DataError as error:
        raise DataError(f"{section}: {error}") from None
    content, lines = parse_yaml(text, str(path), about=f"a {section}")
    inner = content.get(section)
    if isinstance(inner, Mapping):
        prefix = f"{section}."
        lines = {key.removeprefix(prefix): line for key, line in lines.items() if key.startswith(prefix)}
        content = dict(inner)
    return Document(
        content=content, where=f"{path}: {section}", folder=path.parent, lines=lines, name=path.stem
    )


def remember(kind: str, name: str, content: Mapping[str, Any]) -> None:
    """Keep a registered description for the processes that this one starts."""
    table = json.loads(os.environ.get(_VARIABLE, "{}"))
    table.setdefault(kind, {})[name] = content
    os.environ[_VARIABLE] = json.dumps(table)


def recalled(kind: str, name: object) -> Mapping[str, Any] | None:
    """What this process, or one that has started it, has registered under a name."""
    try:
        found = json.loads(os.environ.get(_VARIABLE, "{}")).get(kind, {}).get(name)
    except (ValueError, TypeError, AttributeError):
        return None
    return found if isinstance(found, Mapping) else None
