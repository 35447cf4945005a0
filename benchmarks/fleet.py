"""Speed of fleets as ratios in one run: `python benchmarks/fleet.py --json fleet.json`.

The full model of one vehicle and of 64, on clay and an average unpaved road, drives of 10 s. The sides take
turns, so that a busy machine slows all of them; CPU time is measured, and of threads the clock on the
wall, which only an idle machine gives a meaning: a loop that touches no memory says what two threads can
be worth. The median of the ratios is printed with its range.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.simulation.fleet import simulate_fleet_commands, vary
from offroad_env.simulation.simulator import FULL_STEP, Plant, make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import rough_terrain
from offroad_env.world.vehicles import VEHICLES

#: What was aimed at, as ratios of time.
AIMS = {
    "fleet / a vehicle stepped from Python": 0.5,
    "fleet / a vehicle in a compiled loop": 0.5,
    "two threads / one (wall)": 1.0 / 1.8,
}
#: Interval that commands are held for [s], intervals of a drive, and vehicles.
INTERVAL, DRIVE, COUNT = 0.02, 500, 64
COMMAND = (0.02, 400.0, 0.0)


def full_plant() -> tuple[Plant, np.ndarray, np.ndarray]:
    """The plant with its settled state and warm start."""
    ground = rough_terrain("C", np.random.default_rng(0))
    plant = make_plant(VEHICLES["mrzr"], SOILS["clay"], ground)
    return plant, *settled_state(plant, v_x=5.0)


def by_steps() -> Callable[[], float]:
    """Seconds per interval of one vehicle whose every step of 5 ms is a call from Python."""
    plant, state, warm = full_plant()
    readings = np.empty(at.READINGS_SIZE)

    def run() -> float:
        x, w = state.copy(), warm.copy()
        start = time.process_time()
        for _ in range(DRIVE * round(INTERVAL / FULL_STEP)):
            full_advance(x, w, COMMAND, plant, FULL_STEP, 1, readings)
        return (time.process_time() - start) / DRIVE

    return run


def by_fleet(count: int, threads: int = 1, *, wall: bool = False) -> Callable[[], float]:
    """Seconds per vehicle and interval of a fleet; one vehicle is a compiled loop, as `simulate_commands`."""
    plant, state, warm = full_plant()
    fleet = vary(plant, {"n": plant.soil.n * np.linspace(0.95, 1.05, 2 * count + 1)[1::2]})
    held = np.tile(COMMAND, (DRIVE, 1))
    clock = time.perf_counter if wall else time.process_time
    repeats = COUNT // count

    def run() -> float:
        start = clock()
        for _ in range(repeats):
            found = simulate_fleet_commands(fleet, state, warm, held, every=False, threads=threads)
            if (found.done < DRIVE).any():
                raise RuntimeError("a vehicle of the fleet did not come to the end")
        return (clock() - start) / (repeats * DRIVE * count)

    return run


@numba.njit(nogil=True)
def _spin(count: int) -> float:
    """A loop that needs a processor and nothing else."""
    total = 0.0
    for i in range(count):
        total += math.sqrt(i + total)
    return total


def by_spinning(threads: int) -> Callable[[], float]:
    """Seconds for two of these loops, in this many threads."""

    def run() -> float:
        start = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(_spin, [20_000_000] * 2))
        return time.perf_counter() - start

    return run


def take_turns(ours: Callable[[], float], peer: Callable[[], float], rounds: int) -> dict[str, float]:
    """Median and range of ours/peer over rounds in which both run once."""
    ours(), peer()
    pairs = [(ours(), peer()) for _ in range(rounds)]
    ratios = [a / b for a, b in pairs]
    return {
        "ours_us": 1e6 * statistics.median(a for a, _ in pairs),
        "peer_us": 1e6 * statistics.median(b for _, b in pairs),
        "ratio": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
    }


def main() -> None:
    """Measure, print and, if asked, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9, help="turns that each side takes")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    fleet = by_fleet(COUNT)
    results = {
        name: take_turns(ours, peer, arguments.rounds)
        for name, ours, peer in (
            ("fleet / a vehicle stepped from Python", fleet, by_steps()),
            ("fleet / a vehicle in a compiled loop", fleet, by_fleet(1)),
            ("two threads / one (wall)", by_fleet(COUNT, 2, wall=True), by_fleet(COUNT, 1, wall=True)),
            ("two threads / one (CPU)", by_fleet(COUNT, 2), fleet),
            ("the same for a bare loop (wall)", by_spinning(2), by_spinning(1)),
        )
    }
    for name, row in results.items():
        aim = f"  aim: at most {AIMS[name]:.2f}" if name in AIMS else ""
        print(
            f"{name:40s} {row['ratio']:6.3f} [{row['lowest']:.3f}, {row['highest']:.3f}]"
            f"  ({row['ours_us']:.1f} us against {row['peer_us']:.1f} us){aim}"
        )
    if arguments.json:
        partial = arguments.json.with_suffix(".partial")
        partial.write_text(json.dumps(results, indent=2) + "\n")
        partial.replace(arguments.json)


if __name__ == "__main__":
    main()
