"""Where a vehicle rests on its soil: the start of a simulation.

Started elsewhere, a vehicle falls or rises at first, and the first vertical acceleration reveals the
soil. Here both axles carry their static loads, follow the ground, and the wheels roll without torque.
"""

from __future__ import annotations

import math

import numpy as np

from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import (
    Plant,
    Pose,
    Velocity,
    axle_motion,
    contact_columns,
    static_loads,
)
from offroad_env.physics.contact import CONTACT
from offroad_env.physics.numerics import sin_cos
from offroad_env.physics.records import FloatArray, Vehicle
from offroad_env.physics.rolling import Rolling, come_straight, lowered_by, rest_reaction, rolling_rim
from offroad_env.physics.ruts import Place, follow_rut
from offroad_env.physics.slip import constant_slip_rim

__all__ = ["settle"]

#: How often the axles' places follow the pitch: 30 % of slope leaves a hundredth of a millimetre after three.
_PASSES = 4


@kernel
def settle(
    plant: Plant, pose: tuple[float, float, float], v_x: float
) -> tuple[float, FloatArray, FloatArray]:
    """(worst status, state (15,), contact state (2, columns)) of a vehicle at rest on its soil.

    ``pose`` = (X [m], Y [m], yaw [rad]).
    ``v_x`` [m/s] is its horizontal speed; the axles carry N_static + m_w H_ddot, their heights
    and rates follow the ground. In the full model the wheels turn without soil torque; in the
    paper's the constant slip of the plant sets their speeds.
    """
    x, readings = np.zeros(at.STATE_SIZE), np.empty(at.READINGS_SIZE)
    warm = np.zeros((2, contact_columns(plant.structure)))
    v = plant.vehicle
    X, Y, yaw = pose
    x[at.X], x[at.Y], x[at.YAW], x[at.V_X] = X, Y, yaw, v_x
    loads, direction = static_loads(v), sin_cos(yaw)
    worst = CONTACT
    # A pitched body carries its contacts ahead of where they are on level ground; not in the paper's model.
    carried = plant.half_car > 0.5 and plant.resultant > 0.5
    for _ in range(_PASSES if carried else 1):
        heights, rates = np.zeros(2), np.zeros(2)
        worst, warm[:] = CONTACT, 0.0
        forward, lead = v_x, 0.0
        if carried:
            lead = v.h_cg * math.sin(x[at.PITCH])
            forward += v.h_cg * math.cos(x[at.PITCH]) * x[at.PITCH_RATE]
        for i in range(2):
            arm = v.l_f if i == 0 else -v.l_r
            seen = readings[i * at.AXLE : (i + 1) * at.AXLE]
            velocity = Velocity(forward, 0.0, 0.0)
            motion = axle_motion(plant.ground, Pose(X, Y, direction), velocity, arm + lead, (0.0, 1.0))
            axle = Rolling(motion, arm, loads[i] + v.m_w * motion.H_ddot)
            if i == 1:
                follow_rut(plant.structure, warm[0], warm[1], v.b, motion.x, motion.y)
            if plant.resultant > 0.5:
                rim = rolling_rim(plant, axle, warm[i], seen)
            else:
                rim = constant_slip_rim(plant.slip, motion.u_l)
            worst = max(worst, rest_reaction(plant, axle, rim, warm[i], seen).status)
            x[at.OMEGA_F + i] = rim / v.r
            heights[i], rates[i] = motion.H - lowered_by(plant, axle.N_0, seen), motion.H_dot
            if i == 0:
                place = Place(motion.x, motion.y, direction)
                come_straight(plant.structure, warm[0], place, seen[at.SINKAGE], v.l_f + v.l_r)
        if plant.half_car > 0.5:
            _follow_ground(v, x, heights, rates)
    return worst, x, warm


@inline_kernel
def _follow_ground(v: Vehicle, x: FloatArray, heights: FloatArray, rates: FloatArray) -> None:
    """Height, pitch and their rates of a body on axles at these heights (2,) [m] and rates (2,) [m/s]."""
    base = v.l_f + v.l_r
    sin = min(max((heights[0] - heights[1]) / base, -1.0), 1.0)
    x[at.PITCH] = math.asin(sin)
    x[at.Z] = heights[1] + v.l_r * sin
    x[at.PITCH_RATE] = (rates[0] - rates[1]) / (base * math.cos(x[at.PITCH]))
    x[at.V_Z] = (rates[0] * v.l_r + rates[1] * v.l_f) / base
