"""Fleets on a graphics processor: what can be shown without one, and what is asked of one that is there."""

from __future__ import annotations

import importlib.util
import re

import numpy as np
import pytest
from numba import cuda

from helpers import run_fresh
from offroad_env.errors import InvalidParameter
from offroad_env.simulation.fleet import Fleet, make_fleet, simulate_fleet_commands, vary
from offroad_env.simulation.fleet_cuda import CudaFleet, CudaUnavailableError
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.natural_soil import natural_soil
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, rough_terrain
from offroad_env.world.vehicles import VEHICLES

HAS_NUMBA_CUDA = importlib.util.find_spec("numba_cuda") is not None
NO_NUMBA_CUDA = "needs numba-cuda: pip install offroad-bekker[cuda]"
on_device = pytest.mark.skipif(
    not (HAS_NUMBA_CUDA and cuda.is_available()),
    reason="needs a CUDA device" if HAS_NUMBA_CUDA else NO_NUMBA_CUDA,
)
#: Three blocks, the last not full.
COUNT, INTERVALS = 70, 20


def clay_fleet(model: str = "full") -> tuple[Fleet, np.ndarray, np.ndarray]:
    """Vehicles on an unpaved road of clays, with the start of all; the third is on clay that drowns it."""
    ground = rough_terrain("C", np.random.default_rng(0))
    plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], ground, model=model, slip=0.03)
    exponents = plant.soil.n * np.linspace(0.8, 1.2, COUNT)
    exponents[2] = 2.4
    return vary(plant, {"n": exponents}), *settled_state(plant, v_x=5.0)


def drive() -> np.ndarray:
    """Different commands for each vehicle."""
    low, high = [-0.2, 0.0, 0.0], [0.2, 800.0, 200.0]
    return np.random.default_rng(1).uniform(low, high, (COUNT, INTERVALS, 3))


# Neither compiler nor device: numba's simulator calls the code of each thread as Python, and so is the fleet
# on the processor. The numbers must then be the same to the last bit.
SIMULATED = """
import os
os.environ |= {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}
import numpy as np
from numba import cuda
from offroad_env.effects import Setup, apply
from offroad_env.simulation.fleet import make_fleet, simulate_fleet_commands, vary
from offroad_env.simulation.fleet_cuda import CudaFleet
from offroad_env.simulation.sensors import ImuConfig
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import flat, paper_terrain
from offroad_env.world.vehicles import VEHICLES

same = lambda ours, theirs: np.testing.assert_array_equal(ours.copy_to_host(), theirs)
commands = np.random.default_rng(1).uniform([-0.2, 0, 0], [0.2, 800, 200], (3, 6, 3))
"""

SIMULATED_DRIVE = (
    SIMULATED
    + """
plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], flat())
state, warm = settled_state(plant, v_x=4.0)
fleet = vary(plant, {"n": np.array([plant.soil.n, 2.4, 0.7])})
there = simulate_fleet_commands(fleet, state, warm, commands, threads=1)
here = CudaFleet(fleet, state, warm)
run = here.run(commands)
for name in ("states", "readings", "status", "done"):
    same(getattr(run, name), getattr(there, name))
print("sunk after", int(there.done[1]), "of", commands.shape[1])

# By steps; the last row is where all end, without every row too.
here.start(state, warm)
for k in range(commands.shape[1]):
    here.step(commands[:, k])
same(here.states, there.states[-1])
same(here.readings, there.readings[-1])
here.start(state, warm)
same(here.run(commands, every=False).states, there.states[-1:])

# The drowned one begins anew, on other soil; the others stay where they are.
here.numbers[1] = fleet.packed.numbers[0]
here.start(state, warm, where=[False, True, False])
same(here.states, [there.states[-1, 0], state, there.states[-1, 2]])
here.run(commands[0])
again = simulate_fleet_commands(make_fleet([plant]), state, warm, commands[0], threads=1)
assert np.array_equal(here.states[1].copy_to_host(), again.states[-1, 0])

# A command that is not finite: refused where it can be seen, a stop for one vehicle where it cannot.
commands[2, 3] = np.nan
here.start(state, warm)
try:
    here.run(commands)
except ValueError as error:
    print(error)
cuda.as_cuda_array = lambda given: cuda.to_device(given.array)
class Tensor:
    def __init__(self, array):
        self.array = self.__cuda_array_interface__ = array
here.run(Tensor(commands))
print("carried out", *here.done, "of", commands.shape[1])
for values in (commands.astype(np.float32), commands[:, ::2]):
    try:
        here.run(Tensor(values))
    except ValueError as error:
        print(error)
"""
)

