"""Agents of the user's own, ``module:Class``: how they are found and made, and what files are behind them."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

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

#: Module -> files that were opened or loaded while it was imported, which happens once in a process.
_read_at_import: dict[str, set[Path]] = {}
#: ``module:Class`` -> files that were opened while it was made: what is kept for later is opened once, too.
_read_while_made: dict[str, set[Path]] = {}
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
    module = _imported(name)
    kind = getattr(module, name.partition(":")[2], None)
    if kind is None:
        raise InvalidParameter(f"no {name.partition(':')[2]!r} in {module.__name__} - module:Class?")
    if not isinstance(kind, type):
        raise InvalidParameter(
            f"{name} is {'a function' if callable(kind) else 'no class'}: give a class with the methods "
            "reset(briefing) and act(observation), which is made without arguments"
        )
    try:
        with _noting(_read_while_made.setdefault(name, set())):
            agent: Agent = kind()
    except TypeError as error:
        raise InvalidParameter(f"{name} cannot be made without arguments: {error}") from error
    missing = [method for method in ("reset", "act") if not callable(getattr(agent, method, None))]
    if missing:
        raise InvalidParameter(
            f"{name} has no method {' and no '.join(missing)} (`agents.controllers.protocol.Agent`)"
        )
    return agent


def _imported(name: str) -> ModuleType:
    """The module of an agent; what it reads while it is imported is noted."""
    _agent_file(name)
    module = _importable(name)
    with _noting(_read_at_import.setdefault(module, set())):
        return importlib.import_module(module)


def made_from(name: str) -> tuple[Path, ...]:
    """Files from which an agent of your own is made, in alphabetical order.

    These are its module, the user's modules that it imports, and what was opened for reading while it was
    made: its weights, say. What it opens later, and variables of the process environment, are not among them.
    """
    module, file = _importable(name), _agent_file(name).absolute()
    make_own_agent(name)
    read = _read_at_import[module] | _read_while_made[name]
    package = _package(module, file)
    found = {path for path in read if _is_own(path, package)}
    return tuple(sorted(found | _imported_beside(module, file)))


def own_content(name: str) -> bytes:
    """What tells an agent of your own from itself after a change: the content of the files behind it."""
    return _content_of(made_from(name))


def course_content(name: str) -> bytes:
    """The same of a function ``module:function`` that draws courses, once it is loaded.

    These are its module and the modules beside it that the sources name in imports. Which ones are loaded
    does not count: other agents and other courses may lie beside it.
    """
    module = name.partition(":")[0]
    path = getattr(sys.modules.get(module), "__file__", None)
    if path is None:
        return b""
    file = Path(path).absolute()
    if not file.is_file() or any(file.resolve().is_relative_to(Path(ours).resolve()) for ours in _OURS):
        return b""  # `stamp_of` covers ours
    return _content_of(sorted(_imported_beside(module, file)))


def _root(module: str, file: Path) -> Path:
    """Folder from which Python finds a module by its whole name."""
    return file.parents[module.count(".") + (file.stem == "__init__")]


def _package(module: str, file: Path) -> Path | None:
    """The outermost package in which a module lies; None: in none."""
    inside = "." in module or file.stem == "__init__"
    return (_root(module, file) / module.partition(".")[0]).resolve() if inside else None


def _imported_beside(module: str, file: Path) -> set[Path]:
    """Files of a module and of those beside it that it imports, directly or through each other."""
    own = tuple(module.split("."))
    root, package = _root(module, file), _package(module, file)
    found = {own: file}
    waiting, seen = [own, *_above(own)], set()
    while waiting:
        name = waiting.pop()
        path = found.get(name) or _module_file(name, root)
        if name in seen or path is None or not _is_own(path.resolve(), package):
            continue
        seen.add(name)
        found[name] = path
        waiting += _names_in(path, name if path.stem == "__init__" else name[:-1])
    return {path.resolve() for path in found.values()}


def _above(name: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Packages in which a module lies; they are imported with it."""
    return [name[:length] for length in range(1, len(name))]


def _module_file(name: tuple[str, ...], root: Path) -> Path | None:
    """File of a module or package that is found from a folder; None: there is none."""
    place = root.joinpath(*name)
    files = (place / "__init__.py", place.with_name(f"{place.name}.py"))
    return next((file for file in files if file.is_file()), None)


def _names_in(file: Path, package: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Modules that a source of a package may import; what follows ``from x import`` need be none."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # no source, or changed to one that cannot be imported
        return
    for node in ast.walk(tree):
        names: list[tuple[str, ...]] = []
        if isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            start = (*above, *(node.module.split(".") if node.module else ()))
            names = [start, *((*start, alias.name) for alias in node.names if alias.name != "*")]
        for name in filter(None, names):
            yield from (name, *_above(name))


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
def _noting(files: set[Path]) -> Iterator[None]:
    """Note the files that are opened for reading, and those of the modules that are loaded meanwhile."""
    global _opened, _hooked
    if not _hooked:
        sys.addaudithook(_note)
        _hooked = True
    outer, loaded = _opened, set(sys.modules)
    noted: list[str] = []
    _opened = noted
    try:
        yield
    finally:
        new = [
            getattr(module, "__file__", None)
            for name, module in list(sys.modules.items())
            if name not in loaded
        ]
        noted += [path for path in new if path is not None]
        if outer is not None:
            outer += noted
        _opened = outer
        files |= {Path(path).resolve() for path in noted}


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event != "open" or _opened is None:
        return
    path, _, flags = arguments
    writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR)
    if isinstance(path, str | bytes | os.PathLike) and not writes:
        _opened.append(os.fsdecode(path))
