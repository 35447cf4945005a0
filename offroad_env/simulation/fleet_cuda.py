"""Fleets on a graphics processor: one thread a vehicle, all numbers stay on the device.

The physics is that of `offroad_env.simulation.fleet`, compiled for CUDA from the same functions; what is
written here moves numbers between the memory of a thread and that of the device. In double precision
throughout.
"""

from __future__ import annotations

import importlib.util
import os
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import float64

from offroad_env.errors import InvalidParameter, OffroadError
from offroad_env.physics import state as at
from offroad_env.physics.axle import Plant
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_vehicle import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.simulation.fleet import Fleet, FleetRun, count_steps
from offroad_env.simulation.simulator import FULL_STEP

try:
    from numba import cuda as _cuda
except ImportError:  # a numba that has left its old target to numba-cuda, which is not installed
    _cuda = None
cuda: Any = _cuda  # numba has no types

__all__ = ["THREADS", "CudaFleet", "CudaUnavailableError", "make_kernels"]

#: Threads of a block. A thread takes all registers it may have, so that a multiprocessor holds eight such
#: blocks or four of twice the size; the smallest ones spread best, and wait for no others at their end.
THREADS = 32

# The size of an array in a thread's memory must be a number or tuple of this module.
_STATE, _READINGS, _WARM = at.STATE_SIZE, at.READINGS_SIZE, (2, at.CONTACT_SIZE)
_WORK = WORK_ROWS, _READINGS


class CudaUnavailableError(OffroadError, RuntimeError):
    """There is no graphics processor, or what drives it is not installed."""


# All arrays of these records lie on the device. All of a plant but its numbers have a row in front that means
# nothing: an array without rows has no address and cannot be passed.


class Plants(NamedTuple):
    """The plants of a fleet without effects."""

    numbers: Any  #: (N, P)
    waves: Any  #: (1 + W, 4)
    patches: Any  #: (1 + S, 4)


class ChangedPlants(NamedTuple):
    """The plants of a fleet with effects."""

    numbers: Any  #: (N, P)
    waves: Any  #: (1 + W, 4)
    patches: Any  #: (1 + S, 4)
    effects: Any  #: (1 + E, ...) rows of `physics.hooks`


class Start(NamedTuple):
    """Where vehicles begin; one row serves all."""

    states: Any  #: (N or 1, 15)
    warm: Any  #: (N or 1, 2, 3)


class Vehicles(NamedTuple):
    """The vehicles of a fleet after the last call."""

    states: Any  #: (N, 15)
    readings: Any  #: (N, 32)
    warm: Any  #: (N, 2, 3)
    slopes: Any  #: (N, 15) time derivatives of the states
    status: Any  #: (N,) worst contact status
    done: Any  #: (N,) intervals carried out


class Kept(NamedTuple):
    """What is kept of a run: R = K + 1 boundaries, or one row that is the end."""

    states: Any  #: (R, N, 15)
    readings: Any  #: (R, N, 32)


def _bare_plant(plants: Plants, i: int) -> Plant:
    return unpack(
        PackedPlant(plants.numbers[i], plants.waves[1:], plants.patches[1:], None, None, None, None)
    )


def _changed_plant(plants: ChangedPlants, i: int) -> Plant:
    effects = plants.effects[1:]
    return unpack(
        PackedPlant(plants.numbers[i], plants.waves[1:], plants.patches[1:], effects, None, None, None)
    )


@cache
def make_kernels(changed: bool) -> tuple[Any, Any]:
    """(start, drive) for `CudaFleet`; ``changed``: for plants with effects. Compiled at their first call."""
    plant_of = cuda.jit(device=True)(_changed_plant if changed else _bare_plant)
    return _start_kernel(plant_of), _drive_kernel(plant_of)


