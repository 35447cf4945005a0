"""The stiff directions of a vehicle with four wheels: what its integrator takes implicitly.

As for the half-car (`full_jacobian`): the slip along each wheel, what brakes, bearings and servos hold, and
the side speed of each wheel. Four directions along and four across the wheels, a system of four by four each.
"""

from __future__ import annotations

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.four_wheel_geometry import (
    attitude,
    four_wheels,
    levers,
    one_wheel,
    wheel_place,
    wheel_row,
    wheel_spin,
)
from offroad_env.physics.full_dynamics import axle_torques
from offroad_env.physics.full_jacobian import Slope, held_spin_stiffness, side_stiffness, slip_stiffness
from offroad_env.physics.records import FloatArray, FourWheel

__all__ = ["solve_wheel_stages", "wheel_stiffnesses"]

_W = at.WHEEL_COUNT
# The row that holds the Jacobian, a number for each wheel: torque and traction over slip speed, what holds
# the spin, side force over side speed. Behind it room to solve for the stages: the wheels' directions
# (components by wheels), the matrix and the right side.
_SLIP_TORQUE, _SLIP_FORCE, _HELD, _SIDE = 0, _W, 2 * _W, 3 * _W
_DIRECTIONS, _COMPONENTS = 4 * _W, 5
_MATRIX = _DIRECTIONS + _COMPONENTS * _W
_RIGHT = _MATRIX + _W * _W
#: Components of a direction: of these speeds.
_SPEEDS = (at.V_X, at.V_Y, at.YAW_RATE, at.PITCH_RATE, at.ROLL_RATE)


@kernel
def wheel_stiffnesses(
    plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray, slope: Slope, stiffness: FloatArray
) -> None:
    """What the Jacobian holds, into the first 16 numbers of ``stiffness`` (`readings_size`,)."""
    wheel_plant, four = one_wheel(plant), four_wheels(plant)
    v = wheel_plant.vehicle
    torques = axle_torques(plant.vehicle, x)
    for wheel in range(_W):
        omega, seen = wheel_spin(x, wheel), wheel_row(readings, wheel)
        brake = torques.brake_f if wheel < 2 else torques.brake_r
        ahead = slope.dt * wheel_spin(slope.derivative, wheel)
        torque, force = slip_stiffness(wheel_plant, omega, ahead, warm[wheel], seen)
        stiffness[_SLIP_TORQUE + wheel], stiffness[_SLIP_FORCE + wheel] = torque, force
        held = held_spin_stiffness(v, omega, seen[at.N], 0.5 * brake, plant.v_eps)
        stiffness[_HELD + wheel] = held - four.servo / v.I_w
        stiffness[_SIDE + wheel] = side_stiffness(seen)
    _share_held(four, stiffness)


@inline_kernel
def _share_held(four: FourWheel, stiffness: FloatArray) -> None:
    """Wheels that are locked together are held together."""
    front = 0.5 * (stiffness[_HELD] + stiffness[_HELD + 1])
    rear = 0.5 * (stiffness[_HELD + 2] + stiffness[_HELD + 3])
    both = 0.5 * (front + rear)
    for wheel in range(_W):
        axle, lock = (front, four.lock_f) if wheel < 2 else (rear, four.lock_r)
        shared = axle + four.lock_c * (both - axle)
        stiffness[_HELD + wheel] += max(lock, four.lock_c) * (shared - stiffness[_HELD + wheel])


@inline_kernel
def _mobility(four: FourWheel, i: int, j: int) -> float:
    """Spin acceleration of wheel ``i`` per torque on wheel ``j``, times the inertia of a wheel [-]."""
    same = i // 2 == j // 2
    mean = 1.0 - 0.5 * four.lock_c if same else 0.5 * four.lock_c
    lock = four.lock_f if i < 2 else four.lock_r
    sides = 1.0 if i % 2 == j % 2 else -1.0
    split = (1.0 - lock) * sides if same else 0.0
    return 0.5 * (mean + split)


@inline_kernel
def _inverse_mass(plant: Plant, component: int) -> float:
    """Acceleration of a speed of ``_SPEEDS`` per its force."""
    v = plant.vehicle
    if component < 2:
        return 1.0 / v.m
    if component == 2:
        return 1.0 / v.I_z
    return 1.0 / v.I_y if component == 3 else 1.0 / four_wheels(plant).I_x


@inline_kernel
def _set_directions(plant: Plant, x: FloatArray, across: bool, room: FloatArray) -> None:
    """Gradients of the wheels' speeds along or across themselves, into ``room``."""
    v, body = plant.vehicle, attitude(x)
    for wheel in range(_W):
        place = wheel_place(four_wheels(plant), v, x[at.STEER], wheel)
        lever = levers(v, body, place)
        sin, cos = place.steer
        e_x, e_y = (-sin, cos) if across else (cos, sin)
        room[_DIRECTIONS + wheel] = e_x
        room[_DIRECTIONS + _W + wheel] = e_y
        room[_DIRECTIONS + 2 * _W + wheel] = e_y * lever.reach - e_x * lever.across
        room[_DIRECTIONS + 3 * _W + wheel] = e_x * lever.push_pitch
        room[_DIRECTIONS + 4 * _W + wheel] = e_y * lever.push_roll


