"""The reference of all keys: what a YAML, a mapping or ``randomise`` may hold, from the schemas."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from estimators.logs.key_table import LOG_ABOUT, column_rows, log_rows
from offroad_env.environment.courses import COURSE
from offroad_env.environment.randomisation import RANDOM_KEYS, random_meaning
from offroad_env.environment.scenario_descriptions import SCENARIO, WEIGHTS
from offroad_env.simulation.sensor_descriptions import PARTS, SENSOR_KEYS
from offroad_env.world.descriptions import SOIL, STRUCTURE, TYRE, VEHICLE
from offroad_env.world.schema import KeyRow, SectionSchema

__all__ = ["HEADING", "SECTIONS", "random_rows", "reference"]

#: Section of a YAML -> its keys.
SECTIONS: Mapping[str, SectionSchema] = MappingProxyType(
    {
        schema.name: schema
        for schema in (
            SOIL,
            VEHICLE,
            TYRE,
            STRUCTURE,
            SENSOR_KEYS,
            *PARTS.values(),
            SCENARIO,
            COURSE,
            WEIGHTS,
        )
    }
)
_HEAD = """# Keys of descriptions

**Question:** which keys may a soil, a vehicle, a scenario, ... of one's own have?

**Answer:** those below, in a YAML, in a mapping, or as arguments of the factory; in SI units and radians.

**Command:** `offroad keys soil`; this page: `offroad keys --markdown`. How they are used: [own.md](own.md).

A section with `base` takes every key that is not given from there; "needed" holds without a base."""
_RANDOM = """## randomise

Keys are `soil`, `vehicle` and `sensors` as a whole, `SECTION.KEY` with every number of the sections soil,
vehicle, imu (but for its rate), wheel and gnss, `n` for `soil.n`, and:"""

_COLUMNS = "`default` is where the column belongs; `allowed` the largest magnitude that a value may have."

HEADING = ("key", "unit", "allowed", "default", "meaning")


def random_rows() -> list[KeyRow]:
    """Keys of ``randomise`` that are no field of a section."""
    return [
        KeyRow(key, unit, RANDOM_KEYS[key].allowed, "not drawn", meaning)
        for key in RANDOM_KEYS
        for unit, meaning in random_meaning(key)
    ]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _table(rows: list[KeyRow]) -> list[str]:
    lines = [f"| {' | '.join(HEADING)} |", "|---|---|---|---|---|"]
    return lines + [f"| `{row.key}` | {' | '.join(map(_cell, row[1:]))} |" for row in rows]


def reference() -> str:
    """All tables as Markdown."""
    lines = [_HEAD]
    for name, schema in SECTIONS.items():
        lines += ["", f"## {name}", "", schema.about, "", *_table(schema.table())]
    lines += ["", _RANDOM, "", *_table(random_rows())]
    lines += ["", "## log", "", LOG_ABOUT, "", *_table(log_rows())]
    lines += ["", "## columns of a log", "", _COLUMNS, "", *_table(column_rows())]
    return "\n".join(lines) + "\n"