def _start_kernel(plant_of: Callable[[Any, int], Plant]) -> Any:
    def start(plants: Plants | ChangedPlants, given: Start, where: Any, vehicles: Vehicles) -> None:
        """Vehicles with true ``where`` (N or 1,) begin at ``given``."""
        i = cuda.grid(1)
        if i >= vehicles.status.shape[0] or not where[i if where.shape[0] > 1 else 0]:
            return
        x, slope = cuda.local.array(_STATE, float64), cuda.local.array(_STATE, float64)
        warm, seen = cuda.local.array(_WARM, float64), cuda.local.array(_READINGS, float64)
        copy_into(x, given.states[i if given.states.shape[0] > 1 else 0])
        for axle in range(2):
            copy_into(warm[axle], given.warm[i if given.warm.shape[0] > 1 else 0, axle])
        # The readings of the start do not depend on the command; each interval goes on from the last.
        full_derivative(x, (0.0, 0.0, 0.0), plant_of(plants, i), warm, slope, seen)
        copy_into(vehicles.states[i], x)
        copy_into(vehicles.readings[i], seen)
        for axle in range(2):
            copy_into(vehicles.warm[i, axle], warm[axle])
        copy_into(vehicles.slopes[i], slope)
        vehicles.status[i], vehicles.done[i] = seen[at.STATUS], 0

    return cuda.jit(start)


def _drive_kernel(plant_of: Callable[[Any, int], Plant]) -> Any:
    def drive(
        plants: Plants | ChangedPlants,
        vehicles: Vehicles,
        commands: Any,
        timing: tuple[float, int],
        kept: Kept,
    ) -> None:
        """All vehicles drive for ``commands`` (N or 1, K, 3), each held for ``timing`` = (dt [s], steps)."""
        i = cuda.grid(1)
        if i >= vehicles.status.shape[0]:
            return
        # A thread's own memory lies so that neighbours read side by side.
        x, warm = cuda.local.array(_STATE, float64), cuda.local.array(_WARM, float64)
        work, seen = cuda.local.array(_WORK, float64), cuda.local.array(_READINGS, float64)
        copy_into(x, vehicles.states[i])
        copy_into(seen, vehicles.readings[i])
        for axle in range(2):
            copy_into(warm[axle], vehicles.warm[i, axle])
        copy_into(work[0, :_STATE], vehicles.slopes[i])
        plant, given = plant_of(plants, i), i if commands.shape[0] > 1 else 0
        boundaries, worst, count = kept.states.shape[0], vehicles.status[i], 0
        if boundaries > 1:
            copy_into(kept.states[0, i], x)
            copy_into(kept.readings[0, i], seen)
        while count < commands.shape[1] and worst < SUNK:
            command = commands[given, count, 0], commands[given, count, 1], commands[given, count, 2]
            worst = max(worst, full_continue(x, warm, command, plant, timing, work, seen))
            if worst < SUNK:
                count += 1
                if boundaries > 1:
                    copy_into(kept.states[count, i], x)
                    copy_into(kept.readings[count, i], seen)
        if worst >= SUNK:
            for j in range(_STATE):
                x[j] = np.nan
            for j in range(_READINGS):
                seen[j] = np.nan
        for row in range(count + 1, boundaries):
            copy_into(kept.states[row, i], x)
            copy_into(kept.readings[row, i], seen)
        copy_into(vehicles.states[i], x)
        copy_into(vehicles.readings[i], seen)
        for axle in range(2):
            copy_into(vehicles.warm[i, axle], warm[axle])
        copy_into(vehicles.slopes[i], work[0, :_STATE])
        vehicles.status[i], vehicles.done[i] = worst, count

    return cuda.jit(drive)


def _require_device() -> None:
    """Refuse to go on where nothing can run; numba's simulator needs no device."""
    if os.environ.get("NUMBA_ENABLE_CUDASIM", "0") != "0":
        return
    if importlib.util.find_spec("numba_cuda") is None:
        raise CudaUnavailableError(
            'fleets on a graphics processor need numba-cuda: pip install "offroad-bekker[cuda]"'
        )
    if not cuda.is_available():
        raise CudaUnavailableError(
            "no CUDA device, or no driver for it, was found: `python -m numba -s` lists what numba sees; "
            "offroad_env.simulation.fleet does the same on processors"
        )


def _as_stream(stream: Any) -> Any:
    """A stream as numba takes it; 0 is the default stream, that of torch and CuPy too."""
    if stream is None:
        return 0
    handle = stream if isinstance(stream, int) else stream.__cuda_stream__()[1]
    return cuda.external_stream(int(handle)) if handle else 0


