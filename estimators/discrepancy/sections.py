"""Sections of a diagnosis: where one breaks down the others are kept, and the report says what is missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

__all__ = ["attempt"]

_Result = TypeVar("_Result")


def attempt(section: str, work: Callable[[], _Result], otherwise: _Result, failed: dict[str, str]) -> _Result:
    """What ``work`` returns; where it breaks down ``otherwise``, with the reason noted in ``failed``.

    Whatever the error: minutes of other results must not be lost with one section.
    """
    try:
        return work()
    except Exception as error:
        failed[section] = f"{type(error).__name__}: {error}"
        return otherwise
