"""Preset ``full``: wheel spin, slopes, drag, actuators; the default of the environment.

The equations of motion are in `full_dynamics`, the method of integration in `rosenbrock`.
"""

from __future__ import annotations

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import NO_ROOT
from offroad_env.physics.full_dynamics import actuators, full_derivative
from offroad_env.physics.numerics import all_finite, sin_cos
from offroad_env.physics.records import FloatArray, Structure, Vehicle
from offroad_env.physics.rosenbrock import WORK_ROWS, StepArrays, StepReuse, rosenbrock_step
from offroad_env.physics.ruts import Place, lay_track, prefill_track, track_spacing

__all__ = ["WORK_ROWS", "full_advance", "full_continue", "full_derivative", "full_step", "straight_track"]


@inline_kernel
def leave_tracks(
    structure: Structure | None, vehicle: Vehicle, x: FloatArray, warm: FloatArray, readings: FloatArray
) -> None:
    """Let the front wheels note the ruts that they leave at the state of ``readings``, for the rear ones."""
    if structure is None:
        return
    if structure.ruts > 0.5:
        place = Place(readings[at.WHEEL_X], readings[at.WHEEL_Y], sin_cos(x[at.YAW]))
        spacing = track_spacing(vehicle.l_f + vehicle.l_r)
        lay_track(structure, warm[0], place, readings[at.SINKAGE], spacing)


@kernel
def straight_track(plant: Plant, x: FloatArray, warm: FloatArray) -> float:
    """Lay the front wheels' track into ``warm`` as if they had come straight to the state ``x``.

    Returns the worst contact status. A plant without ruts keeps its ``warm``.
    """
    derivative, readings = np.empty(at.READINGS_SIZE), np.empty(at.READINGS_SIZE)
    full_derivative(x, (0.0, 0.0, 0.0), plant, warm, derivative, readings)
    _lay_straight(plant.structure, plant.vehicle, x, warm, readings)
    worst: float = readings[at.STATUS]
    return worst


@inline_kernel
def _lay_straight(
    structure: Structure | None, vehicle: Vehicle, x: FloatArray, warm: FloatArray, readings: FloatArray
) -> None:
    """The track of the front wheels at the state of ``readings``, straight behind them."""
    if structure is None:
        return
    if structure.ruts > 0.5:
        place = Place(readings[at.WHEEL_X], readings[at.WHEEL_Y], sin_cos(x[at.YAW]))
        spacing = track_spacing(vehicle.l_f + vehicle.l_r)
        prefill_track(structure, warm[0], place, readings[at.SINKAGE], spacing)


@merged_kernel
def full_step(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, float, float],
    plant: Plant,
    dt: float,
    work: FloatArray,
    readings: FloatArray,
) -> float:
    """One step of ``dt`` [s], in place; returns the worst contact status.

    ``readings`` (READINGS_SIZE,) belong to the state before the step. ``work`` (WORK_ROWS,
    READINGS_SIZE).
    """
    full_derivative(x, command, plant, warm, work[0], readings)
    arrays = StepArrays(work, readings, work[6])
    status = rosenbrock_step(x, warm, command, plant, dt, StepReuse(0.0, 0.0), arrays)
    leave_tracks(plant.structure, plant.vehicle, x, warm, readings)
    worst: float = max(status, readings[at.STATUS])
    return worst


@merged_kernel
def full_continue(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, float, float],
    plant: Plant,
    timing: tuple[float, int],
    work: FloatArray,
    readings: FloatArray,
) -> float:
    """`full_advance` from a state whose slope and readings are in ``work`` and ``readings`` already.

    As `full_advance` and this function leave them, under whatever command: that enters the slope
    through the actuators only. ``timing`` = (dt [s], steps). Every other step takes the Jacobian of
    the step before it.
    """
    dt, steps = timing
    worst: float = readings[at.STATUS]
    actuators(plant.vehicle, x, command, work[0])
    arrays = StepArrays(work, readings, readings)
    for i in range(steps):
        reuse = StepReuse(float(i % 2), 1.0)
        worst = max(worst, rosenbrock_step(x, warm, command, plant, dt, reuse, arrays))
        if worst >= NO_ROOT or not all_finite(x):
            return NO_ROOT
        leave_tracks(plant.structure, plant.vehicle, x, warm, readings)
    return worst


@merged_kernel
def full_advance(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, float, float],
    plant: Plant,
    dt: float,
    steps: int,
    readings: FloatArray,
) -> float:
    """``steps`` steps of ``dt`` under a held command, in place; returns the worst contact status.

    ``readings`` become those of the state reached, so a sensor sees no lag. Stops at a state that
    is not finite or has no contact solution, with status NO_ROOT.
    """
    work = np.empty((WORK_ROWS, at.READINGS_SIZE))
    full_derivative(x, command, plant, warm, work[0], readings)
    return full_continue(x, warm, command, plant, (dt, steps), work, readings)
