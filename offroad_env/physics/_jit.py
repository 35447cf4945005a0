"""The one place where numba is configured.

``cache=True`` alone is a trap here: numba stamps a cached kernel with its own file only, so a
change in a kernel that it calls from another file goes unnoticed. The cache folder is therefore
keyed by a digest of every kernel source, and an edit anywhere starts a fresh folder.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numba
from numba import njit

__all__ = ["cache_folder", "inline_kernel", "kernel"]

F = TypeVar("F", bound=Callable)

#: Folders (beside this one's package) whose sources are compiled or call compiled code.
_PACKAGES = ("offroad_env", "estimators", "agents")


def _kernel_sources() -> list[Path]:
    """Every source file that defines kernels, in a fixed order."""
    root = Path(__file__).resolve().parents[2]
    files = (f for package in _PACKAGES for f in (root / package).rglob("*.py"))
    return sorted(f for f in files if b"kernel" in f.read_bytes() or f.parent == Path(__file__).parent)


def _digest() -> str:
    text = hashlib.sha256(numba.__version__.encode())
    for file in _kernel_sources():
        text.update(file.name.encode())
        text.update(file.read_bytes())
    return text.hexdigest()[:16]


def cache_folder() -> Path:
    """Folder of the compiled kernels of exactly these sources."""
    base = os.environ.get("OFFROAD_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "offroad-bekker"
    )
    return Path(base) / "kernels" / _FOLDER


_FOLDER = _digest()


def _compile(function: F, **options) -> F:
    if numba.config.DISABLE_JIT:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        return njit(
            function, cache=True, error_model="numpy", nogil=True, fastmath={"contract"}, **options
        )
    finally:
        numba.config.CACHE_DIR = before


def kernel(function: F) -> F:
    """Compile a pure function of floats, records and arrays (no Python objects).

    Of the fastmath flags only ``contract`` is set (a multiplication and an addition may share one
    rounding): none that assumes away NaN or reorders sums. ``error_model="numpy"``: a division by
    zero gives inf or NaN, which the caller's status reports, instead of raising from the middle
    of a step.
    """
    return _compile(function)


def inline_kernel(function: F) -> F:
    """A kernel that is always inlined: a loop that calls it can still become vector instructions."""
    return _compile(function, forceinline=True)
