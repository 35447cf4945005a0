"""Where a vehicle with four wheels rests on its soil.

Its springs carry it without heave, pitch or roll acceleration from vertical forces; on uneven or sloping
ground the loads of the wheels follow. Horizontal forces have no part: on a side slope the vehicle begins to
slide, at a creep that its tyres' friction allows.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant, contact_columns, readings_size, state_size
from offroad_env.physics.contact import CONTACT, slope_frame
from offroad_env.physics.four_wheel_dynamics import note_motions, noted_motion, wheel_forces
from offroad_env.physics.four_wheel_geometry import attitude, four_wheels, one_wheel, wheel_place, wheel_row
from offroad_env.physics.numerics import GRAVITY, sin_cos
from offroad_env.physics.records import FloatArray
from offroad_env.physics.rolling import Rolling, come_straight, lowered_by, rest_reaction, rolling_rim
from offroad_env.physics.ruts import Place, follow_rut

__all__ = ["settle_four_wheels"]

#: Steps of Newton's method, times that one is halved, and what it may leave of the weight.
_STEPS, _HALVINGS, _TOLERANCE = 40, 12, 1e-11
#: Times that the wheels' speeds follow their loads.
_PASSES = 3
#: Change of height [m] and angles [rad] for derivatives, the widest one across a kink, the largest step, and
#: the share of the springs' stiffness that keeps the equations regular where all wheels hang.
_CHANGE, _WIDEST, _LONGEST, _SHARE = 1e-6, 1e-2, 0.1, 1e-4


@kernel
def _roll_wheels(
    plant: Plant, x: FloatArray, loads: FloatArray, warm: FloatArray, heights: FloatArray, rates: FloatArray
) -> float:
    """Let the wheels roll without torque under ``loads`` (4,) [N]; returns the worst contact status.

    Their speeds go into ``x``; where the rims' lowest points are and how fast the ground rises under them
    into ``heights`` and ``rates`` (4,).
    """
    v, four, wheel_plant = plant.vehicle, four_wheels(plant), one_wheel(plant)
    readings = np.empty(readings_size(plant))
    note_motions(plant, x, attitude(x), readings)
    worst = CONTACT
    spins = np.empty(at.WHEEL_COUNT)
    for wheel in range(at.WHEEL_COUNT):
        seen, arm = wheel_row(readings, wheel), wheel_place(four, v, x[at.STEER], wheel).arm
        rolling = Rolling(noted_motion(seen), arm, loads[wheel])
        if wheel > 1:
            follow_rut(plant.structure, warm[wheel - 2], warm[wheel], v.b, rolling.motion.x, rolling.motion.y)
        rim = rolling_rim(wheel_plant, rolling, warm[wheel], seen)
        worst = max(worst, rest_reaction(wheel_plant, rolling, rim, warm[wheel], seen).status)
        spins[wheel] = rim / v.r
        if wheel < 2:
            place = Place(rolling.motion.x, rolling.motion.y, sin_cos(x[at.YAW]))
            come_straight(plant.structure, warm[wheel], place, seen[at.SINKAGE], v.l_f + v.l_r)
        lowered = lowered_by(wheel_plant, loads[wheel], seen)
        heights[wheel], rates[wheel] = rolling.motion.H - lowered, rolling.motion.H_dot
    for axle in range(2):
        lock = four.lock_f if axle == 0 else four.lock_r
        x[at.OMEGA_F + axle] = 0.5 * (spins[2 * axle] + spins[2 * axle + 1])
        x[at.SPLIT_F + axle] = (1.0 - lock) * 0.5 * (spins[2 * axle + 1] - spins[2 * axle])
    mean = 0.5 * (x[at.OMEGA_F] + x[at.OMEGA_R])
    for i in range(at.OMEGA_F, at.OMEGA_R + 1):
        x[i] += four.lock_c * (mean - x[i])
    return worst


@kernel
def _plane(plant: Plant, heights: FloatArray) -> tuple[float, float, float]:
    """(height under the CG, slope ahead, slope to the left) of the plane nearest to four heights."""
    v, four = plant.vehicle, four_wheels(plant)
    front, rear = 0.5 * (heights[0] + heights[1]), 0.5 * (heights[2] + heights[3])
    base = v.l_f + v.l_r
    twist = (heights[0] - heights[1]) * four.track_f + (heights[2] - heights[3]) * four.track_r
    tracks = four.track_f * four.track_f + four.track_r * four.track_r
    return (front * v.l_r + rear * v.l_f) / base, (front - rear) / base, twist / tracks


@kernel
def _imbalance(
    plant: Plant, x: FloatArray, warm: FloatArray, d: FloatArray, readings: FloatArray
) -> tuple[float, float, float, float]:
    """(status, vertical force [N], its pitch moment [N m], its roll moment [N m]) beyond equilibrium."""
    wheels = wheel_forces(x, (0.0, 0.0, 0.0), plant, warm, d, readings)
    return wheels.status, wheels.F_s, wheels.pitch_lift, wheels.roll_lift


@inline_kernel
def _solve(matrix: FloatArray, right: FloatArray) -> tuple[float, float, float]:
    """Solution of three equations by Cramer's rule."""
    a, b, c = matrix[0], matrix[1], matrix[2]
    minor_0 = b[1] * c[2] - b[2] * c[1]
    minor_1 = b[2] * c[0] - b[0] * c[2]
    minor_2 = b[0] * c[1] - b[1] * c[0]
    determinant = a[0] * minor_0 + a[1] * minor_1 + a[2] * minor_2
    u, v, w = right[0], right[1], right[2]
    return (
        (u * minor_0 + a[1] * (b[2] * w - v * c[2]) + a[2] * (v * c[1] - b[1] * w)) / determinant,
        (a[0] * (v * c[2] - b[2] * w) + u * minor_1 + a[2] * (b[0] * w - v * c[0])) / determinant,
        (a[0] * (b[1] * w - v * c[1]) + a[1] * (v * c[0] - b[0] * w) + u * minor_2) / determinant,
    )