@inline_kernel
def _coupling(plant: Plant, room: FloatArray, i: int, j: int) -> float:
    """Acceleration of wheel ``i`` in its direction per force on wheel ``j`` in its own [1/kg]."""
    total = 0.0
    for c in range(_COMPONENTS):
        first = _DIRECTIONS + c * _W
        total += room[first + i] * room[first + j] * _inverse_mass(plant, c)
    return total


@inline_kernel
def _speed_change(room: FloatArray, wheel: int, k: FloatArray) -> float:
    """Change of a wheel's speed in its direction by the change ``k`` of the state."""
    total = 0.0
    for c in range(_COMPONENTS):
        total += room[_DIRECTIONS + c * _W + wheel] * k[_SPEEDS[c]]
    return total


@inline_kernel
def _push(plant: Plant, room: FloatArray, wheel: int, force: float, k: FloatArray) -> None:
    """Add to ``k`` what a force [N] on a wheel in its direction does."""
    for c in range(_COMPONENTS):
        k[_SPEEDS[c]] += force * room[_DIRECTIONS + c * _W + wheel] * _inverse_mass(plant, c)


@inline_kernel
def _solve(room: FloatArray) -> None:
    """Solve the four equations in ``room``, in place: elimination, the diagonal is never less than 1."""
    for i in range(_W):
        pivot = 1.0 / room[_MATRIX + _W * i + i]
        for j in range(i + 1, _W):
            factor = room[_MATRIX + _W * j + i] * pivot
            for c in range(i + 1, _W):
                room[_MATRIX + _W * j + c] -= factor * room[_MATRIX + _W * i + c]
            room[_RIGHT + j] -= factor * room[_RIGHT + i]
    for back in range(_W):
        i = _W - 1 - back
        for c in range(i + 1, _W):
            room[_RIGHT + i] -= room[_MATRIX + _W * i + c] * room[_RIGHT + c]
        room[_RIGHT + i] /= room[_MATRIX + _W * i + i]


@inline_kernel
def _implicit_slips(plant: Plant, x: FloatArray, room: FloatArray, gamma_dt: float, k: FloatArray) -> None:
    """`full_jacobian._implicit_slips` for four wheels."""
    v, four = plant.vehicle, four_wheels(plant)
    _set_directions(plant, x, False, room)
    for i in range(_W):
        free = 1.0 / (1.0 - gamma_dt * room[_HELD + i])
        room[_RIGHT + i] = v.r * free * wheel_spin(k, i) - _speed_change(room, i, k)
        for j in range(_W):
            spin = v.r * free * _mobility(four, i, j) * room[_SLIP_TORQUE + j] / v.I_w
            slide = _coupling(plant, room, i, j) * room[_SLIP_FORCE + j]
            room[_MATRIX + _W * i + j] = gamma_dt * (spin + slide) + (1.0 if i == j else 0.0)
    _solve(room)
    for axle in range(2):
        left, right = wheel_spin(k, 2 * axle), wheel_spin(k, 2 * axle + 1)
        for j in range(_W):
            torque = gamma_dt * room[_SLIP_TORQUE + j] * room[_RIGHT + j] / v.I_w
            left -= _mobility(four, 2 * axle, j) * torque
            right -= _mobility(four, 2 * axle + 1, j) * torque
        left /= 1.0 - gamma_dt * room[_HELD + 2 * axle]
        right /= 1.0 - gamma_dt * room[_HELD + 2 * axle + 1]
        k[at.OMEGA_F + axle] = 0.5 * (left + right)
        k[at.SPLIT_F + axle] = 0.5 * (right - left)
    for j in range(_W):
        _push(plant, room, j, gamma_dt * room[_SLIP_FORCE + j] * room[_RIGHT + j], k)


@inline_kernel
def _implicit_sides(plant: Plant, x: FloatArray, room: FloatArray, gamma_dt: float, k: FloatArray) -> None:
    """`full_jacobian._implicit_sides` for four wheels."""
    _set_directions(plant, x, True, room)
    for i in range(_W):
        room[_RIGHT + i] = _speed_change(room, i, k)
        for j in range(_W):
            slide = gamma_dt * _coupling(plant, room, i, j) * room[_SIDE + j]
            room[_MATRIX + _W * i + j] = slide + (1.0 if i == j else 0.0)
    _solve(room)
    for j in range(_W):
        _push(plant, room, j, -gamma_dt * room[_SIDE + j] * room[_RIGHT + j], k)


@kernel
def solve_wheel_stages(
    plant: Plant, x: FloatArray, stiffness: FloatArray, gamma_dt: float, k: FloatArray
) -> None:
    """Solve (1 - gamma dt J) k = right side, in place, along and then across the wheels.

    ``stiffness`` (`readings_size`,) holds the Jacobian, and room behind it.
    """
    _implicit_slips(plant, x, stiffness, gamma_dt, k)
    _implicit_sides(plant, x, stiffness, gamma_dt, k)
