"""Speed of fleets on a graphics processor: `python benchmarks/gpu.py --json gpu.json --figure gpu.png`.

Vehicles of the full model on clay and an average unpaved road, as in `benchmarks/fleet.py`. A rate is
vehicles times intervals of 20 ms in a second, by the clock: on the device in one call for a drive and in one
call an interval, and on all processors of this machine. Beside them the most that the device could do: the
arithmetic of an interval (`benchmarks/operations.py`) at the rate of a loop that does nothing else, and the
numbers of a vehicle, read and written once an interval, at the rate of a copy.

Needs a CUDA device and `pip install "offroad-bekker[cuda]"`. Where there is no device, `--ptx FILE` still
writes the code for an H100, of which `ptxas -arch=sm_90 -v FILE -o FILE.cubin` tells registers and memory.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fleet import COMMAND, full_plant
from numba import cuda, float64, int64, types
from operations import operations

from offroad_env.physics import state as at
from offroad_env.physics.packing import pack
from offroad_env.simulation.fleet import simulate_fleet_commands, vary
from offroad_env.simulation.fleet_cuda import (
    CudaFleet,
    CudaUnavailableError,
    Kept,
    Plants,
    Vehicles,
    make_kernels,
)

#: Vehicles of a fleet, and up to which the processors are timed: their rate does not grow with it.
COUNTS, ON_PROCESSORS = tuple(4**k for k in range(3, 9)), 4096
#: Intervals of a drive.
DRIVE = 50
#: Bytes of a vehicle: state, slope, readings, warm start and status are read and written in a call, the count
#: of intervals is written, and the parameters are read.
MOVED = 8 * (2 * (2 * at.STATE_SIZE + at.READINGS_SIZE + 2 * at.CONTACT_SIZE + 1) + 1)
MOVED += pack(full_plant()[0]).numbers.nbytes
#: Threads of the loop that only multiplies and adds, in one block, and its turns; numbers that are copied.
THREADS, BLOCK, TURNS, COPIED = 1 << 18, 256, 20_000, 1 << 25
#: Largest difference of a state from the processor's, as a share of the largest of its kind.
TOLERANCE = 1e-9


def seconds(work: Callable[[], object]) -> float:
    """Time of the call on the wall, until the device has done it."""
    cuda.synchronize()
    start = time.perf_counter()
    work()
    cuda.synchronize()
    return time.perf_counter() - start


def rates(times: list[float], amount: float) -> dict[str, float]:
    """Median, lowest and highest of ``amount`` a second."""
    found = [amount / each for each in times]
    return {"rate": statistics.median(found), "lowest": min(found), "highest": max(found)}


def measure(count: int, rounds: int) -> dict[str, dict[str, float]]:
    """Rates of ``count`` vehicles on the device, and on the processors up to a size."""
    plant, state, warm = full_plant()
    fleet = vary(plant, {"n": plant.soil.n * np.linspace(0.95, 1.05, 2 * count + 1)[1::2]})
    held = np.tile(COMMAND, (DRIVE, 1))
    here = CudaFleet(fleet, state, warm)
    drive, command = cuda.to_device(held), cuda.to_device(held[0])

    def by_steps() -> None:
        for _ in range(DRIVE):
            here.step(command)

    def there() -> None:
        simulate_fleet_commands(fleet, state, warm, held, every=False)

    work = {"one call": lambda: here.run(drive, every=False), "a call an interval": by_steps}
    if count <= ON_PROCESSORS:
        work["processors"] = there
    times: dict[str, list[float]] = {name: [] for name in work}
    for turn in range(rounds + 1):
        for name, call in work.items():
            here.start(state, warm)
            spent = seconds(call)
            if turn > 0:  # the first is for the compilers
                times[name].append(spent)
    if (here.status.copy_to_host() > 1.0).any():
        raise RuntimeError("a vehicle of the fleet did not come to the end")
    return {name: rates(spent, count * DRIVE) for name, spent in times.items()}


def difference() -> float:
    """Largest difference of a state at the end of a drive from the processor's; as a share of its largest."""
    plant, state, warm = full_plant()
    fleet = vary(plant, {"n": plant.soil.n * np.linspace(0.8, 1.2, 64)})
    held = np.random.default_rng(0).uniform([-0.2, 0.0, 0.0], [0.2, 800.0, 200.0], (64, DRIVE, 3))
    there = simulate_fleet_commands(fleet, state, warm, held, every=False).states[0]
    here = CudaFleet(fleet, state, warm).run(held, every=False).states.copy_to_host()[0]
    return float(np.max(np.abs(here - there) / np.maximum(np.abs(there).max(axis=0), 1e-3)))


def _multiply_add(out, turns):
    """Eight chains of multiplications and additions that end near one."""
    i = cuda.grid(1)
    if i < out.shape[0]:
        a, b, c, d = 1.0, 1.1, 1.2, 1.3
        e, f, g, h = 1.4, 1.5, 1.6, 1.0 + 1e-9 * i
        for _ in range(turns):
            a, b, c, d = a * 0.5 + 0.5, b * 0.5 + 0.5, c * 0.5 + 0.5, d * 0.5 + 0.5
            e, f, g, h = e * 0.5 + 0.5, f * 0.5 + 0.5, g * 0.5 + 0.5, h * 0.5 + 0.5
        out[i] = a + b + c + d + e + f + g + h


