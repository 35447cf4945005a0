"""The floors of the project, where the import contracts of pyproject.toml cannot see."""

from __future__ import annotations

import re
import sys
import tomllib

import grimp
import pytest

from helpers import REPOSITORY, run_fresh

PACKAGES = ("agents", "estimators", "offroad_env")


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_can_be_the_first_import_of_an_interpreter(package):
    run_fresh(f"import {package}")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_exists_in_an_interpreter_that_imported_nothing_else(package):
    missing = "name for name in getattr(p, '__all__', ()) if not hasattr(p, name)"
    assert run_fresh(f"import {package} as p; print(*({missing}))").split() == []


@pytest.mark.parametrize("heavy", ["matplotlib", "pandas", "pygame", "stable_baselines3", "torch"])
def test_the_environment_package_loads_nothing_heavy(heavy):
    loaded = run_fresh("import offroad_env, sys; print(*sys.modules)").split()
    assert "offroad_env" in loaded
    assert heavy not in loaded


def test_physics_imports_only_numpy_numba_and_the_standard_library():
    graph = grimp.build_graph("offroad_env", include_external_packages=True, cache_dir=None)
    physics = {"offroad_env.physics"} | graph.find_descendants("offroad_env.physics")
    imported = set().union(*(graph.find_modules_directly_imported_by(module) for module in physics))
    assert "numba" in imported
    assert imported - physics - {"numba", "numpy"} - sys.stdlib_module_names == set()


def test_every_module_of_the_environment_package_stands_on_a_floor():
    config = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = {contract["id"]: contract for contract in config["tool"]["importlinter"]["contracts"]}
    placed = set(re.findall(r"offroad_env\.(\w+)", " ".join(contracts["floors"]["layers"])))
    graph = grimp.build_graph("offroad_env", cache_dir=None)
    present = {child.rpartition(".")[2] for child in graph.find_children("offroad_env")}
    assert "physics" in present
    assert present <= placed, "name the new module in the layers of pyproject.toml"
