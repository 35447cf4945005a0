"""Agents of the user's own, ``module:Class``: how they are found and made, and what files are behind them."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from agents.controllers.protocol import Agent
from offroad_env.errors import InvalidParameter

__all__ = ["course_content", "made_from", "make_own_agent", "own_content", "search_here"]

_OURS = tuple(str(Path(__file__).parents[2] / package) for package in ("agents", "estimators", "offroad_env"))
#: Where Python, the libraries and this project lie: what is read there is not the user's.
_LIBRARIES = tuple(
    Path(folder).resolve()
    for folder in {
        *(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")),
        *_OURS,
        "/proc",
        "/sys",
        "/dev",
        "/etc",
    }
)
#: What is made from other files, and folders of what programs keep for themselves.
_MADE, _KEPT = {".pyc", ".nbi", ".nbc"}, {"__pycache__", ".cache"}

#: Files that were opened while an agent was made: what its module reads is opened at its first import only.
_read_before: dict[str, set[Path]] = {}
#: Where the files that are opened for reading are noted; None: nowhere. Hooks of Python cannot be taken away.
_opened: list[str] | None = None
_hooked = False


def search_here() -> None:
    """Let modules of the working directory be found: the installed command does not look there by itself."""
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())


def _importable(name: str) -> str:
    """The module of ``module:Class``, which may lie in the working directory."""
    search_here()
    return name.partition(":")[0]


def _agent_file(name: str) -> Path:
    """The file of the module."""
    module = _importable(name)
    try:
        found = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        found = None
    if found is None or found.origin is None:
        raise InvalidParameter(
            f"no module {module!r} in {os.getcwd()} or among the installed packages, asked for by {name!r} - "
            "module:Class names an agent of your own"
        )
    file = Path(found.origin)
    if not file.is_file() or module.partition(".")[0] in sys.stdlib_module_names:
        raise InvalidParameter(
            f"module {module!r} is a part of Python, asked for by {name!r} - "
            "module:Class names an agent of your own"
        )
    return file


def make_own_agent(name: str) -> Agent:
    """An agent of your own, made without arguments.

    Parameters
    ----------
    name
        ``module:Class``; the module lies in the working directory or is installed.

    Raises
    ------
    InvalidParameter
        If there is no such module or class, the module has no file (a part of Python itself is no agent),
        the class asks for arguments, or has no ``reset`` and ``act``.
    """
    _agent_file(name)
    module = importlib.import_module(_importable(name))
    kind = getattr(module, name.partition(":")[2], None)
    if kind is None:
        raise InvalidParameter(f"no {name.partition(':')[2]!r} in {module.__name__} - module:Class?")
    if not isinstance(kind, type):
        raise InvalidParameter(
            f"{name} is {'a function' if callable(kind) else 'no class'}: give a class with the methods "
            "reset(briefing) and act(observation), which is made without arguments"
        )
    try:
        agent: Agent = kind()
    except TypeError as error:
        raise InvalidParameter(f"{name} cannot be made without arguments: {error}") from error
    missing = [method for method in ("reset", "act") if not callable(getattr(agent, method, None))]
    if missing:
        raise InvalidParameter(
            f"{name} has no method {' and no '.join(missing)} (`agents.controllers.protocol.Agent`)"
        )
    return agent


def made_from(name: str) -> tuple[Path, ...]:
    """Files from which an agent of your own is made, in alphabetical order.

    These are its module, the modules beside it that are loaded, and what was opened for reading while it was
    made: its weights, say. What it opens later, and variables of the process environment, are not among them.
    """
    file = _agent_file(name).resolve()
    with _noting() as opened:
        make_own_agent(name)
    read = _read_before.setdefault(name, set())
    read |= {Path(path).resolve() for path in opened}
    package = file.parent if (file.parent / "__init__.py").exists() else None
    found = _loaded_beside(file) | read
    return tuple(sorted({file, *(path for path in found if _is_own(path, package))}))


def _loaded_beside(file: Path) -> set[Path]:
    """Files of the modules that are loaded from the folder of a module, and from folders in it."""
    modules = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    loaded = {Path(path).resolve() for path in modules if path is not None}
    return {path for path in loaded if path.is_relative_to(file.parent)}


def own_content(name: str) -> bytes:
    """What tells an agent of your own from itself after a change: the content of the files behind it."""
    return _content_of(made_from(name))


def course_content(name: str) -> bytes:
    """The same of a function ``module:function`` that draws courses, once it is loaded."""
    module = sys.modules.get(name.partition(":")[0])
    path = getattr(module, "__file__", None)
    if path is None:
        return b""
    file = Path(path).resolve()
    if any(file.is_relative_to(Path(folder).resolve()) for folder in _OURS):
        return b""  # `stamp_of` covers it
    package = file.parent if (file.parent / "__init__.py").exists() else None
    return _content_of(sorted(path for path in _loaded_beside(file) if _is_own(path, package)))


def _content_of(paths: Iterable[Path]) -> bytes:
    digest = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.digest()


def _is_own(path: Path, package: Path | None) -> bool:
    """Whether a file is the user's: not made from others, and no library's but the agent's own package's."""
    if path.suffix in _MADE or not _KEPT.isdisjoint(path.parts) or not path.is_file():
        return False
    if package is not None and path.is_relative_to(package):
        return True
    return not any(path.is_relative_to(folder) for folder in _LIBRARIES)


@contextmanager
def _noting() -> Iterator[list[str]]:
    """Note the names of the files that are opened for reading."""
    global _opened, _hooked
    if not _hooked:
        sys.addaudithook(_note)
        _hooked = True
    noted = _opened = []
    try:
        yield noted
    finally:
        _opened = None


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event != "open" or _opened is None:
        return
    path, _, flags = arguments
    writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR)
    if isinstance(path, str | bytes | os.PathLike) and not writes:
        _opened.append(os.fsdecode(path))
