"""Options that several commands share: one spelling each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import tyro

__all__ = ["FORMER", "Jobs", "Scenarios", "TerrainInfo", "option_value", "present_spelling"]

#: Local processes.
Jobs = Annotated[int, tyro.conf.arg(name="jobs")]
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