def _on_device(name: str, values: Any, dtype: type, stream: Any) -> Any:
    """``values`` as an array of the device: as they are if they lie there, else a copy."""
    if not hasattr(values, "__cuda_array_interface__"):
        array: np.ndarray = np.ascontiguousarray(values, dtype=dtype)
        if not np.isfinite(array).all():
            raise InvalidParameter(f"{name} must be finite, got NaN or infinity")
        return cuda.to_device(array, stream=stream)
    there = cuda.as_cuda_array(values)
    if there.dtype != dtype or not there.is_c_contiguous():
        raise InvalidParameter(
            f"{name} on the device must be contiguous {np.dtype(dtype)}, got {there.dtype} with strides "
            f"{there.strides} (torch: .to(torch.{np.dtype(dtype)}).contiguous())"
        )
    return there


def _rows(name: str, array: Any, shape: tuple[int, ...]) -> Any:
    """``array`` as (N or 1, ...), for ``shape`` = (N, ...)."""
    if array.shape not in (shape, shape[1:]):
        raise InvalidParameter(f"{name} must be {shape} or {shape[1:]}, got shape {tuple(array.shape)}")
    return array.reshape(-1, *shape[1:])


def _require_plain(packed: PackedPlant) -> None:
    """Refuse what the device's kernels do not have: they hold a half-car or bicycle on rigid rims.

    Raises
    ------
    InvalidParameter
        With the name of the argument of `make_plant`.
    """
    structure = packed.structure
    refused = {
        "vehicle_model='four_wheel'": packed.four_wheel is not None,
        "tyre": structure is not None and structure.tyre is not None,
        "structure": structure is not None,
        "soil_field": packed.soil_field is not None,
    }
    names = [name for name, present in refused.items() if present]
    if names:
        raise InvalidParameter(
            f"fleets on a graphics processor have no {' or '.join(names)}: offroad_env.simulation.fleet has"
        )


