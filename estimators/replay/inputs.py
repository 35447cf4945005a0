"""What the driver did, as the solver takes it: steering and torques over each step of a grid.

A log states with ``inputs.hold`` whether a value holds from its row to the next (zoh) or runs straight to the
next one (linear). Where rows are means over a block about their stamp, a value that is held comes half a row
late; straight lines through the rows do not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.window_simulation import actuator_states
from estimators.logs.log import Log
from offroad_env.errors import DataError
from offroad_env.physics.records import FloatArray

__all__ = ["InputRows", "input_rows"]


class InputRows(NamedTuple):
    """Inputs on a grid, a row for each of its steps; columns steer [rad], drive and brake torque [N m]."""

    begin: FloatArray  #: (K, 3) at the begin of each step
    end: FloatArray  #: (K, 3) at its end
    front_share: FloatArray  #: (K, 2) of the drive torque and of the brake torque
    actuators: FloatArray  #: (K + 1, 3) states of the actuators, on which nothing acts back


def input_rows(log: Log, t: np.ndarray, steps: int, hold: str | None = None) -> InputRows:
    """Inputs over the steps that begin at the instants ``t`` (K,) [s].

    Parameters
    ----------
    steps
        Of the solver in a step of the grid.
    hold : {"zoh", "linear"}, optional
        Default: as the log states.

    Raises
    ------
    DataError
        If the log has no steering, or no torque at the wheels.
    """
    axles = [name for name in ("torque_f", "torque_r") if name in log.channels]
    if not axles or "steer" not in log.channels:
        raise DataError(
            f"{log.name}: a replay needs the columns steer and torque_f or torque_r, "
            f"there are {', '.join(log.channels)}"
        )
    step, hold = float(t[1] - t[0]), log.config.hold if hold is None else hold
    zero = np.zeros(len(t))
    torques = [
        _ends(log, name, t, step, hold) if name in axles else (zero, zero)
        for name in ("torque_f", "torque_r")
    ]
    steer = _ends(log, "steer", t, step, hold)
    (front, front_end), (rear, rear_end) = torques
    begin, end = _columns(steer[0], front, rear), _columns(steer[1], front_end, rear_end)
    shares = _front_shares(log, 0.5 * (front + front_end), 0.5 * (rear + rear_end))
    middle = np.ascontiguousarray(0.5 * (begin + end))
    actuators = actuator_states(log.vehicle, middle, step / steps, steps)
    return InputRows(begin, end, shares, actuators)


def _columns(steer: np.ndarray, front: np.ndarray, rear: np.ndarray) -> np.ndarray:
    """(K, 3) steering, drive and brake torque; an axle drives or brakes."""
    drive, brake = (
        np.maximum(front, 0.0) + np.maximum(rear, 0.0),
        np.maximum(-front, 0.0) + np.maximum(-rear, 0.0),
    )
    return np.column_stack([steer, drive, brake])


def _front_shares(log: Log, front: np.ndarray, rear: np.ndarray) -> np.ndarray:
    """(K, 2) front share of drive and brake torque; the vehicle's where there is no torque."""
    shares = []
    for sign, known in ((1.0, log.vehicle.drive_front), (-1.0, log.vehicle.brake_front)):
        ahead, total = (
            np.maximum(sign * front, 0.0),
            np.maximum(sign * front, 0.0) + np.maximum(sign * rear, 0.0),
        )
        shares.append(np.where(total > 0.0, ahead / np.where(total > 0.0, total, 1.0), known))
    return np.column_stack(shares)


def _ends(log: Log, name: str, t: np.ndarray, step: float, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """A column at the begin and the end of every step."""
    times, values = log.samples(name)
    if hold == "linear":
        return np.interp(t, times, values), np.interp(t + step, times, values)
    # A stamp may be rounded: it belongs to the step that begins within a thousandth of it.
    rows = np.maximum(np.searchsorted(times, t + 1e-3 * step, side="right") - 1, 0)
    return values[rows], values[rows]
