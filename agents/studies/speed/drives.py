"""Steps of vehicles by structure: the same drive for all, at a speed that a driver holds.

Otherwise a vehicle that rolls less easily would be measured at another speed, or at rest.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel
from offroad_env.physics.axle import Plant, readings_size
from offroad_env.physics.contact import NO_ROOT
from offroad_env.physics.full_vehicle import full_advance
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import make_plant, settled_state
from offroad_env.world.soils import SOILS
from offroad_env.world.terrain import rough_terrain
from offroad_env.world.vehicles import VEHICLES

__all__ = ["DRIVES", "structured_drive"]

#: Side -> options of `make_plant`.
DRIVES: dict[str, dict[str, Any]] = {
    "half-car, full": {},
    "half-car, grid": {"structure": "grid"},
    "half-car, grid, tyre": {"structure": "grid", "tyre": "mrzr"},
    "four wheels, full": {"vehicle_model": "four_wheel"},
    "four wheels, grid": {"vehicle_model": "four_wheel", "structure": "grid"},
}
#: Steps of 0.005 s under one command, and after how many commands a drive begins anew.
_HELD, _COMMANDS = 4, 250


@kernel
def _drive(plant: Plant, x: FloatArray, warm: FloatArray, commands: int) -> float:
    """Weave at 5 m/s for so many commands; returns the worst contact status."""
    readings, worst = np.empty(readings_size(plant)), 0.0
    for i in range(commands):
        torque = min(max(3000.0 * (5.0 - x[at.V_X]) + 300.0, -500.0), 2500.0)
        command = (0.1 * sin_cos(0.05 * i)[0], torque, 0.0)
        worst = max(worst, full_advance(x, warm, command, plant, 0.005, _HELD, readings))
    return worst


def structured_drive(**options: Any) -> Callable[[int], tuple[float, float]]:
    """CPU time and clock per step [s] of the MRZR that weaves over sand of ISO class C, as a side of a study.

    ``options``: of `make_plant`.
    """
    ground = rough_terrain("C", np.random.default_rng(1))
    plant = make_plant(VEHICLES["mrzr"], SOILS["dry_sand"], ground, **options)
    state, warm = settled_state(plant, v_x=5.0)

    def run(steps: int) -> tuple[float, float]:
        spent, done = np.zeros(2), 0
        while done < steps:
            commands = min(_COMMANDS, -(-(steps - done) // _HELD))
            x, rows = state.copy(), warm.copy()
            start = np.array([time.process_time(), time.perf_counter()])
            if _drive(plant, x, rows, commands) >= NO_ROOT:
                raise RuntimeError(f"the drive with {options} found no contact")
            spent += (time.process_time(), time.perf_counter()) - start
            done += commands * _HELD
        return tuple((spent / done).tolist())

    return run
