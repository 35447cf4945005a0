"""Many vehicles in one call: the steps of the models, vehicle by vehicle, without the way through Python.

Nothing of the physics is written here a second time. Every vehicle is a row of the arrays and
independent of the others, so a span of rows is a piece of work for a thread (kernels hold no lock),
and the result does not depend on how the rows are divided.
"""

from __future__ import annotations

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import readings_size
from offroad_env.physics.contact import NO_ROOT, SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.numerics import all_finite, copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.paper_vehicle import paper_derivative, paper_step
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray

__all__ = ["PLAIN_COMMAND", "WHEEL_COMMAND", "full_rows", "paper_rows"]


#: Rows of commands that a run takes, by their length: those of all vehicles, those with given wheels.
PLAIN_COMMAND, WHEEL_COMMAND = (0.0,) * 3, (0.0,) * 7


@inline_kernel
def _command_like(sort: tuple[float, ...], held: FloatArray) -> tuple[float, ...]:
    """A row of commands as the model takes it, as long as ``sort``."""
    if len(sort) > 3:
        return held[0], held[1], held[2], held[3], held[4], held[5], held[6]
    return held[0], held[1], held[2]


@kernel
def full_rows(
    fleet: PackedPlant,
    start: tuple[FloatArray, FloatArray],
    commands: FloatArray,
    timing: tuple[float, int],
    rows: tuple[int, int],
    found: tuple[FloatArray, FloatArray, FloatArray],
    sort: tuple[float, ...],
) -> None:
    """Full model: rows ``first`` ... ``last - 1`` of a fleet under held commands.

    Parameters
    ----------
    fleet : `PackedPlant` whose ``numbers`` are (N, P), a row for each vehicle
    start : (states (N, 15), warm (N, 2, 3)), advanced in place; sizes see `axle`
    commands : (N or 1, K, 3 or 7), see `equations.full_derivative`; one row serves all vehicles
    timing : (dt of a step [s], steps per command)
    rows : (first, last)
    found : (states (R, N, 15), readings (R, N, 32), outcome (N, 2)), filled. R = K + 1 keeps every
        command boundary, R = 1 the last one only. Outcome: worst contact status, commands carried
        out. A vehicle that sinks or diverges stops; what follows in its rows is left as it was.
    sort : `PLAIN_COMMAND` or `WHEEL_COMMAND`
    """
    states, warms = start
    kept, readings, outcome = found
    boundaries = kept.shape[0]
    for i in range(rows[0], rows[1]):
        plant = unpack(replace(fleet, numbers=fleet.numbers[i]))
        work, seen = np.empty((WORK_ROWS, readings_size(plant))), np.empty(readings_size(plant))
        held = commands[i if commands.shape[0] > 1 else 0]
        x, warm = states[i], warms[i]
        copy_into(kept[0, i], x)
        # The readings of the start do not depend on the command; each interval goes on from the last.
        full_derivative(x, sort, plant, warm, work[0], seen)
        copy_into(readings[0, i], seen)
        worst, done = seen[at.STATUS], 0
        while done < held.shape[0] and worst < SUNK:
            command = _command_like(sort, held[done])
            row = min(done + 1, boundaries - 1)
            worst = max(worst, full_continue(x, warm, command, plant, timing, work, seen))
            if worst < SUNK:
                copy_into(kept[row, i], x)
                copy_into(readings[row, i], seen)
                done += 1
        outcome[i, 0], outcome[i, 1] = worst, done


@kernel
def paper_rows(
    fleet: PackedPlant,
    start: tuple[FloatArray, FloatArray],
    inputs: FloatArray,
    dt: float,
    rows: tuple[int, int],
    found: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """`full_rows` for the paper's model: ``inputs`` (N or 1, 2 T + 1, 3) at every half step of ``dt`` [s]."""
    states, warms = start
    kept, readings, outcome = found
    boundaries = kept.shape[0]
    work = np.empty((3, at.STATE_SIZE))
    for i in range(rows[0], rows[1]):
        plant = unpack(replace(fleet, numbers=fleet.numbers[i]))
        given = inputs[i if inputs.shape[0] > 1 else 0]
        x, warm = states[i], warms[i]
        copy_into(kept[0, i], x)
        worst, done, steps = 0.0, 0, given.shape[0] // 2
        while done < steps and worst < SUNK:
            seen = readings[min(done, boundaries - 1), i]
            worst = max(worst, paper_step(x, warm, given[2 * done : 2 * done + 3], plant, dt, work, seen))
            if not all_finite(x):
                worst = NO_ROOT
            if worst < SUNK:
                done += 1
                copy_into(kept[min(done, boundaries - 1), i], x)
        if worst < SUNK:
            last, seen = given[2 * steps], readings[boundaries - 1, i]
            paper_derivative(x, (last[0], last[1], last[2]), plant, warm, work[0], seen)
            worst = max(worst, seen[at.STATUS])
        outcome[i, 0], outcome[i, 1] = worst, done