SIMULATED_EFFECTS = (
    SIMULATED
    + """
plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], paper_terrain(0.05))
setup = Setup(plant=plant, mount=ImuConfig().mount())
laden = apply(setup, [("rolling_resistance", {"share": 0.05})]).plant
state, warm = settled_state(laden, v_x=4.0)
there = simulate_fleet_commands(make_fleet([laden]), state, warm, commands[0], threads=1)
same(CudaFleet(make_fleet([laden]), state, warm).run(commands[0]).states, there.states)
plain = simulate_fleet_commands(make_fleet([plant]), state, warm, commands[0], threads=1)
print(np.abs(plain.states - there.states).max() > 1e-4)
"""
)


@pytest.mark.check
def test_a_thread_drives_a_vehicle_as_the_processor_does_to_the_last_bit():
    sunk, refused, stopped, single, strided = run_fresh(SIMULATED_DRIVE).splitlines()
    # A vehicle is lost on the way, and its command, if not finite, takes no other along.
    assert re.fullmatch(r"sunk after [1-5] of 6", sunk)
    assert "commands must be finite" in refused
    assert stopped == "carried out 6 6 3 of 6"
    assert "float64, got float32" in single
    assert "contiguous" in strided


def test_a_fleet_carries_its_effects_to_the_device():
    assert run_fresh(SIMULATED_EFFECTS).strip() == "True"


def test_where_nothing_can_run_the_reason_is_said(monkeypatch):
    fleet, state, warm = clay_fleet()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CudaUnavailableError, match=r"pip install .*offroad-bekker\[cuda\]"):
        CudaFleet(fleet, state, warm)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name)
    monkeypatch.setattr(cuda, "is_available", lambda: False)
    with pytest.raises(CudaUnavailableError, match="no CUDA device"):
        CudaFleet(fleet, state, warm)
    with pytest.raises(InvalidParameter, match="full model"):
        CudaFleet(*clay_fleet("paper"))


def test_a_numba_without_a_target_for_cuda_is_no_error_before_a_device_is_asked_for():
    code = """
import sys
sys.modules["numba.cuda"] = None
from offroad_env.simulation import fleet_cuda
fleet_cuda.importlib.util.find_spec = lambda name: None
try:
    fleet_cuda._require_device()
except fleet_cuda.CudaUnavailableError as error:
    print(error)
"""
    assert "offroad-bekker[cuda]" in run_fresh(code)


# Functions that a kernel calls are compiled for the device at hand; here there is none.
COMPILED = """
import sys
from types import SimpleNamespace
from numba import boolean, cuda, float64, int64, types
from numba.cuda import dispatcher
import offroad_env.effects
from offroad_env.simulation.fleet_cuda import ChangedPlants, Kept, Plants, Start, Vehicles, make_kernels

TARGET, changed = (9, 0), {changed}
dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=TARGET)
cube, table, vector = float64[:, :, ::1], float64[:, ::1], float64[::1]
named, record = types.BaseTuple.from_types, ChangedPlants if changed else Plants
plants = named((table,) * len(record._fields), record)
vehicles = named((table, table, cube, table, vector, int64[::1]), Vehicles)
given, timing, kept = named((table, cube), Start), types.Tuple((float64, int64)), named((cube, cube), Kept)
start, drive = make_kernels(changed)
for kernel, kinds in (
    (start, (plants, given, boolean[::1], vehicles)),
    (drive, (plants, vehicles, cube, timing, kept)),
):
    print(cuda.compile_ptx(kernel.py_func, kinds, cc=TARGET)[0])
"""


