"""Faults for which the library has no effect: a diagnosis must not name a cause for them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from estimators.discrepancy.faults.forces import Push, body_force
from offroad_env.physics import state as at
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.drive import Faults
from offroad_env.simulation.simulator import Plant

__all__ = ["UNMODELLED_FAULTS"]


def _vegetation(share: float) -> Faults:
    """Drag in a patch of vegetation between x = 40 and 70 m."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        inside = 0.5 * (math.tanh((x[at.X] - 40.0) / 2.0) - math.tanh((x[at.X] - 70.0) / 2.0))
        return -share * plant.vehicle.m * GRAVITY * inside, 0.0, 0.0

    return body_force(force)


def _tow_rope(share: float) -> Faults:
    """An elastic rope to a post: its pull grows along x."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        away = max(x[at.X] - 20.0, 0.0) / 50.0
        pull = -share * plant.vehicle.m * GRAVITY * away
        return pull * math.cos(x[at.YAW]), -pull * math.sin(x[at.YAW]), 0.0

    return body_force(force)


def _side_wind(share: float) -> Faults:
    """A side wind in gusts along x, acting behind the centre of gravity."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        push = share * plant.vehicle.m * GRAVITY * math.sin(0.17 * x[at.X]) ** 2
        return push * math.sin(x[at.YAW]), push * math.cos(x[at.YAW]), -0.5 * push * math.cos(x[at.YAW])

    return body_force(force)


def _engine_braking(share: float) -> Faults:
    """An engine that brakes while no drive torque is asked for."""

    def force(x: np.ndarray, plant: Plant) -> Push:
        idle = 1.0 - math.tanh(max(x[at.DRIVE], 0.0) / 600.0)
        return -share * plant.vehicle.m * GRAVITY * idle, 0.0, 0.0

    return body_force(force)


#: Fault -> how to make it, from its size as a share of the weight.
UNMODELLED_FAULTS: dict[str, Callable[[float], Faults]] = {
    "vegetation": _vegetation,
    "tow_rope": _tow_rope,
    "side_wind": _side_wind,
    "engine_braking": _engine_braking,
}
