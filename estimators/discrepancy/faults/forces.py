"""Forces that a fault adds from outside, as kicks on the state."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from offroad_env.physics import state as at
from offroad_env.simulation.drive import Faults
from offroad_env.simulation.simulator import Plant

__all__ = ["Push", "body_force", "wheel_forces"]

#: Forward and left force [N], and a moment or torque [N m].
Push = tuple[float, float, float]


def body_force(force: Callable[[np.ndarray, Plant], Push]) -> Faults:
    """A force on the body: forward, left [N] and yaw moment [N m], from state and plant."""

    def kick(x: np.ndarray, readings: np.ndarray, plant: Plant, span: float) -> None:
        F_x, F_y, M_z = force(x, plant)
        m, I_z = plant.vehicle.m, plant.vehicle.I_z
        x[at.V_X] += F_x / m * span
        x[at.V_Y] += F_y / m * span
        x[at.YAW_RATE] += M_z / I_z * span

    return Faults(kick=kick)


def wheel_forces(force: Callable[[np.ndarray, Plant], Push]) -> Faults:
    """Forces along and across the wheels of each axle [N], and the torque that balances them [N m]."""

    def pushes(x: np.ndarray, readings: np.ndarray, plant: Plant) -> tuple[np.ndarray, list[float]]:
        v, total = plant.vehicle, np.zeros(3)
        torques = []
        for axle, angle, arm in ((0, x[at.STEER], v.l_f), (at.AXLE, 0.0, -v.l_r)):
            along, across, torque = force(readings[axle : axle + at.AXLE], plant)
            left = along * math.sin(angle) + across * math.cos(angle)
            total += (along * math.cos(angle) - across * math.sin(angle), left, arm * left)
            torques.append(torque)
        return total, torques

    def kick(x: np.ndarray, readings: np.ndarray, plant: Plant, span: float) -> None:
        v = plant.vehicle
        (F_x, F_y, M_z), torques = pushes(x, readings, plant)
        x[at.V_X] += F_x / v.m * span
        x[at.V_Y] += F_y / v.m * span
        x[at.YAW_RATE] += M_z / v.I_z * span
        x[at.PITCH_RATE] += F_x * v.h_cg / v.I_y * span
        for i, torque in enumerate(torques):
            x[at.OMEGA_F + i] -= torque / (v.wheels_per_axle * v.I_w) * span

    return Faults(kick=kick)
