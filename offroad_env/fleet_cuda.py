"""Fleets on a graphics processor: one thread a vehicle, all numbers stay on the device.

The physics is that of `offroad_env.fleet`, compiled for CUDA from the same functions; what is written here
moves numbers between the memory of a thread and that of the device. In double precision throughout.
"""

from __future__ import annotations

import importlib.util
import os
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import float64

from offroad_env.errors import InvalidParameter, OffroadError
from offroad_env.fleet import Fleet, FleetRun, count_steps
from offroad_env.physics import state as at
from offroad_env.physics.contact import SUNK
from offroad_env.physics.full_model import WORK_ROWS, full_continue, full_derivative
from offroad_env.physics.numerics import copy_into
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.simulator import FULL_STEP

try:
    from numba import cuda
except ImportError:  # a numba that has left its old target to numba-cuda, which is not installed
    cuda = None

__all__ = ["THREADS", "CudaFleet", "CudaUnavailableError", "make_kernels"]

#: Threads of a block. A thread takes all registers it may have, so that a multiprocessor holds eight such
#: blocks or four of twice the size; the smallest ones spread best, and wait for no others at their end.
THREADS = 32

# The size of an array in a thread's memory must be a number or tuple of this module.
_STATE, _READINGS, _WARM = at.STATE_SIZE, at.READINGS_SIZE, (2, at.CONTACT_SIZE)
_WORK = WORK_ROWS, _READINGS


class CudaUnavailableError(OffroadError, RuntimeError):
    """There is no graphics processor, or what drives it is not installed."""


@cache
def make_kernels(changed: bool) -> tuple[Any, Any]:
    """(start, drive) for `CudaFleet`; ``changed``: for plants with effects. Compiled at their first call.

    Both take the plants as (numbers (N, P), waves, patches) and, with effects, these; all but the numbers
    with a row in front that means nothing, for an array without rows has no address and cannot be passed.
    The vehicles are (states (N, 15), readings (N, 32), warm (N, 2, 3), slopes (N, 15), status (N,),
    done (N,)).
    """

    def bare_plant(plants, i):
        return unpack(PackedPlant(plants[0][i], plants[1][1:], plants[2][1:], None))

    def changed_plant(plants, i):
        return unpack(PackedPlant(plants[0][i], plants[1][1:], plants[2][1:], plants[3][1:]))

    plant_of = cuda.jit(device=True)(changed_plant if changed else bare_plant)

    @cuda.jit
    def start(plants, given, where, vehicles):
        """Vehicles with true ``where`` (N or 1,) begin at ``given`` = (states, warm), (N or 1, ...)."""
        i = cuda.grid(1)
        states, readings, warms, slopes, status, done = vehicles
        if i >= status.shape[0] or not where[i if where.shape[0] > 1 else 0]:
            return
        x, slope = cuda.local.array(_STATE, float64), cuda.local.array(_STATE, float64)
        warm, seen = cuda.local.array(_WARM, float64), cuda.local.array(_READINGS, float64)
        copy_into(x, given[0][i if given[0].shape[0] > 1 else 0])
        for axle in range(2):
            copy_into(warm[axle], given[1][i if given[1].shape[0] > 1 else 0, axle])
        # The readings of the start do not depend on the command; each interval goes on from the last.
        full_derivative(x, (0.0, 0.0, 0.0), plant_of(plants, i), warm, slope, seen)
        copy_into(states[i], x)
        copy_into(readings[i], seen)
        for axle in range(2):
            copy_into(warms[i, axle], warm[axle])
        copy_into(slopes[i], slope)
        status[i], done[i] = seen[at.STATUS], 0

    @cuda.jit
    def drive(plants, vehicles, commands, timing, kept):
        """All vehicles drive for ``commands`` (N or 1, K, 3), each held for ``timing`` = (dt [s], steps).

        ``kept`` = (states, readings), (K + 1, N, ...), takes every boundary, or nothing if it has one row.
        """
        i = cuda.grid(1)
        states, readings, warms, slopes, status, done = vehicles
        if i >= status.shape[0]:
            return
        # A thread's own memory lies so that neighbours read side by side.
        x, warm = cuda.local.array(_STATE, float64), cuda.local.array(_WARM, float64)
        work, seen = cuda.local.array(_WORK, float64), cuda.local.array(_READINGS, float64)
        copy_into(x, states[i])
        copy_into(seen, readings[i])
        for axle in range(2):
            copy_into(warm[axle], warms[i, axle])
        copy_into(work[0, :_STATE], slopes[i])
        plant, who = plant_of(plants, i), i if commands.shape[0] > 1 else 0
        boundaries, worst, count = kept[0].shape[0], status[i], 0
        if boundaries > 1:
            copy_into(kept[0][0, i], x)
            copy_into(kept[1][0, i], seen)
        while count < commands.shape[1] and worst < SUNK:
            command = commands[who, count, 0], commands[who, count, 1], commands[who, count, 2]
            worst = max(worst, full_continue(x, warm, command, plant, timing, work, seen))
            if worst < SUNK:
                count += 1
                if boundaries > 1:
                    copy_into(kept[0][count, i], x)
                    copy_into(kept[1][count, i], seen)
        if worst >= SUNK:
            for j in range(_STATE):
                x[j] = np.nan
            for j in range(_READINGS):
                seen[j] = np.nan
        for row in range(count + 1, boundaries):
            copy_into(kept[0][row, i], x)
            copy_into(kept[1][row, i], seen)
        copy_into(states[i], x)
        copy_into(readings[i], seen)
        for axle in range(2):
            copy_into(warms[i, axle], warm[axle])
        copy_into(slopes[i], work[0, :_STATE])
        status[i], done[i] = worst, count

    return start, drive


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
            "no CUDA device, or no driver for it, was found: `python -m numba -s` says what numba sees; "
            "offroad_env.fleet does the same on processors"
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
        array = np.ascontiguousarray(values, dtype=dtype)
        if not np.isfinite(array).all():
            raise InvalidParameter(f"{name} must be finite, got NaN or infinity")
        return cuda.to_device(array, stream=stream)
    array = cuda.as_cuda_array(values)
    if array.dtype != dtype or not array.is_c_contiguous():
        raise InvalidParameter(
            f"{name} on the device must be contiguous {np.dtype(dtype)}, got {array.dtype} with strides "
            f"{array.strides} (torch: .to(torch.{np.dtype(dtype)}).contiguous())"
        )
    return array


