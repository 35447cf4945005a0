"""Checks of arguments that several factories share: words, records, arrays of numbers."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.world.yaml_text import shown

__all__ = ["is_one_of", "numbers", "one_number", "require_record"]

T = TypeVar("T")


def is_one_of(value: object, words: Any) -> bool:
    """Whether a value is one of some words; an array, which compares in its own way, is none."""
    return (value is None or isinstance(value, str)) and value in words


def require_record(name: str, value: object, kind: type[T], source: str) -> T:
    """The value, if it is of the kind that ``source`` makes.

    Raises
    ------
    InvalidParameter
        For anything else.
    """
    if not isinstance(value, kind):
        raise InvalidParameter(f"{name} must be a {kind.__name__}, from {source}, got {shown(value)}")
    return value


def numbers(name: str, value: Any) -> np.ndarray:
    """The value as an array of floats.

    Raises
    ------
    InvalidParameter
        For anything but numbers; text with digits is none.
    """
    try:
        plain = np.asarray(value)
        if plain.dtype.kind in "fiub":
            return plain.astype(np.float64)
    except (TypeError, ValueError):
        pass
    raise InvalidParameter(f"{name} must be numbers, got {shown(value)}")


def one_number(name: str, value: Any) -> float:
    """One finite number.

    Raises
    ------
    InvalidParameter
    """
    array = numbers(name, value)
    if array.ndim or not np.isfinite(array):
        raise InvalidParameter(f"{name} must be one finite number, got {shown(value)}")
    return float(array)
