"""A two-stage Rosenbrock W-method of order 2 for the full model.

Verwer, Spee, Blom & Hundsdorfer, SIAM J. Sci. Comput. 20 (1999), eq. 2.4: order 2 for any approximate
Jacobian, so it may hold nothing but the stiff directions, be the product of two factors, along and
across the wheels, and serve two steps. The spin rate constant reaches 1e4 1/s at walking pace, where an
explicit method needs steps of 0.2 ms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics import state as at
from offroad_env.physics._jit import kernel, merged_kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.equations import full_derivative, solve_stages, spin_change, stiffnesses
from offroad_env.physics.full_jacobian import Slope
from offroad_env.physics.records import FloatArray

__all__ = ["WORK_ROWS", "StepArrays", "StepReuse", "rosenbrock_step"]

#: L-stable choice of the two-stage Rosenbrock method.
_GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
#: Error of a rim speed, as a share of v_eps, above which a step is halved; the shortest part of a step.
_SPIN_ERROR, _SHORTEST = 0.2, 0.1
#: Rows of the scratch array ``work``: the slope, two stages, the state between them and its readings, the
#: Jacobian, and readings that nobody asks for.
WORK_ROWS = 7


class StepReuse(NamedTuple):
    """What a step shares with its neighbours, 0.0 or 1.0 (numba compiles each pair of bools)."""

    known: float  #: work[5] holds the Jacobian of the step before, which serves
    onward: float  #: work[0] and ``after`` take the slope and the readings of the state reached


class StepArrays(NamedTuple):
    """Arrays of a step."""

    work: FloatArray  #: (WORK_ROWS, `readings_size`) scratch
    seen: FloatArray  #: (`readings_size`,) readings of the state before
    after: FloatArray  #: (`readings_size`,) readings of the state reached; may be ``seen``


@merged_kernel
def _stages(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    dt: float,
    work: FloatArray,
) -> tuple[float, float]:
    """(status, spin error [m/s]) of a step of ``dt`` from the slope work[0]; stages into work[1], work[2]."""
    slope, k_1, k_2, stage, later, stiffness = work[0], work[1], work[2], work[3], work[4], work[5]
    size = x.shape[0]
    for i in range(size):
        k_1[i] = slope[i]
    solve_stages(plant, x, stiffness, _GAMMA * dt, k_1)
    for i in range(size):
        stage[i] = x[i] + dt * k_1[i]
    full_derivative(stage, command, plant, warm, k_2, later)
    for i in range(size):
        k_2[i] -= 2.0 * k_1[i]
    solve_stages(plant, x, stiffness, _GAMMA * dt, k_2)
    return later[at.STATUS], 0.5 * dt * plant.vehicle.r * spin_change(plant, k_1, k_2)


@kernel
def rosenbrock_step(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    dt: float,
    reuse: StepReuse,
    arrays: StepArrays,
) -> float:
    """A step of ``dt`` [s] from the slope work[0] at ``x``, in place; returns the worst contact status.

    Two stages, order 2, implicit in the wheels' slip. Where a wheel grips or locks within a step, the
    two stages disagree, and the step is taken in parts.
    """
    work, seen, after = arrays.work, arrays.seen, arrays.after
    known, onward = reuse.known, reuse.onward
    k_1, k_2 = work[1], work[2]
    part, left, worst = dt, dt, 0.0
    while True:
        if known < 0.5:
            stiffnesses(plant, x, warm, seen, Slope(work[0], part), work[5])
        while True:
            status, error = _stages(x, warm, command, plant, part, work)
            if not (error > _SPIN_ERROR * plant.v_eps and (known > 0.5 or part > _SHORTEST * dt)):
                break
            if known > 0.5:
                stiffnesses(plant, x, warm, seen, Slope(work[0], part), work[5])
                known = 0.0
            else:
                part *= 0.5
        worst = max(worst, status)
        for i in range(x.shape[0]):
            x[i] += part * (1.5 * k_1[i] + 0.5 * k_2[i])
        left -= part
        finished = left < 1e-9 * dt
        if onward > 0.5 or not finished:
            full_derivative(x, command, plant, warm, work[0], after)
            worst = max(worst, after[at.STATUS])
            seen = after
        if finished:
            return worst
