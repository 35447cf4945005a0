"""Options that several commands share: one spelling each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import tyro

__all__ = ["Jobs", "Scenarios", "option_value"]

#: Local processes. With the option's former spelling.
Jobs = Annotated[int, tyro.conf.arg(name="jobs", aliases=["--n-jobs"])]  # alias
#: Scenarios by name or file. With the option's former spelling.
Scenarios = Annotated[tuple[str, ...], tyro.conf.arg(name="scenario", aliases=["--tasks"])]  # alias


def option_value(arguments: Sequence[str], option: str, default: str) -> str:
    """What stands behind an option among unparsed arguments."""
    words = list(arguments)
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word == option and following:
            return following
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return default
