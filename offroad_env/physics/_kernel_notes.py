"""What modules state about their kernels for the compiler."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__ = ["APART", "HANDING_ON", "hands_on", "keep_apart"]

#: Functions known to the compiler that return no other arrays than they were given.
HANDING_ON: set[Callable[..., Any]] = set()
#: Kernels that no caller takes in.
APART: set[Callable[..., Any]] = set()


def hands_on(function: Callable[..., Any]) -> None:
    """State that a function which numba compiles by itself returns no arrays but those it was given."""
    HANDING_ON.add(function)


def keep_apart(function: Callable[..., Any]) -> None:
    """State that the machine code of a kernel shall be called, not copied into its callers."""
    APART.add(function)
