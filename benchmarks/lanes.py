"""What stepping vehicles side by side could gain at most: `python benchmarks/lanes.py`.

A fleet steps one vehicle after the other; the lanes of a vector register hold eight nodes of the contact
patch, or eight waves of the ground. Eight vehicles in step could share the instructions of the rest, which
is scalar: solving for the sinkage, angles and trigonometry of the patch, suspension, implicit step. The
loops that are vectors already stay as they are.

The two loops are timed alone and counted in a drive that runs without the compiler; what they leave of
the time of a drive is scalar. The limit supposes that lanes are free: no vehicle ever waits for the
iterations of another, and nothing is moved between the lanes.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time

import numpy as np
from fleet import COMMAND, DRIVE, by_fleet, full_plant

from offroad_env.physics import ground, stress_integrals
from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.contact_angles import AngleShares
from offroad_env.physics.contact_patch import contact_patch
from offroad_env.physics.ground import ground_readings
from offroad_env.physics.quadrature import WHOLE
from offroad_env.physics.records import Wheel
from offroad_env.physics.slip import ShearKinematics
from offroad_env.physics.soil_constants import soil_constants
from offroad_env.physics.stress_integrals import add_nodes, patch_stress
from offroad_env.simulation.simulator import simulate_commands

#: Intervals that are counted, calls that are timed at a time, turns.
COUNTED, CALLS, ROUNDS = 10, 20_000, 9
#: Vehicles in step, and how many of them an arithmetic unit of 256 bits takes at a time.
WIDTHS = {"eight lanes": 8.0, "four lanes (registers of 256 bits)": 4.0}


@kernel
def node_loops(constants, count):
    """Eight nodes of both segments, again and again at slightly another sinkage."""
    total = 0.0
    for i in range(count):
        patch = contact_patch(AngleShares(0.4, -0.1), 0.03 + 1e-5 * (i % 7), constants.r)
        stress = patch_stress(constants, ShearKinematics(1.0, 0.95, 0.02))
        total += add_nodes(patch, stress, 1.0, (1.0, 1.0), WHOLE).z
    return total


@kernel
def patches_alone(constants, count):
    """What `node_loops` spends around the nodes."""
    total = 0.0
    for i in range(count):
        patch = contact_patch(AngleShares(0.4, -0.1), 0.03 + 1e-5 * (i % 7), constants.r)
        stress = patch_stress(constants, ShearKinematics(1.0, 0.95, 0.02))
        total += patch.sin_f + stress.A_x
    return total


@kernel
def wave_loops(terrain, count):
    """All waves of the ground, again and again at another place."""
    total = 0.0
    for i in range(count):
        total += ground_readings(terrain, 0.1 * (i % 11), 0.2).H
    return total


def microseconds(work: object, argument: object) -> float:
    """Median time of one of the calls in a loop."""
    work(argument, 10)
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work(argument, CALLS)
        times.append(time.process_time() - start)
    return 1e6 * statistics.median(times) / CALLS


def count_calls() -> dict[str, float]:
    """Calls in an interval of a vehicle; only without the compiler can they be counted."""
    calls = {"add_nodes": 0, "_wave_sums": 0}
    for module, name in ((stress_integrals, "add_nodes"), (ground, "_wave_sums")):

        def counted(*arguments: object, plain: object = getattr(module, name), name: str = name) -> object:
            calls[name] += 1
            return plain(*arguments)

        setattr(module, name, counted)
    plant, state, warm = full_plant()
    state[at.DRIVE] = COMMAND[1]
    before = dict(calls)
    simulate_commands(plant, state, warm, np.tile(COMMAND, (COUNTED, 1)))
    return {name: (calls[name] - before[name]) / COUNTED for name in calls}


def main() -> None:
    """Measure and print."""
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        print(json.dumps(count_calls()))
        return
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, __file__], env=plain, capture_output=True, text=True, check=True)
    calls = json.loads(done.stdout)
    plant = full_plant()[0]
    constants = soil_constants(plant.soil, Wheel(plant.vehicle.r, plant.vehicle.b))
    nodes = microseconds(node_loops, constants) - microseconds(patches_alone, constants)
    waves = microseconds(wave_loops, plant.ground)
    run = by_fleet(64)
    run()
    whole = 1e6 * statistics.median(run() for _ in range(ROUNDS))
    parts = {"nodes": calls["add_nodes"] * nodes, "waves": calls["_wave_sums"] * waves}
    scalar = whole - sum(parts.values())
    print(f"an interval of 0.02 s of one of 64 vehicles, {DRIVE} intervals each: {whole:.1f} us")
    for name, each, count in (("nodes", nodes, calls["add_nodes"]), ("waves", waves, calls["_wave_sums"])):
        print(f"  {name}: {parts[name]:.1f} us, {count:.1f} calls of {1e3 * each:.0f} ns")
    print(f"  the rest, scalar: {scalar:.1f} us")
    for name, width in WIDTHS.items():
        print(f"limit of {name}: {whole / (whole - scalar + scalar / width):.2f} times as fast")


if __name__ == "__main__":
    main()