def limits(arithmetic: float, rounds: int) -> dict[str, float]:
    """What the device does of nothing else, and the intervals a second that this allows."""
    kernel, out = cuda.jit(_multiply_add), cuda.device_array(THREADS, np.float64)
    source, target = (cuda.device_array(COPIED, np.float64) for _ in range(2))
    flops = [seconds(lambda: kernel[THREADS // BLOCK, BLOCK](out, TURNS)) for _ in range(rounds + 1)]
    copies = [seconds(lambda: target.copy_to_device(source)) for _ in range(rounds + 1)]
    rate, bandwidth = 16 * THREADS * TURNS / min(flops[1:]), 2 * 8 * COPIED / min(copies[1:])
    return {
        "flop_per_s": rate,
        "byte_per_s": bandwidth,
        "arithmetic": rate / arithmetic,
        "memory": bandwidth / MOVED,
    }


def write_ptx(path: Path) -> None:
    """What the compiler makes of the kernel that drives, for an H100; needs no device."""
    from numba.cuda import dispatcher

    target = 9, 0
    # Functions that a kernel calls are compiled for the device at hand.
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=target)
    cube, table, vector = float64[:, :, ::1], float64[:, ::1], float64[::1]
    vehicles = (table, table, cube, table, vector, int64[::1])
    kinds = (
        types.BaseTuple.from_types((table,) * 3, Plants),
        types.BaseTuple.from_types(vehicles, Vehicles),
        cube,
        types.Tuple((float64, int64)),
        types.BaseTuple.from_types((cube, cube), Kept),
    )
    path.write_text(cuda.compile_ptx(make_kernels(False)[1].py_func, kinds, cc=target)[0])


def draw(results: dict, path: Path) -> None:
    """Rates over the number of vehicles."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
    labels = {
        "one call": "device, one call for a drive",
        "a call an interval": "device, a call an interval",
        "processors": f"{results['processors']} processors",
    }
    for name, label in labels.items():
        rows = [(int(count), row[name]) for count, row in results["fleets"].items() if name in row]
        middle = np.array([row["rate"] for _, row in rows])
        band = [middle - [row["lowest"] for _, row in rows], [row["highest"] for _, row in rows] - middle]
        axes.errorbar([count for count, _ in rows], middle, band, fmt="o-", ms=4, capsize=3, label=label)
    for name, style in (("arithmetic", "--"), ("memory", ":")):
        axes.axhline(results["limits"][name], color="0.4", ls=style, label=f"limit of {name}")
    axes.set(
        xscale="log", yscale="log", xlabel="vehicles", ylabel="vehicles x intervals of 20 ms in a second"
    )
    axes.set_title(results["device"], fontsize=10)
    axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(path, dpi=150)


def write_json(results: dict, path: Path) -> None:
    """All figures, in one piece or not at all."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(results, indent=2) + "\n")
    partial.replace(path)


def main() -> None:
    """Measure, print and, if asked, write JSON and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS, help="vehicles of the fleets")
    parser.add_argument("--rounds", type=int, default=5, help="turns that each side takes")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--figure", type=Path, help="picture of the rates (PNG)")
    parser.add_argument("--ptx", type=Path, help="write the code for an H100, and stop")
    arguments = parser.parse_args()
    if arguments.ptx and importlib.util.find_spec("numba_cuda") is None:
        parser.exit(1, "the compiler for CUDA is missing: pip install offroad-bekker[cuda]\n")
    if arguments.ptx:
        write_ptx(arguments.ptx)
        return
    arithmetic = operations()["all"]
    print(f"an interval of a vehicle: {arithmetic:.0f} additions and multiplications, {MOVED} bytes moved")
    try:
        off = difference()
    except CudaUnavailableError as error:
        parser.exit(1, f"{error}\n")
    print(f"largest difference from the processor after {DRIVE} intervals: {off:.1e} (at most {TOLERANCE:g})")
    results = {
        "device": str(cuda.get_current_device().name),
        "processors": len(os.sched_getaffinity(0)),
        "difference": off,
        "limits": limits(arithmetic, arguments.rounds),
        "fleets": {},
    }
    bound = results["limits"]
    print(
        f"{results['device']}: {bound['flop_per_s'] / 1e12:.2f} TFLOP/s, {bound['byte_per_s'] / 1e9:.0f} GB/s"
    )
    for count in arguments.counts:
        row = results["fleets"][str(count)] = measure(count, arguments.rounds)
        for name, found in row.items():
            shares = "".join(
                f"  {found['rate'] / bound[key]:8.2%} of {key}" for key in ("arithmetic", "memory")
            )
            spread = f"{found['rate']:12.0f} /s [{found['lowest']:.0f}, {found['highest']:.0f}]"
            print(f"{count:6d} vehicles, {name:20s}{spread}" + ("" if name == "processors" else shares))
        if arguments.json:
            write_json(results, arguments.json)
    if arguments.figure:
        draw(results, arguments.figure)
    if off > TOLERANCE:
        parser.exit(1, "the device does not agree with the processor\n")


if __name__ == "__main__":
    main()