@inline_kernel
def _left(right: FloatArray, base: float) -> float:
    """Size of what is left of equilibrium [N m]."""
    size: float = base * abs(right[0]) + abs(right[1]) + abs(right[2])
    return size


@kernel
def _derivatives(
    plant: Plant, x: FloatArray, warm: FloatArray, right: FloatArray, readings: FloatArray, change: float
) -> FloatArray:
    """(3, 3) how force and moments ``right`` change with height, pitch and roll over ``change`` of each."""
    d, matrix = np.empty(state_size(plant)), np.empty((3, 3))
    places = (at.Z, at.PITCH, at.ROLL)
    v, four = plant.vehicle, four_wheels(plant)
    springs, base = (v.k_f + v.k_r) * _SHARE, v.l_f + v.l_r
    for i in range(3):
        kept = x[places[i]]
        x[places[i]] = kept + change
        _, force, pitching, rolling = _imbalance(plant, x, warm, d, readings)
        x[places[i]] = kept
        matrix[0, i] = (force - right[0]) / change
        matrix[1, i] = (pitching - right[1]) / change
        matrix[2, i] = (rolling - right[2]) / change
    matrix[0, 0] -= springs
    matrix[1, 1] -= springs * base * base
    matrix[2, 2] -= springs * four.track_f * four.track_r
    return matrix


@kernel
def _balance(plant: Plant, x: FloatArray, warm: FloatArray, readings: FloatArray) -> float:
    """Move height, pitch and roll to where the springs carry the vehicle; returns the contact status.

    Newton's method; a step is halved until less is left, because soil in a rut is far stiffer when it is
    unloaded than when it is loaded, and a whole step from the one into the other misses.
    """
    d, right, old = np.empty(state_size(plant)), np.empty(3), np.empty(3)
    places = (at.Z, at.PITCH, at.ROLL)
    base = plant.vehicle.l_f + plant.vehicle.l_r
    enough = _TOLERANCE * plant.vehicle.m * GRAVITY * base
    change = _CHANGE
    status, right[0], right[1], right[2] = _imbalance(plant, x, warm, d, readings)
    for _ in range(_STEPS):
        left = _left(right, base)
        if left < enough:
            break
        steps = _solve(_derivatives(plant, x, warm, right, readings, change), right)
        share = min(1.0, _LONGEST / max(abs(steps[0]), abs(steps[1]), abs(steps[2]), _LONGEST))
        for i in range(3):
            old[i] = x[places[i]]
        for _half in range(_HALVINGS):
            for i in range(3):
                x[places[i]] = old[i] - share * steps[i]
            status, right[0], right[1], right[2] = _imbalance(plant, x, warm, d, readings)
            if _left(right, base) < left:
                break
            share *= 0.5
        # At a kink the derivatives of the other side count, or those across it.
        better = _left(right, base) < left
        change = _CHANGE if better else math.copysign(min(10.0 * abs(change), _WIDEST), -change)
    return status


@kernel
def settle_four_wheels(
    plant: Plant, pose: tuple[float, float, float], v_x: float
) -> tuple[float, FloatArray, FloatArray]:
    """`settle` of a vehicle with four wheels: state (19,), warm start (4, columns)."""
    x, warm, readings = (
        np.zeros(state_size(plant)),
        np.zeros((at.WHEEL_COUNT, contact_columns(plant.structure))),
        np.empty(readings_size(plant)),
    )
    v, four = plant.vehicle, four_wheels(plant)
    x[at.X], x[at.Y], x[at.YAW] = pose
    x[at.V_X] = v_x
    loads, heights, rates = np.empty(4), np.empty(4), np.empty(4)
    note_motions(plant, x, attitude(x), readings)
    for wheel in range(at.WHEEL_COUNT):
        place = wheel_place(four, v, 0.0, wheel)
        loads[wheel] = (
            place.spring.static_load + 0.5 * v.m_w * noted_motion(wheel_row(readings, wheel)).H_ddot
        )
    worst = _roll_wheels(plant, x, loads, warm, heights, rates)
    height, ahead, left = _plane(plant, heights)
    x[at.Z], x[at.PITCH], x[at.ROLL] = height, math.asin(min(max(ahead, -1.0), 1.0)), math.atan(left)
    x[at.V_Z], pitch_rate, roll_rate = _plane(plant, rates)
    x[at.PITCH_RATE] = pitch_rate / math.cos(x[at.PITCH])
    x[at.ROLL_RATE] = roll_rate * math.cos(x[at.ROLL]) ** 2
    for _ in range(_PASSES):
        worst = max(worst, _balance(plant, x, warm, readings))
        moved = 0.0
        motions = np.empty(readings_size(plant))
        note_motions(plant, x, attitude(x), motions)
        for wheel in range(at.WHEEL_COUNT):
            seen, motion = wheel_row(readings, wheel), noted_motion(wheel_row(motions, wheel))
            frame = slope_frame(motion.g_l, motion.g_c)
            load = seen[at.F_L] * frame.l_z + seen[at.F_C] * frame.c_z + seen[at.N] * frame.n_z
            moved = max(moved, abs(load - loads[wheel]))
            loads[wheel] = load
        if moved < 1e-9 * v.m * GRAVITY:
            break
        worst = max(worst, _roll_wheels(plant, x, loads, warm, heights, rates))
    return worst, x, warm
