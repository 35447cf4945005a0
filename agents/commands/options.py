"""Options that several commands share: one spelling each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import tyro

from offroad_env.errors import InvalidParameter

__all__ = ["FORMER", "Jobs", "Scenarios", "TerrainInfo", "option_value", "present_spelling"]


def _processes(words: list[str]) -> int:
    """A number of local processes, as joblib takes it."""
    jobs = int(words[0])
    if jobs == 0:
        raise InvalidParameter(
            "jobs must be 1 or more, or -1 for all processors, got 0 - 1 runs in this process"
        )
    return jobs


#: Local processes.
Jobs = Annotated[
    int,
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=_processes,
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    ),
    tyro.conf.arg(name="jobs"),
]
#: Scenarios by name or file.
Scenarios = Annotated[tuple[str, ...], tyro.conf.arg(name="scenario")]
#: What an agent is shown of the soil.
TerrainInfo = Literal["none", "estimate", "truth", "belief", "limits"]

#: Former spelling of an option -> the present one.
FORMER = {"--n-jobs": "--jobs", "--n_jobs": "--jobs", "--tasks": "--scenario"}


def option_value(arguments: Sequence[str], option: str, default: str) -> str:
    """What stands behind an option among unparsed arguments."""
    words = list(arguments)
    for word, following in zip(words, [*words, ""][1:], strict=True):
        if word == option and following:
            return following
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return default


def present_spelling(arguments: Sequence[str]) -> list[str]:
    """Arguments with former spellings of options replaced."""
    found = []
    for word in arguments:
        option, equals, value = word.partition("=")
        found.append(FORMER.get(option, option) + equals + value)
    return found
