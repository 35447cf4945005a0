"""Rules of the house that no linter knows: how long, how deep, who may read what."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import grimp
import pytest

from helpers import REPOSITORY

PACKAGES = ("agents", "estimators", "offroad_env")
#: All that people have to read.
WRITTEN = (*PACKAGES, "benchmarks", "examples", "tests")
LONGEST_FUNCTION = 60  # lines of the body, docstring included
MOST_ARGUMENTS = 9
LONGEST_FILE = 500
MOST_UNPACKED = 4

#: Tables of data, written by a command or typed from a publication: as long as the data are.
DATA_TABLES = {"agents/controllers/tuned.py"}
#: Part of the public interface of every named tuple, in spite of the underscore.
NAMED_TUPLE = {"_replace", "_asdict", "_fields", "_make", "_field_defaults"}
#: Works with the inner parts of numba, which has no public ones for this.
NUMBA_INSIDE = {
    "offroad_env/physics/_intrinsics.py",
    "offroad_env/physics/_jit.py",
    "offroad_env/physics/_kernel_cache.py",
    "offroad_env/physics/_staged.py",
}
#: What a literal number may index: arrays, and sequences of equal things.
INDEXABLE = ("Array", "array", "Sequence", "list", "str", "...", "deque", "GridSpec", "Match", "Row")


@cache
def modules(folders: tuple[str, ...] = PACKAGES) -> list[tuple[str, ast.Module]]:
    files = [path for folder in folders for path in sorted((REPOSITORY / folder).rglob("*.py"))]
    return [
        (str(path.relative_to(REPOSITORY)), ast.parse(path.read_text(encoding="utf-8"))) for path in files
    ]


@cache
def functions(folders: tuple[str, ...] = PACKAGES) -> list[tuple[str, ast.FunctionDef]]:
    return [
        (name, node)
        for name, tree in modules(folders)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]


@pytest.fixture(scope="module", autouse=True)
def trees_live_as_long_as_this_module() -> Iterator[None]:
    """A million nodes: each garbage collection beside them costs seconds, in all tests that follow."""
    gc.disable()
    yield
    gc.enable()
    functions.cache_clear()
    modules.cache_clear()


def arguments_of(function: ast.FunctionDef) -> list[ast.arg]:
    return [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]


def listed(found: list[str]) -> str:
    return "\n".join(["", *sorted(set(found))])


def test_no_function_is_longer_than_a_screen():
    found = [
        f"{file}:{f.lineno} {f.name}: {f.end_lineno - f.body[0].lineno + 1} lines"
        for file, f in functions(WRITTEN)
        if f.end_lineno - f.body[0].lineno + 1 > LONGEST_FUNCTION
    ]
    assert not found, listed(found)


def test_no_file_is_longer_than_can_be_kept_in_mind():
    found = []
    for file, _ in modules(WRITTEN):
        lines = len((REPOSITORY / file).read_text(encoding="utf-8").splitlines())
        if lines > LONGEST_FILE and file not in DATA_TABLES:
            found.append(f"{file}: {lines} lines")
    assert not found, listed(found)


def test_no_record_is_taken_apart_by_position():
    """More than four names from one parameter: it is a record and deserves names."""
    found = []
    for file, function in functions():
        names = {argument.arg for argument in arguments_of(function)}
        for node in ast.walk(function):
            if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Tuple):
                continue
            parts = node.targets[0].elts
            if len(parts) > MOST_UNPACKED and isinstance(node.value, ast.Name) and node.value.id in names:
                found.append(f"{file}:{node.lineno} {node.value.id} -> {len(parts)} names")
    assert not found, listed(found)


def test_no_record_is_read_by_number():
    """``motion[0]`` says nothing: a literal index is for arrays and sequences, which the annotation names."""
    found = []
    for file, function in functions():
        kinds = {a.arg: ast.unparse(a.annotation) if a.annotation else "" for a in arguments_of(function)}
        for node in ast.walk(function):
            if not isinstance(node, ast.Subscript) or not isinstance(node.value, ast.Name):
                continue
            kind = kinds.get(node.value.id)
            if (
                kind is None
                or not isinstance(node.slice, ast.Constant)
                or not isinstance(node.slice.value, int)
            ):
                continue
            pair = kind.startswith("tuple[") and kind.count(",") == 1
            if not pair and not any(word in kind for word in INDEXABLE):
                found.append(f"{file}:{node.lineno} {ast.unparse(node)} ({kind or 'no annotation'})")
    assert not found, listed(found)


def own_private_names(tree: ast.Module) -> set[str]:
    """Private names that a module defines: functions, methods, fields, attributes of its objects."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names


def test_no_module_reads_what_another_keeps_private():
    found = []
    for file, tree in modules():
        own = own_private_names(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.endswith("__"):
                of_self = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
                inherited = isinstance(node.value, ast.Call) and ast.unparse(node.value) == "super()"
                allowed = of_self or inherited or node.attr in NAMED_TUPLE or node.attr in own
                if not allowed and file not in NUMBA_INSIDE:
                    found.append(f"{file}:{node.lineno} {ast.unparse(node)[:60]}")
            elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES:
                found += [
                    f"{file}:{node.lineno} {node.module}.{alias.name}"
                    for alias in node.names
                    if alias.name.startswith("_") and not alias.name.endswith("__")
                ]
    assert not found, listed(found)


def required_arguments(function: ast.FunctionDef) -> int:
    """Arguments without options: an option is keyword-only with a default, and a call names those it needs.

    The environment and the factories of soils and vehicles are such interfaces: a record of options instead
    would move the same names elsewhere, and ``**kwargs`` would accept a misspelt one.
    """
    options = sum(default is not None for default in function.args.kw_defaults)
    return len(arguments_of(function)) - options


def test_no_function_takes_more_arguments_than_a_reader_can_hold():
    found = [
        f"{file}:{f.lineno} {f.name}: {required_arguments(f)} arguments"
        for file, f in functions()
        if required_arguments(f) > MOST_ARGUMENTS
    ]
    assert not found, listed(found)


def test_no_modules_import_each_other_in_a_circle():
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    found = [f"{chain[0]} <-> {chain[-1]}" for chain in circles(graph)]
    assert not found, listed(found)


def circles(graph: grimp.ImportGraph) -> list[list[str]]:
    """Groups of modules that import each other, however indirectly (Tarjan)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(module: str) -> None:
        order[module] = lowest[module] = len(order)
        stack.append(module)
        for imported in sorted(graph.find_modules_directly_imported_by(module)):
            if imported not in order:
                visit(imported)
                lowest[module] = min(lowest[module], lowest[imported])
            elif imported in stack:
                lowest[module] = min(lowest[module], order[imported])
        if lowest[module] == order[module]:
            group = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(group) > 1:
                groups.append(group)

    for module in sorted(graph.modules):
        if module not in order:
            visit(module)
    return groups


def test_the_import_contract_is_short():
    text = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    contract = text[text.index("[[tool.importlinter.contracts]]") :].split("\n[tool", 1)[0]
    assert text.count("[[tool.importlinter.contracts]]") == 1
    assert len(contract.strip().splitlines()) <= 12


@pytest.mark.parametrize("law", ["bekker", "mohr_coulomb", "janosi", "wong_reece"])
def test_a_law_of_the_literature_is_a_function_of_that_name(law):
    places = [
        file
        for file, function in functions()
        if Path(file).parts[:2] == ("offroad_env", "physics") and law in function.name
    ]
    assert places, f"no function of the physics is named after {law}"
