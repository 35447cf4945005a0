"""The one place where numba is configured.

``cache=True`` alone is a trap here: numba stamps a cached kernel with its own file only, so a
change in a kernel that it calls from another file goes unnoticed. The cache folder is therefore
keyed by a digest of every kernel source, and an edit anywhere starts a fresh folder.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import TypeVar

import numba
from numba import njit

__all__ = ["cache_folder", "inline_kernel", "kernel"]

F = TypeVar("F", bound=Callable)

_PHYSICS = Path(__file__).resolve().parent
_ROOT = _PHYSICS.parents[1]
#: Packages whose modules may define kernels.
_PACKAGES = ("offroad_env", "estimators", "agents")


def _digest(files: Iterable[Path]) -> str:
    text = hashlib.sha256(numba.__version__.encode())
    for file in sorted(files):
        text.update(str(file.relative_to(_ROOT)).encode())
        text.update(file.read_bytes())
    return text.hexdigest()[:16]


@cache
def _physics_digest() -> str:
    return _digest(_PHYSICS.rglob("*.py"))


@cache
def _whole_digest() -> str:
    files = (file for package in _PACKAGES for file in (_ROOT / package).rglob("*.py"))
    return _digest(file for file in files if file.parent == _PHYSICS or b"kernel" in file.read_bytes())


def cache_folder(module: str) -> Path:
    """Folder of the compiled kernels of ``module``, for exactly these sources.

    Kernels of the physics call only each other, so an edit above them leaves their folder alone;
    any other kernel may call any of them all.
    """
    base = os.environ.get("OFFROAD_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "offroad-bekker"
    )
    physics = module.startswith("offroad_env.physics.")
    return Path(base) / "kernels" / (_physics_digest() if physics else _whole_digest())


def _compile(function: F, **options) -> F:
    if numba.config.DISABLE_JIT:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder(function.__module__))
    try:
        return njit(function, cache=True, error_model="numpy", nogil=True, fastmath={"contract"}, **options)
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
