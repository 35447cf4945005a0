"""The one place where numba is configured.

``cache=True`` alone is a trap here: numba stamps a cached kernel with its own file only, so a
change in a kernel that it calls from another file goes unnoticed. The cache folder of a module is
therefore keyed by a digest of its source and of every source of ours that it imports, however
indirectly: an edit starts a fresh folder for exactly those kernels that it can reach.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from offroad_env.physics._kernel_folder import own_folder
from offroad_env.physics._kernel_notes import keep_apart

__all__ = ["apart_kernel", "cache_folder", "inline_kernel", "kernel", "merged_kernel", "part_kernel"]

#: Versions of numba, from the first to below the second, whose inner parts `_staged` fits; with any other
#: kernels are plain.
_KNOWN_NUMBA = (0, 68), (0, 69)
#: Set to "plain", this asks for them too.
_VARIABLE = "OFFROAD_KERNELS"

F = TypeVar("F", bound=Callable[..., Any])

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("offroad_env", "estimators", "agents")
#: A module that calls kernels of packages which it may not import names them in a tuple of this name.
LATE = "LATE_IMPORTS"
LATE_IMPORTS = ("offroad_env.physics._staged",)


@cache
def _source(module: str) -> Path | None:
    """File of one of our modules, or None for a name that is none."""
    if module.split(".")[0] not in _PACKAGES:
        return None
    stem = _ROOT.joinpath(*module.split("."))
    return next((file for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()), None)


def _text(module: str) -> bytes:
    """Source of one of our modules."""
    file = _source(module)
    if file is None:
        raise ModuleNotFoundError(f"{module} is no module of {', '.join(_PACKAGES)}")
    return file.read_bytes()


@cache
def _own_hash(module: str) -> bytes:
    """Of the source of one of our modules."""
    return hashlib.sha256(_text(module)).digest()


#: A statement that imports, or names what is imported late, at the top level of a module: from the first
#: column to the end of its line or to the bracket that closes.
_STATEMENT = re.compile(
    rf"^(?:from[ \t]|import[ \t]|{LATE}\b[^=\n]*=)(?:[^(\n]*\([^)]*\)|(?:[^\n\\]|\\\n)*)", re.MULTILINE
)


def _importing(text: str) -> list[ast.stmt]:
    """Top-level statements of a module, at least those that import ours: to parse it all takes far longer.

    Where a comment or a text deceives the search, the whole module is parsed.
    """
    ours = (found for found in _STATEMENT.findall(text) if any(package in found for package in _PACKAGES))
    try:
        return ast.parse("\n".join(ours)).body
    except SyntaxError:
        return ast.parse(text).body


@cache
def _imports(module: str) -> frozenset[str]:
    """Our modules whose code ``module`` may call: imported at its top level, or named in `LATE`."""
    found: set[str] = set()
    for node in _importing(_text(module).decode()):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.update((node.module, *(f"{node.module}.{alias.name}" for alias in node.names)))
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == LATE:
            for package in ast.literal_eval(node.value):
                files = _ROOT.joinpath(*package.split(".")).rglob("*.py")
                found.update(
                    (package, *(".".join(f.relative_to(_ROOT).with_suffix("").parts) for f in files))
                )
    return frozenset(name for name in found if _source(name))


@cache
def _digest(module: str) -> str:
    """Of the numba version, the module's source and all sources of ours behind its imports."""
    reached, front = {module}, {module}
    while front:
        front = {name for known in front for name in _imports(known)} - reached
        reached |= front
    text = hashlib.sha256(numba.__version__.encode())
    for name in sorted(reached):
        text.update(name.encode())
        text.update(_own_hash(name))
    return text.hexdigest()[:16]


def cache_folder(module: str) -> Path:
    """Folder of the compiled kernels of ``module``, for exactly these sources.

    A module that is not ours (a test, a script) has no fixed sources behind it and shares a
    folder keyed by those of the whole physics.
    """
    base = os.environ.get("OFFROAD_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "offroad-bekker"
    )
    ours = module if _source(module) else "offroad_env.physics.full_vehicle"
    return Path(base) / "kernels" / _digest(ours)


def _compile(function: F, *, stored: bool = True, **options: Any) -> F:
    if numba.config.DISABLE_JIT:
        return function
    options |= {"nopython": True, "error_model": "numpy", "nogil": True}
    options.setdefault("fastmath", {"contract"})
    # Left open, it would be that of the first caller: the machine code would depend on who called first.
    options.setdefault("forceinline", False)
    staged, folder = _staged(), str(cache_folder(function.__module__)) if stored else None
    if staged is None:
        return _plain(function, folder, options)
    compiled: Any = staged.Kernel(function, {}, options)
    if folder is not None:
        compiled.keep_in(folder)
    return cast("F", compiled)


@cache
def _staged() -> Any:
    """The module with kernels in two editions; None where this numba cannot have them."""
    first, unknown = _KNOWN_NUMBA
    known = first <= tuple(map(int, re.findall(r"\d+", numba.__version__)[:2])) < unknown
    if not known or os.environ.get(_VARIABLE) == "plain":
        return None
    try:
        return importlib.import_module("offroad_env.physics._staged")
    except (ImportError, AttributeError):  # an inner part of numba that has gone
        return None


def _plain(function: F, folder: str | None, options: dict[str, Any]) -> F:
    """A kernel as any numba makes it: the same numbers to rounding, compiled for longer."""
    compiled: Any = numba.jit(**options)(function)
    if folder is None:
        return cast("F", compiled)
    folder = f"{folder}-plain"
    if own_folder(folder):
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = folder
        try:
            compiled.enable_caching()
        finally:
            numba.config.CACHE_DIR = before
    return cast("F", compiled)


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


def part_kernel(function: F) -> F:
    """A kernel that is always inlined, and stored only as a part of its callers: for one made in a loop."""
    return _compile(function, stored=False, forceinline=True)


def apart_kernel(function: F) -> F:
    """A kernel that is never inlined: long code for rare cases, which would be compiled at every call."""
    keep_apart(function)
    return _compile(function)


def merged_kernel(function: F) -> F:
    """A kernel that becomes part of each kernel that calls it, before anything is compiled.

    For the storeys between the wheel and the vehicle, with one caller: it saves the hundred numbers of
    a plant on the way down. Each caller translates it anew, so what has several is a kernel of its own.
    """
    return _compile(function, inline="always")
