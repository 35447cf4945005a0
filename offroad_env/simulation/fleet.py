"""Fleets: many vehicles, each with parameters, start and inputs of its own, in one call.

One engine for predictions: control by sampling, sigma points, particles, parameter studies. A fleet shares
the ground and the soil map; every number of vehicle and soil may differ from row to row. The physics is that
of `offroad_env.simulation.simulator`, the results are the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics import state as at
from offroad_env.physics.axle import contact_shape
from offroad_env.physics.batch import PLAIN_COMMAND, WHEEL_COMMAND, full_rows, paper_rows
from offroad_env.physics.packing import PackedPlant, pack
from offroad_env.physics.records import FourWheel, Soil, SoilField, Vehicle
from offroad_env.simulation.simulator import FULL_STEP, Plant, plant_model

__all__ = [
    "Fleet",
    "FleetRun",
    "count_steps",
    "make_fleet",
    "simulate_fleet",
    "simulate_fleet_commands",
    "vary",
]

_COLUMNS = {name: i for i, name in enumerate((*Vehicle._fields, *Soil._fields))}


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """N plants of one model on one ground; made by `make_fleet` or `vary`."""

    packed: PackedPlant  #: ``numbers`` (N, P): a row for each plant
    model: str  #: "full" or "paper"

    def __len__(self) -> int:
        return len(self.packed.numbers)

    @property
    def contact_shape(self) -> tuple[int, int, int]:
        """Shape of the contact states, (N, wheels, numbers)."""
        return len(self), *contact_shape(self.packed.structure, self.packed.four_wheel)


@dataclass(frozen=True, kw_only=True)
class FleetRun:
    """A run of a fleet. R = K + 1 rows of time, or 1 (the end) where only that was asked for.

    A vehicle that sinks or diverges stops: ``done`` holds the interval, and its later rows are NaN.
    """

    states: np.ndarray  #: (R, N, 15) vehicle states
    readings: np.ndarray  #: (R, N, 32) wheel forces, loads, sinkages, accelerations
    status: np.ndarray  #: (N,) worst contact status; from 2 on the vehicle did not come to the end
    done: np.ndarray  #: (N,) intervals that the vehicle carried out


def _same(one: np.ndarray | FourWheel | None, other: np.ndarray | FourWheel | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other)


def _same_field(one: SoilField | None, other: SoilField | None) -> bool:
    if one is None or other is None:
        return one is other
    same = _same(one.patches, other.patches) and _same(one.waves, other.waves)
    return one.edge == other.edge and same


def make_fleet(plants: Sequence[Plant]) -> Fleet:
    """Plants that share model, ground, soil map, soil field, effects and four-wheel fields, as a fleet.

    Raises
    ------
    InvalidParameter
        When there is none, or when they differ in one of these.
    """
    if not plants:
        raise InvalidParameter("a fleet needs at least one plant")
    packed = [pack(plant) for plant in plants]
    first = packed[0]
    for other in packed[1:]:
        if not (np.array_equal(other.waves, first.waves) and np.array_equal(other.patches, first.patches)):
            raise InvalidParameter("the plants of a fleet must share ground waves and soil map")
        if not _same(other.effects, first.effects):
            raise InvalidParameter("the plants of a fleet must share their effects")
        if not _same(other.four_wheel, first.four_wheel):
            raise InvalidParameter("the plants of a fleet must share vehicle model and four-wheel fields")
        if other.structure != first.structure:
            raise InvalidParameter("the plants of a fleet must share their structure")
        if not _same_field(other.soil_field, first.soil_field):
            raise InvalidParameter("the plants of a fleet must share their soil field")
    models = {plant_model(plant) for plant in plants}
    if len(models) > 1:
        raise InvalidParameter("the plants of a fleet must be all full or all paper")
    numbers = np.stack([one.numbers for one in packed])
    return Fleet(packed=first._replace(numbers=numbers), model=models.pop())


def vary(plant: Plant, columns: Mapping[str, np.ndarray]) -> Fleet:
    """Copies of one plant in which the named fields of its vehicle and soil differ.

    Parameters
    ----------
    columns : mapping of field name to (N,) values
        For example ``{"n": exponents, "m": masses}``; names and units of `records.Soil` and
        `records.Vehicle`. The values are trusted as the kernels trust their records: draw them from
        ranges that `make_soil` and `make_vehicle` accept.

    Raises
    ------
    InvalidParameter
        When there is no column, a name is unknown, or lengths differ or values are not finite.
    """
    if not columns:
        raise InvalidParameter("vary needs at least one column")
    unknown = set(columns) - set(_COLUMNS)
    if unknown:
        raise InvalidParameter(f"unknown fields: {', '.join(sorted(unknown))}")
    values = {name: np.asarray(column, dtype=np.float64) for name, column in columns.items()}
    shapes = {column.shape for column in values.values()}
    if len(shapes) > 1 or len(next(iter(shapes))) != 1:
        raise InvalidParameter(f"columns must be (N,) with one N, got shapes {sorted(shapes)}")
    if not all(np.isfinite(column).all() for column in values.values()):
        raise InvalidParameter("columns must be finite, got NaN or infinity")
    packed = pack(plant)
    numbers = np.tile(packed.numbers, (next(iter(shapes))[0], 1))
    for name, column in values.items():
        numbers[:, _COLUMNS[name]] = column
    return Fleet(packed=packed._replace(numbers=numbers), model=plant_model(plant))


def _rows(name: str, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A copy of ``values`` with a row for each vehicle; one row of that shape serves all."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape == shape[1:]:
        array = np.broadcast_to(array, shape)
    if array.shape != shape:
        raise InvalidParameter(f"{name} must be {shape} or {shape[1:]}, got shape {array.shape}")
    return np.array(array, order="C")


def _inputs(name: str, values: np.ndarray, count: int, widths: tuple[int, ...] = (3,)) -> np.ndarray:
    """Inputs as (N or 1, K, one of ``widths``)."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim == 2:
        array = array[None]
    shape = array.shape
    if array.ndim != 3 or shape[0] not in (1, count) or shape[1] < 1 or shape[2] not in widths:
        raise InvalidParameter(f"{name} must be (K, 3) or ({count}, K, 3), got shape {np.shape(values)}")
    return array


