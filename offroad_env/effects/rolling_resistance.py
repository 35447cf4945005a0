"""Bearings and tyres resist more than stated."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, x, vehicle):
    F_x, F_y, M_z = forces
    return F_x - row[0] * vehicle.m * GRAVITY * math.tanh(x[at.V_X] / 0.2), F_y, M_z


EFFECT = Effect(
    id="rolling_resistance",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="share", unit="-", low=-0.5, high=1.0),
    plausible=lambda vehicle: 0.1,
    sentence="rolling resistance is {size} of the weight larger than stated",
    look_alikes=("rut_drag", "aero_drag", "torque_scale", "grade"),
    separated_by="towing the vehicle over hard ground",
    law=_law,
)
