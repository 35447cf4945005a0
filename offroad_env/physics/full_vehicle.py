"""Preset ``full``: wheel spin, slopes, drag, actuators; the default of the environment.

The equations of motion are in `full_dynamics` and `four_wheel_dynamics`, the method of integration in
`rosenbrock`.
"""

from __future__ import annotations

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel, merged_kernel
from offroad_env.physics.axle import Plant, readings_size
from offroad_env.physics.contact import NO_ROOT
from offroad_env.physics.equations import apply_command, full_derivative
from offroad_env.physics.four_wheel_geometry import wheel_row
from offroad_env.physics.numerics import all_finite, sin_cos
from offroad_env.physics.records import FloatArray, FourWheel, Structure, Vehicle
from offroad_env.physics.rosenbrock import WORK_ROWS, StepArrays, StepReuse, rosenbrock_step
from offroad_env.physics.ruts import Place, lay_track, prefill_track, track_spacing

__all__ = ["WORK_ROWS", "full_advance", "full_continue", "full_derivative", "full_step", "straight_track"]


@inline_kernel
def _leave_track(
    structure: Structure, vehicle: Vehicle, x: FloatArray, row: FloatArray, seen: FloatArray
) -> None:
    """Let a leading wheel note the rut that it leaves; ``seen`` is its part of the readings."""
    place = Place(seen[at.WHEEL_X], seen[at.WHEEL_Y], sin_cos(x[at.YAW]))
    lay_track(structure, row, place, seen[at.SINKAGE], track_spacing(vehicle.l_f + vehicle.l_r))


@inline_kernel
def _leave_tracks(
    four: FourWheel | None,
    structure: Structure,
    vehicle: Vehicle,
    x: FloatArray,
    warm: FloatArray,
    readings: FloatArray,
) -> None:
    if four is None:
        _leave_track(structure, vehicle, x, warm[0], readings)
    else:
        for wheel in range(2):
            _leave_track(structure, vehicle, x, warm[wheel], wheel_row(readings, wheel))


@inline_kernel
def leave_tracks(
    structure: Structure | None, plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray
) -> None:
    """Let the front wheels note the ruts that they leave at the state of ``readings``, for the rear ones."""
    if structure is None:
        return
    if structure.ruts > 0.5:
        _leave_tracks(plant.four_wheel, structure, plant.vehicle, x, warm, readings)


@kernel
def straight_track(plant: Plant, x: FloatArray, warm: FloatArray) -> float:
    """Lay the front wheels' track into ``warm`` as if they had come straight to the state ``x``.

    Returns the worst contact status. A plant without ruts keeps its ``warm``.
    """
    derivative, readings = np.empty(readings_size(plant)), np.empty(readings_size(plant))
    full_derivative(x, (0.0, 0.0, 0.0), plant, warm, derivative, readings)
    _lay_straight(plant.structure, plant, x, warm, readings)
    worst: float = readings[at.STATUS]
    return worst


@inline_kernel
def _lay_straight(
    structure: Structure | None, plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray
) -> None:
    """The tracks of the front wheels at the state of ``readings``, straight behind them."""
    if structure is None:
        return
    if structure.ruts > 0.5:
        _lay_all_straight(plant.four_wheel, structure, plant.vehicle, x, warm, readings)


@inline_kernel
def _lay_all_straight(
    four: FourWheel | None,
    structure: Structure,
    vehicle: Vehicle,
    x: FloatArray,
    warm: FloatArray,
    readings: FloatArray,
) -> None:
    spacing, heading = track_spacing(vehicle.l_f + vehicle.l_r), sin_cos(x[at.YAW])
    for wheel in range(1 if four is None else 2):
        seen = readings if four is None else wheel_row(readings, wheel)
        place = Place(seen[at.WHEEL_X], seen[at.WHEEL_Y], heading)
        prefill_track(structure, warm[wheel], place, seen[at.SINKAGE], spacing)


@merged_kernel
def full_step(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    dt: float,
    work: FloatArray,
    readings: FloatArray,
) -> float:
    """One step of ``dt`` [s], in place; returns the worst contact status.

    ``readings`` (N,) belong to the state before the step; ``work`` (WORK_ROWS, N), N = `readings_size`.
    """
    full_derivative(x, command, plant, warm, work[0], readings)
    arrays = StepArrays(work, readings, work[6])
    status = rosenbrock_step(x, warm, command, plant, dt, StepReuse(0.0, 0.0), arrays)
    leave_tracks(plant.structure, plant, x, warm, readings)
    worst: float = max(status, readings[at.STATUS])
    return worst


@merged_kernel
def full_continue(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, ...],
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
    apply_command(x, command, plant, warm, work[0], readings)
    arrays = StepArrays(work, readings, readings)
    for i in range(steps):
        reuse = StepReuse(float(i % 2), 1.0)
        worst = max(worst, rosenbrock_step(x, warm, command, plant, dt, reuse, arrays))
        if worst >= NO_ROOT or not all_finite(x):
            return NO_ROOT
        leave_tracks(plant.structure, plant, x, warm, readings)
    return worst


@merged_kernel
def full_advance(
    x: FloatArray,
    warm: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    dt: float,
    steps: int,
    readings: FloatArray,
) -> float:
    """``steps`` steps of ``dt`` under a held command, in place; returns the worst contact status.

    ``readings`` become those of the state reached, so a sensor sees no lag. Stops at a state that
    is not finite or has no contact solution, with status NO_ROOT.
    """
    work = np.empty((WORK_ROWS, readings_size(plant)))
    full_derivative(x, command, plant, warm, work[0], readings)
    return full_continue(x, warm, command, plant, (dt, steps), work, readings)
