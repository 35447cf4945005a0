"""Kernels in two editions: both give the same numbers, and neither leaves memory behind."""

from __future__ import annotations

import gc
import sys

import numba
import numpy as np
import pytest

import offroad_env
from helpers import run_fresh
from offroad_env.physics._jit import apart_kernel, inline_kernel, kernel
from offroad_env.physics.axle import with_exponent
from offroad_env.physics.records import ContactOptions, Wheel, WheelMotion
from offroad_env.physics.settle import settle
from offroad_env.physics.wheel_soil import wheel_reaction
from offroad_env.simulation.fleet import simulate_fleet_commands, vary
from offroad_env.world.terrain import rough_terrain

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="there are no editions without the compiler")


@kernel
def reaction_of_softer_soil(soil, wheel, motion):
    return wheel_reaction(
        with_exponent(soil, 0.9 * soil.n), wheel, 0.05, motion, ContactOptions(0.1, 1.0, False)
    )


@kernel
def part_of_a_settled_state(plant, count):
    """Takes arrays over from another kernel, looks at part of one, and drops them."""
    total = 0.0
    for i in range(count):
        _, x, warm = settle(plant, (0.1 * i, 0.0, 0.0), 3.0)
        total += x[10:12][0] + warm[0, 0]
    return total


@kernel
def copied_row(table):
    table[0] = table[1]
    return table[0, 0]


@kernel
def copied_rows(table, count):
    """Calls a kernel in which numba itself takes room for a copy."""
    total = 0.0
    for _ in range(count):
        total += copied_row(table)
    return total


@kernel
def plain_square(x):
    return x * x


@apart_kernel
def distant_square(x):
    return x * x


@inline_kernel
def squares_inline(x):
    return plain_square(x) + distant_square(x)


@kernel
def squares(x):
    return squares_inline(x)


def in_use() -> int:
    """Arrays of numba that nobody has freed."""
    gc.collect()
    stats = numba.core.runtime.rtsys.get_allocation_stats()
    return stats.mi_alloc - stats.mi_free


@pytest.fixture
def counted():
    runtime = numba.core.runtime._nrt_python
    runtime.memsys_enable_stats()
    yield
    runtime.memsys_disable_stats()


def plant():
    ground = rough_terrain("C", np.random.default_rng(0))
    return offroad_env.make_plant(offroad_env.VEHICLES["mrzr"], offroad_env.SOILS["clay"], ground)


def test_both_editions_give_the_same_forces():
    soil, wheel, motion = offroad_env.SOILS["clay"], Wheel(0.33, 0.21), WheelMotion(3.2, 3.0, 0.1)
    softer = offroad_env.make_soil(soil, n=0.9 * soil.n)
    expected = wheel_reaction(softer, wheel, 0.05, motion, ContactOptions(0.1, 1.0, False))
    np.testing.assert_allclose(reaction_of_softer_soil(soil, wheel, motion), expected, rtol=1e-13)


def test_arrays_that_kernels_hand_over_are_freed(counted):
    truth = plant()
    part_of_a_settled_state(truth, 1)
    before = in_use()
    part_of_a_settled_state(truth, 50)
    assert in_use() == before


def test_room_that_numba_takes_for_itself_is_freed(counted):
    table = np.arange(6.0).reshape(2, 3)
    assert copied_rows(table, 1) == 3.0
    before = in_use()
    assert copied_rows(table, 50) == 150.0
    assert in_use() == before


@pytest.mark.parametrize("terrain_info", ["none", "estimate"])
def test_an_episode_leaves_no_memory_behind(counted, terrain_info):
    env = offroad_env.make_vec(2, scenario="speed", terrain_info=terrain_info, threads=1)
    env.reset(seed=0)
    actions = np.full((2, 2), 0.3)
    env.step(actions)
    before = in_use()
    for _ in range(30):
        env.step(actions)
    assert in_use() == before


def test_a_fleet_leaves_no_memory_behind(counted):
    truth = plant()
    state, warm = offroad_env.settled_state(truth, v_x=3.0)
    fleet = vary(truth, {"n": np.array([0.5, 0.6, 0.7])})
    commands = np.tile([0.02, 400.0, 0.0], (5, 1))
    simulate_fleet_commands(fleet, state, warm, commands, threads=1)
    before = in_use()
    simulate_fleet_commands(fleet, state, warm, commands, threads=1)
    assert in_use() == before


def test_python_holds_the_only_references_after_a_call():
    truth = plant()
    state, warm = offroad_env.settled_state(truth, v_x=3.0)
    before = sys.getrefcount(truth.ground.waves)
    part_of_a_settled_state(truth, 20)
    after = sys.getrefcount(truth.ground.waves)  # not within the assert, which would hold one more
    assert after == before
    assert np.isfinite(state).all()
    assert np.isfinite(warm).all()


MODULE = """
from offroad_env.physics._jit import apart_kernel, inline_kernel, kernel
from offroad_env.physics.numerics import sin_cos

@kernel
def {name}(x):
    s, c = sin_cos(x)
    return s * s + c * c
"""
PROGRAM = """
import os, sys
sys.path.append({folder!r})
os.environ["OFFROAD_CACHE"] = {folder!r}
from {name} import {name}, sin_cos
inner = sin_cos._numba_type_.dispatcher
print({name}(0.3), sum(inner._cache_hits.values()), sum(inner._cache_misses.values()))
"""


def test_another_interpreter_finds_what_one_has_translated(tmp_path):
    def calls(name: str) -> list[str]:
        (tmp_path / f"{name}.py").write_text(MODULE.format(name=name), encoding="utf-8")
        return run_fresh(PROGRAM.format(name=name, folder=str(tmp_path))).split()

    value, *counts = calls("first")
    assert float(value) == pytest.approx(1.0)
    assert counts == ["0", "1"]
    assert calls("second") == [value, "1", "0"]
    assert calls("first") == [value, "0", "0"]  # machine code is there: nothing is translated


def test_a_kernel_is_inlined_because_it_says_so_and_not_because_its_first_caller_does():
    assert squares(3.0) == 18.0

    def attributes(called) -> str:
        inner = called._numba_type_.dispatcher
        inner.compile((numba.float64,))  # nothing is translated where the caller came from the cache
        (found,) = inner.overloads.values()
        code = found.library._get_module_for_linking()
        return " ".join(str(a) for a in code.get_function(found.fndesc.llvm_func_name).attributes)

    assert "alwaysinline" in attributes(squares_inline)
    assert "inline" not in attributes(plain_square)
    assert "noinline" in attributes(distant_square)