class CudaFleet:
    """A fleet of the full model that lives on a graphics processor.

    Whatever is an array here lies on the device and offers ``__cuda_array_interface__``:
    ``torch.as_tensor(fleet.states, device="cuda")`` shares its memory. Arguments may be such arrays too,
    torch tensors among them (float64, contiguous), and are read in place; NumPy arrays are copied.

    Calls return before the device is done. Work goes to ``stream``: a handle, or what has
    ``__cuda_stream__`` (``torch.cuda.current_stream()``); by default to the default stream, which is that
    of torch and CuPy unless they were set to another.

    Parameters
    ----------
    fleet : Fleet
        From `make_fleet` or `vary`; of the full model.
    states, warm : (N, 15) and (N, 2, 3), or (15,) and (2, 3) for all
        Where the vehicles begin, see `settled_state`.
    interval, dt : float
        How long a command is held, and a step of the integrator [s].

    Attributes
    ----------
    states, readings, warm : (N, 15), (N, 32), (N, 2, 3)
        As after the last call; NaN for a vehicle that has sunk or diverged.
    status : (N,) float
        Worst contact status since the start; from 2 on the vehicle has stopped.
    done : (N,) int
        Intervals that a vehicle carried out in the last call.
    numbers : (N, P)
        Parameters of vehicle and soil; may be changed on the device before `start`.

    Raises
    ------
    CudaUnavailableError
        Without numba-cuda or a device.
    InvalidParameter
        As `simulate_fleet_commands`. Commands that lie on the device already are not looked at: a vehicle
        whose command is not finite stops.
    """

    def __init__(
        self,
        fleet: Fleet,
        states: Any,
        warm: Any,
        *,
        interval: float = 0.02,
        dt: float = FULL_STEP,
        stream: Any = None,
    ) -> None:
        _require_plain(fleet.packed)
        self._timing = float(dt), count_steps(fleet, interval, dt)
        _require_device()
        count, packed = len(fleet), fleet.packed
        queue = _as_stream(stream)
        tables = [table for table in (packed.waves, packed.patches, packed.effects) if table is not None]
        rows = [np.concatenate([np.zeros((1, table.shape[1])), table]) for table in tables]
        parts = [cuda.to_device(part, stream=queue) for part in (packed.numbers, *rows)]
        self._plants = Plants(*parts) if packed.effects is None else ChangedPlants(*parts)
        self._start, self._drive = make_kernels(packed.effects is not None)
        self.numbers = self._plants.numbers
        self.states = cuda.device_array((count, _STATE), np.float64)
        self.readings = cuda.device_array((count, _READINGS), np.float64)
        self.warm = cuda.device_array((count, *_WARM), np.float64)
        self.status = cuda.device_array(count, np.float64)
        self.done = cuda.device_array(count, np.int64)
        slopes = cuda.device_array((count, _STATE), np.float64)
        self._vehicles = Vehicles(self.states, self.readings, self.warm, slopes, self.status, self.done)
        self.start(states, warm, stream=stream)

    def __len__(self) -> int:
        return int(self.status.shape[0])

    def start(self, states: Any, warm: Any, *, where: Any = None, stream: Any = None) -> None:
        """Begin anew: all vehicles, or those for which ``where`` (N,) bool is true.

        ``states`` and ``warm`` are as in the constructor; ``fleet.states``, changed in place, is allowed.
        """
        queue, count = _as_stream(stream), len(self)
        given = Start(
            _rows("states", _on_device("states", states, np.float64, queue), (count, _STATE)),
            _rows("warm", _on_device("warm", warm, np.float64, queue), (count, *_WARM)),
        )
        chosen = _on_device("where", [True] if where is None else where, np.bool_, queue)
        if where is not None and chosen.shape != (count,):
            raise InvalidParameter(f"where must be ({count},), got shape {tuple(chosen.shape)}")
        self._launch(self._start, queue, self._plants, given, chosen, self._vehicles)

    def step(self, commands: Any, *, stream: Any = None) -> None:
        """One interval.

        Parameters
        ----------
        commands : (N, 3), or (3,) for all
            Steering angle [rad], drive torque [N m], brake torque [N m].
        """
        queue = _as_stream(stream)
        held = _rows("commands", _on_device("commands", commands, np.float64, queue), (len(self), 3))
        self._advance(held.reshape(held.shape[0], 1, 3), self._here(), queue)

    def run(self, commands: Any, *, every: bool = True, stream: Any = None) -> FleetRun:
        """Several intervals in one call, from where the vehicles are; returns arrays of the device.

        ``status`` and ``done`` are those of this object, which the next call overwrites.

        Parameters
        ----------
        commands : (N, K, 3), or (K, 3) for all
        every : bool
            Keep every boundary; else the run shares its only row with `states` and `readings`.
        """
        queue, count = _as_stream(stream), len(self)
        held = _on_device("commands", commands, np.float64, queue)
        shape = tuple(held.shape)
        if len(shape) not in (2, 3) or shape[-2] < 1:
            raise InvalidParameter(f"commands must be (K, 3) or ({count}, K, 3), got shape {shape}")
        held = _rows("commands", held, (count, shape[-2], 3))
        kept = self._here()
        if every:
            rows = held.shape[1] + 1, count
            kept = Kept(*(cuda.device_array((*rows, part.shape[2]), np.float64) for part in kept))
        self._advance(held, kept, queue)
        return FleetRun(states=kept.states, readings=kept.readings, status=self.status, done=self.done)

    def _here(self) -> Kept:
        """States and readings as a run of one row."""
        states, readings = self.states, self.readings
        return Kept(states.reshape(1, *states.shape), readings.reshape(1, *readings.shape))

    def _advance(self, held: Any, kept: Kept, queue: Any) -> None:
        self._launch(self._drive, queue, self._plants, self._vehicles, held, self._timing, kept)

    def _launch(self, kernel: Any, queue: Any, *arguments: Any) -> None:
        with warnings.catch_warnings():
            # numba warns of grids that leave most of a device idle; small fleets are meant to run.
            warnings.filterwarnings("ignore", message="Grid size")
            configured = kernel[-(-len(self) // THREADS), THREADS, queue]
        configured(*arguments)
