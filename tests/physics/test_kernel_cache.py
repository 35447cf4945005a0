"""The cache of compiled kernels: from nobody else, and rebuilt where it is damaged."""

from __future__ import annotations

import ast
import os
import pickle
import subprocess
import sys

import numba
import pytest

from helpers import REPOSITORY
from offroad_env.physics import _jit
from offroad_env.physics._kernel_cache import DurableCache
from offroad_env.physics._kernel_folder import own_folder

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

MODULE = """
from offroad_env.physics._jit import kernel

@kernel
def doubled(x):
    return x + x
"""
PROGRAM = "from doubling import doubled; print(doubled(2.0), sum(doubled._cache_hits.values()))"


def doubled(folder, **environment):
    """(Value and number of hits, what went to standard error) of a kernel in a new interpreter."""
    (folder / "doubling.py").write_text(MODULE, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
        env={
            **os.environ,
            "PYTHONPATH": f"{REPOSITORY}:{folder}",
            "OFFROAD_CACHE": str(folder / "cache"),
            **environment,
        },
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


def files(folder, ending):
    return [path for path in (folder / "cache").rglob(f"*{ending}") if "doubled" in path.name]


def parsed_imports(module):
    """What `_jit._imports` finds, from the whole syntax tree of the module."""
    names = set()
    for node in ast.parse(_jit._text(module)).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name for name in names if _jit._source(name)}


def test_the_quick_search_for_imports_misses_none_of_ours():
    """A kernel of a module that it missed could be changed and the old machine code be taken."""
    found = 0
    for package in _jit._PACKAGES:
        for file in (REPOSITORY / package).rglob("*.py"):
            module = ".".join(file.relative_to(REPOSITORY).with_suffix("").parts)
            parsed = parsed_imports(module)
            assert parsed <= _jit._imports(module), module
            found += len(parsed)
    assert found > 1000


@pytest.mark.parametrize(
    "text",
    [
        "from offroad_env.a import b  # (of c",
        "from offroad_env.a import (\n    c,  # (of d)\n    b,\n)",
        "from offroad_env.a import c, \\\n    b",
        "from offroad_env.a import (c as d, b)",
        '"""\nfrom offroad_env to estimators\n"""\nfrom offroad_env.a import b',
    ],
    ids=["open bracket", "closed bracket", "line goes on", "brackets", "text"],
)
def test_no_comment_and_no_text_hides_an_import(text):
    nodes = [node for node in _jit._importing(f"{text}\n\nx = (1)\n") if isinstance(node, ast.ImportFrom)]
    assert [node.module for node in nodes] == ["offroad_env.a"]
    assert "b" in {alias.name for alias in nodes[0].names}


def test_what_is_imported_late_counts():
    assert "offroad_env.effects.library" in _jit._imports("offroad_env.physics.hooks")


@pytest.mark.check
def test_a_second_process_takes_what_the_first_has_compiled(tmp_path):
    assert doubled(tmp_path)[0] == ["4.0", "0"]
    assert doubled(tmp_path)[0] == ["4.0", "1"]


@pytest.mark.check
def test_processes_that_begin_at_once_on_a_cold_cache_find_the_same(tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: doubled(tmp_path), range(4)))
    assert [(value, said) for (value, _), said in found] == [("4.0", "")] * 4
    assert doubled(tmp_path) == (["4.0", "1"], "")


@pytest.mark.check
@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content[:-9] + b"x" * 9,
    ],
    ids=["empty", "cut off", "bits"],
)
def test_a_damaged_cache_is_built_anew(tmp_path, ending, damage):
    doubled(tmp_path)
    (path,) = files(tmp_path, ending)
    path.write_bytes(damage(path.read_bytes()))
    assert doubled(tmp_path) == (["4.0", "0"], "")
    assert doubled(tmp_path)[0] == ["4.0", "1"]


def test_a_crafted_cache_runs_nothing(tmp_path):
    """Its hash fits no content that this project has written; and its folder takes no files of others."""
    doubled(tmp_path)
    mark = tmp_path / "ran"

    class Payload:
        def __reduce__(self):
            return (open, (str(mark), "w"))

    for ending in (".nbi", ".nbc"):
        (path,) = files(tmp_path, ending)
        path.write_bytes(pickle.dumps(Payload()))
    assert doubled(tmp_path)[0] == ["4.0", "0"]
    assert not mark.exists()


@pytest.mark.check
def test_a_folder_that_others_may_write_to_is_not_used_and_that_is_stated_once(tmp_path):
    doubled(tmp_path)
    for path in (tmp_path / "cache" / "kernels").iterdir():
        path.chmod(0o777)
    value, said = doubled(tmp_path)
    assert value == ["4.0", "0"]
    assert said.count("other users may write there") == 1


def test_a_folder_that_is_a_link_or_belongs_to_somebody_else_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert own_folder(str(tmp_path / "real"))
    (tmp_path / "open").mkdir(mode=0o700)
    (tmp_path / "open").chmod(0o770)
    assert not own_folder(str(tmp_path / "open"))
    assert not own_folder(str(tmp_path / "link"))
    own_folder.cache_clear()
    os_geteuid = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: os_geteuid + 1)
    if os_geteuid == 0:
        os.chown(tmp_path / "real", 12345, -1)
    assert not own_folder(str(tmp_path / "real"))


@pytest.mark.check
def test_without_a_place_for_it_a_process_compiles_for_itself(tmp_path):
    (tmp_path / "cache").write_text("a file in the place of the folder")
    value, said = doubled(tmp_path)
    assert value == ["4.0", "0"]
    assert said.count("compiled kernels are not kept") == 1


def test_a_full_disk_costs_the_next_process_time_and_nothing_else(monkeypatch, caplog):
    from numba.core.caching import FunctionCache

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FunctionCache, "save_overload", full)
    cache = object.__new__(DurableCache)
    cache._cache_path = "/somewhere/kernels/x"
    cache.save_overload(None, None)
    assert "No space left on device" in caplog.text
