"""The same kernels, compiled for a graphics processor: as far as that can be shown without one."""

from __future__ import annotations

import importlib.util
import re

import pytest

from helpers import run_fresh

CODE = """
import sys
from types import SimpleNamespace
from numba import cuda, float64, int64
from numba.cuda import dispatcher
from offroad_env.physics import state as at
from offroad_env.physics.full_model import WORK_ROWS, full_step
from offroad_env.physics.numerics import LANES
from offroad_env.physics.packing import PackedPlant, unpack

TARGET, SCRATCH, ROWS = (9, 0), (WORK_ROWS, at.READINGS_SIZE), (8, LANES)
# Functions that a kernel calls are compiled for the device at hand; here there is none.
dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=TARGET)


@cuda.jit(device=True, inline="always")
def local_rows():
    return cuda.local.array(ROWS, float64)


# Scratch on the stack is asked for in another way there.
for name, module in list(sys.modules.items()):
    if name.startswith("offroad_env.physics.") and hasattr(module, "lane_rows"):
        module.lane_rows = local_rows


def advance(states, warms, numbers, waves, patches, commands, steps, readings, status):
    i = cuda.grid(1)
    if i < states.shape[0]:
        work = cuda.local.array(SCRATCH, float64)
        plant = unpack(PackedPlant(numbers[i], waves, patches))
        command = (commands[i, 0], commands[i, 1], commands[i, 2])
        worst = 0.0
        for _ in range(steps):
            worst = max(worst, full_step(states[i], warms[i], command, plant, 0.005, work, readings[i]))
        status[i] = worst


table, vector = float64[:, ::1], float64[::1]
kinds = (table, float64[:, :, ::1], table, table, table, table, int64, table, vector)
print(cuda.compile_ptx(advance, kinds, cc=TARGET)[0])
"""


@pytest.mark.study
@pytest.mark.skipif(
    importlib.util.find_spec("numba_cuda") is None,
    reason="needs numba-cuda: pip install offroad-bekker[cuda]",
)
def test_a_step_of_the_full_model_compiles_for_cuda_without_a_call_to_the_host():
    ptx = run_fresh(CODE)
    assert ".target sm_90" in ptx
    assert re.search(r"\.visible \.entry \w*advance", ptx)
    # Double precision throughout; a vehicle per thread, no memory asked for.
    assert len(re.findall(r"\bfma\.rn\.f64\b", ptx)) > 1000
    assert "malloc" not in ptx