def _rows(name: str, array: Any, shape: tuple[int, ...]) -> Any:
    """``array`` as (N or 1, ...), for ``shape`` = (N, ...)."""
    if array.shape not in (shape, shape[1:]):
        raise InvalidParameter(f"{name} must be {shape} or {shape[1:]}, got shape {tuple(array.shape)}")
    return array.reshape(-1, *shape[1:])


class CudaFleet:
    """A fleet of the full model that lives on a graphics processor.

    Whatever is an array here lies on the device and offers ``__cuda_array_interface__``:
    ``torch.as_tensor(fleet.states, device="cuda")`` shares its memory. Arguments may be such arrays too,
    torch tensors among them (float64, contiguous), and are read in place; NumPy arrays are copied.

    Calls return before the device is done. Work goes to ``stream``: a handle, or what has
    ``__cuda_stream__`` (``torch.cuda.current_stream()``); by default to the default stream, which is that
    of torch and CuPy as long as they were not told otherwise.

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
        self._timing = float(dt), count_steps(fleet, interval, dt)
        _require_device()
        count, packed = len(fleet), fleet.packed
        queue = _as_stream(stream)
        parts = [packed.numbers] + [
            np.concatenate([np.zeros((1, part.shape[1])), part]) for part in packed[1:] if part is not None
        ]
        self._plants = tuple(cuda.to_device(part, stream=queue) for part in parts)
        self._start, self._drive = make_kernels(packed.effects is not None)
        self.numbers = self._plants[0]
        self.states = cuda.device_array((count, _STATE), np.float64)
        self.readings = cuda.device_array((count, _READINGS), np.float64)
        self.warm = cuda.device_array((count, *_WARM), np.float64)
        self.status = cuda.device_array(count, np.float64)
        self.done = cuda.device_array(count, np.int64)
        slopes = cuda.device_array((count, _STATE), np.float64)
        self._vehicles = (self.states, self.readings, self.warm, slopes, self.status, self.done)
        self.start(states, warm, stream=stream)

    def __len__(self) -> int:
        return self.status.shape[0]

    def start(self, states: Any, warm: Any, *, where: Any = None, stream: Any = None) -> None:
        """Begin anew: all vehicles, or those for which ``where`` (N,) bool is true.

        ``states`` and ``warm`` are as in the constructor; ``fleet.states``, changed in place, is allowed.
        """
        queue, count = _as_stream(stream), len(self)
        given = (
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
            kept = tuple(cuda.device_array((*rows, part.shape[2]), np.float64) for part in kept)
        self._advance(held, kept, queue)
        return FleetRun(states=kept[0], readings=kept[1], status=self.status, done=self.done)

    def _here(self) -> tuple[Any, Any]:
        """(states, readings) as a run of one row."""
        return self.states.reshape(1, *self.states.shape), self.readings.reshape(1, *self.readings.shape)

    def _advance(self, held: Any, kept: tuple[Any, Any], queue: Any) -> None:
        self._launch(self._drive, queue, self._plants, self._vehicles, held, self._timing, kept)

    def _launch(self, kernel: Callable, queue: Any, *arguments: Any) -> None:
        with warnings.catch_warnings():
            # A small fleet leaves a device idle; its owner knows that.
            warnings.filterwarnings("ignore", message="Grid size")
            configured = kernel[-(-len(self) // THREADS), THREADS, queue]
        configured(*arguments)
