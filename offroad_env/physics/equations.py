"""Which equations of motion a plant has: those of the half-car, or those of four wheels.

``plant.four_wheel`` is None for the half-car: then the compiler leaves nothing of the other branch.
"""

from __future__ import annotations

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.four_wheel_dynamics import four_wheel_derivative
from offroad_env.physics.four_wheel_jacobian import solve_wheel_stages, wheel_stiffnesses
from offroad_env.physics.full_dynamics import actuators, half_car_derivative
from offroad_env.physics.full_jacobian import Slope, axle_stiffnesses, solve_axle_stages
from offroad_env.physics.records import FloatArray, FourWheel

__all__ = ["apply_command", "full_derivative", "solve_stages", "spin_change", "stiffnesses"]


@inline_kernel
def _derivative(
    four: FourWheel | None,
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    if four is None:
        half_car_derivative(x, (command[0], command[1], command[2]), plant, warm, d, readings)
    else:
        four_wheel_derivative(x, command, plant, warm, d, readings)


@kernel
def full_derivative(
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """Time derivative of the state into ``d``.

    ``command`` = (steer [rad], drive torque [N m, total at the wheels], brake torque [N m, total]); with
    four wheels four more numbers may follow, see `four_wheel_dynamics.given_torque`.
    """
    _derivative(plant.four_wheel, x, command, plant, warm, d, readings)


@inline_kernel
def _command(
    four: FourWheel | None,
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    if len(command) > 3:
        _derivative(four, x, command, plant, warm, d, readings)
    else:
        actuators(plant.vehicle, x, (command[0], command[1], command[2]), d)


@inline_kernel
def apply_command(
    x: FloatArray,
    command: tuple[float, ...],
    plant: Plant,
    warm: FloatArray,
    d: FloatArray,
    readings: FloatArray,
) -> None:
    """The slope ``d`` under another command: that enters through the actuators only, but for given wheels."""
    _command(plant.four_wheel, x, command, plant, warm, d, readings)


@inline_kernel
def _stiffnesses(
    four: FourWheel | None,
    plant: Plant,
    x: FloatArray,
    warm: FloatArray,
    readings: FloatArray,
    slope: Slope,
    stiffness: FloatArray,
) -> None:
    if four is None:
        axle_stiffnesses(plant, x, warm, readings, slope, stiffness)
    else:
        wheel_stiffnesses(plant, x, warm, readings, slope, stiffness)


@inline_kernel
def stiffnesses(
    plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray, slope: Slope, stiffness: FloatArray
) -> None:
    """What the Jacobian holds, into ``stiffness``, a row of `readings_size` numbers."""
    _stiffnesses(plant.four_wheel, plant, x, warm, readings, slope, stiffness)


@inline_kernel
def _stages(
    four: FourWheel | None,
    plant: Plant,
    x: FloatArray,
    stiffness: FloatArray,
    gamma_dt: float,
    k: FloatArray,
) -> None:
    if four is None:
        solve_axle_stages(plant, x, stiffness, gamma_dt, k)
    else:
        solve_wheel_stages(plant, x, stiffness, gamma_dt, k)


@inline_kernel
def solve_stages(plant: Plant, x: FloatArray, stiffness: FloatArray, gamma_dt: float, k: FloatArray) -> None:
    """Solve (1 - gamma dt J) k = right side, in place, along and then across the wheels."""
    _stages(plant.four_wheel, plant, x, stiffness, gamma_dt, k)


@inline_kernel
def _spin_change(four: FourWheel | None, k_1: FloatArray, k_2: FloatArray) -> float:
    front, rear = k_1[at.OMEGA_F] + k_2[at.OMEGA_F], k_1[at.OMEGA_R] + k_2[at.OMEGA_R]
    largest: float = max(abs(front), abs(rear))
    if four is None:
        return largest
    front_split, rear_split = k_1[at.SPLIT_F] + k_2[at.SPLIT_F], k_1[at.SPLIT_R] + k_2[at.SPLIT_R]
    widest: float = max(abs(front) + abs(front_split), abs(rear) + abs(rear_split))
    return widest


@inline_kernel
def spin_change(plant: Plant, k_1: FloatArray, k_2: FloatArray) -> float:
    """Largest spin acceleration of a wheel in the sum of two stages [rad/s^2]."""
    change: float = _spin_change(plant.four_wheel, k_1, k_2)
    return change
