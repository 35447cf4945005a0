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


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph(*PACKAGES, include_external_packages=True, cache_dir=None)


def imported_by(graph, folder):
    """What the modules of a folder import, by the first name, without the folder itself."""
    members = {folder} | graph.find_descendants(folder)
    assert len(members) > 1
    return set().union(*(graph.find_modules_directly_imported_by(module) for module in members)) - members


def outside(graph, folder):
    return {name.partition(".")[0] for name in imported_by(graph, folder)} - set(PACKAGES)


def test_physics_imports_only_numpy_numba_and_the_standard_library(graph):
    imported = outside(graph, "offroad_env.physics")
    assert "numba" in imported
    assert imported - {"numba", "numpy"} - sys.stdlib_module_names == set()


@pytest.mark.parametrize(
    "folder", ["offroad_env.simulation", "offroad_env.world", "offroad_env.effects", "estimators"]
)
def test_what_lies_below_the_environment_knows_nothing_of_its_interface(graph, folder):
    assert "gymnasium" not in outside(graph, folder)


@pytest.mark.parametrize("learner", ["sb3_contrib", "stable_baselines3", "torch"])
def test_only_agents_learns_beside_the_adapter_for_plain_stable_baselines3(graph, learner):
    users = graph.find_modules_that_directly_import(learner) if learner in graph.modules else set()
    others = {user for user in users if user.partition(".")[0] != "agents"}
    assert others <= {"offroad_env.environment.sb3_vec"}


def test_only_agents_uses_the_lazy_exports_which_reach_every_floor(graph):
    users = graph.find_modules_that_directly_import("offroad_env")
    assert users
    assert {user.partition(".")[0] for user in users} == {"agents"}


def test_every_module_of_the_environment_package_stands_on_a_floor(graph):
    config = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    (contract,) = config["tool"]["importlinter"]["contracts"]
    placed = set(re.findall(r"offroad_env\.(\w+)", " ".join(contract["layers"])))
    present = {child.rpartition(".")[2] for child in graph.find_children("offroad_env")}
    assert present == placed, "the layers of pyproject.toml name every folder, and no other"