@pytest.mark.study
@pytest.mark.skipif(not HAS_NUMBA_CUDA, reason=NO_NUMBA_CUDA)
@pytest.mark.parametrize("changed", [False, True])
def test_the_kernels_compile_for_a_device_without_a_call_to_the_host(changed):
    ptx = run_fresh(COMPILED.format(changed=changed))
    assert ptx.count(".target sm_90") == 2
    for name in ("start", "drive"):
        assert re.search(rf"\.visible \.entry \w*{name}_kernel\w*{name}", ptx)
    # Double precision throughout; no memory asked for, nothing called that lies elsewhere.
    assert len(re.findall(r"\bfma\.rn\.f64\b", ptx)) > 1000
    assert "malloc" not in ptx
    assert ".extern" not in ptx


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"structure": "grid"}, "no structure:"),
        ({"structure": "field", "tyre": "mrzr"}, "no tyre or structure:"),
        ({"vehicle_model": "four_wheel"}, "no vehicle_model='four_wheel':"),
        ({"soil_field": natural_soil(SOILS["clay"], 0)}, "no soil_field:"),
    ],
)
def test_what_the_kernels_of_a_device_do_not_have_is_refused_by_name(options, named):
    """With or without a device: the fleet on processors would give other numbers."""
    plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], flat(), **options)
    with pytest.raises(InvalidParameter, match=named):
        CudaFleet(make_fleet([plant]), np.zeros(1), np.zeros(1))


@on_device
def test_a_fleet_on_a_device_is_the_fleet_on_the_processor():
    fleet, state, warm = clay_fleet()
    there = simulate_fleet_commands(fleet, state, warm, drive())
    assert (there.done < INTERVALS).any()
    here = CudaFleet(fleet, state, warm)
    run = here.run(drive())
    np.testing.assert_array_equal(run.done.copy_to_host(), there.done)
    np.testing.assert_array_equal(run.status.copy_to_host(), there.status)
    # Another compiler and another library for tanh: rounding differs, nothing else.
    np.testing.assert_allclose(run.states.copy_to_host(), there.states, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(run.readings.copy_to_host(), there.readings, rtol=1e-9, atol=1e-6)
    by_run = here.states.copy_to_host()
    here.start(state, warm)
    for k in range(INTERVALS):
        here.step(np.ascontiguousarray(drive()[:, k]))
    np.testing.assert_array_equal(here.states.copy_to_host(), by_run)


@on_device
def test_a_fleet_shares_its_memory_with_torch_and_works_on_its_streams():
    torch = pytest.importorskip("torch", reason="needs torch: pip install offroad-bekker[rl]")
    if not torch.cuda.is_available():
        pytest.skip("needs a torch that sees the CUDA device")
    fleet, state, warm = clay_fleet()
    here = CudaFleet(fleet, state, warm)
    states = torch.as_tensor(here.states, device="cuda")
    assert states.data_ptr() == here.states.__cuda_array_interface__["data"][0]
    held = torch.as_tensor(drive(), device="cuda")
    expected = here.run(held, every=False).states.copy_to_host()[0]
    np.testing.assert_array_equal(states.cpu().numpy(), expected)
    # On a stream of torch's own, whose work must be done before the commands are read.
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream()):
        queue = torch.cuda.current_stream()
        here.start(state, warm, stream=queue)
        for k in range(INTERVALS):
            here.step((held[:, k] * 2.0 - held[:, k]).contiguous(), stream=queue)
        queue.synchronize()
    np.testing.assert_allclose(states.cpu().numpy(), expected, rtol=1e-9, atol=1e-10)
    with pytest.raises(InvalidParameter, match="float64, got float32"):
        here.run(held.float())