def _in_threads(work: Callable[[tuple[int, int]], None], count: int, threads: int) -> None:
    """Call ``work`` with spans of ``range(count)``; several a thread, for vehicles that stop early."""
    if threads < 1:
        raise InvalidParameter(f"threads must be at least 1, got {threads}")
    threads = min(threads, count)
    if threads == 1:
        work((0, count))
        return
    edges = np.linspace(0, count, min(4 * threads, count) + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda i: work((int(edges[i]), int(edges[i + 1]))), range(len(edges) - 1)))


def _found(
    count: int, rows: int, sizes: tuple[int, int] = (at.STATE_SIZE, at.READINGS_SIZE)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    state, readings = sizes
    return (
        np.full((rows, count, state), np.nan),
        np.full((rows, count, readings), np.nan),
        np.zeros((count, 2)),
    )


def _as_run(found: tuple[np.ndarray, np.ndarray, np.ndarray], intervals: int) -> FleetRun:
    states, readings, outcome = found
    done = outcome[:, 1].astype(int)
    if len(states) == 1:
        states[0, done < intervals] = readings[0, done < intervals] = np.nan
    else:
        for i in np.flatnonzero(done < intervals):
            states[done[i] + 1 :, i] = readings[done[i] + 1 :, i] = np.nan
    return FleetRun(states=states, readings=readings, status=outcome[:, 0], done=done)


def count_steps(fleet: Fleet, interval: float, dt: float) -> int:
    """Steps of ``dt`` for which a fleet of the full model holds a command."""
    if fleet.model != "full":
        raise InvalidParameter("commands drive the full model; this fleet is of the paper's")
    steps = round(interval / dt)
    if steps < 1 or abs(steps * dt - interval) > 1e-9 * interval:
        raise InvalidParameter(f"interval must be a multiple of dt = {dt:g} s, got {interval:g} s")
    return steps


def simulate_fleet_commands(
    fleet: Fleet,
    states: np.ndarray,
    warm: np.ndarray,
    commands: np.ndarray,
    *,
    interval: float = 0.02,
    dt: float = FULL_STEP,
    every: bool = True,
    threads: int | None = None,
) -> FleetRun:
    """`simulate_commands` for every vehicle of a fleet (full model).

    Parameters
    ----------
    states, warm : (N, 15) and (N, 2, 3), or (15,) and (2, 3) for all; with four wheels (19,); warm as
        `Fleet.contact_shape`
    commands : (N, K, 3), or (K, 3) for all
        Steering angle [rad], drive torque [N m], brake torque [N m], each held for ``interval`` [s]; with
        four wheels four more columns may follow, see `simulate_commands`.
    every : bool
        Keep every command boundary, or the end only.
    threads : int, optional
        Threads at work; by default one for each core that the process may use.
    """
    count, steps = len(fleet), count_steps(fleet, interval, dt)
    four = fleet.packed.four_wheel is not None
    held = _inputs("commands", commands, count, (3, 7) if four else (3,))
    if not np.isfinite(held).all():
        raise InvalidParameter("commands must be finite, got NaN or infinity")
    sizes = at.sizes(fleet.packed.four_wheel)
    start = _rows("states", states, (count, sizes[0])), _rows("warm", warm, fleet.contact_shape)
    found = _found(count, held.shape[1] + 1 if every else 1, sizes)
    timing = float(dt), steps
    sort = PLAIN_COMMAND if held.shape[2] == 3 else WHEEL_COMMAND

    def work(rows: tuple[int, int]) -> None:
        full_rows(fleet.packed, start, held, timing, rows, found, sort)

    _in_threads(work, count, threads or len(os.sched_getaffinity(0)))
    return _as_run(found, held.shape[1])


def simulate_fleet(
    fleet: Fleet,
    states: np.ndarray,
    warm: np.ndarray,
    inputs: np.ndarray,
    *,
    dt: float = 0.01,
    every: bool = True,
    threads: int | None = None,
) -> FleetRun:
    """`simulate` for every vehicle of a fleet (the paper's model), by RK4.

    Parameters
    ----------
    states, warm, every, threads : see `simulate_fleet_commands`
    inputs : (N, 2 T + 1, 3), or (2 T + 1, 3) for all
        Steering angle [rad], body force F_u [N] and dv_x/dt [m/s^2] (NaN: from the force balance) at
        every half step.
    dt : float
        Step [s].
    """
    if fleet.model != "paper":
        raise InvalidParameter("inputs drive the paper's model; this fleet is of the full one")
    count = len(fleet)
    given = _inputs("inputs", inputs, count)
    if given.shape[1] % 2 == 0:
        raise InvalidParameter(f"inputs must hold 2 T + 1 rows, one for each half step, got {given.shape[1]}")
    intervals = given.shape[1] // 2
    start = _rows("states", states, (count, at.STATE_SIZE)), _rows("warm", warm, fleet.contact_shape)
    found = _found(count, intervals + 1 if every else 1)

    def work(rows: tuple[int, int]) -> None:
        paper_rows(fleet.packed, start, given, float(dt), rows, found)

    _in_threads(work, count, threads or len(os.sched_getaffinity(0)))
    return _as_run(found, intervals)
