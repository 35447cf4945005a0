"""Grousers or a tread add thrust to what smooth wheels have."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.wheel_soil import slip_ratio

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    thrust = row[0] * contact[0] * math.tanh(slip_ratio(motion[0], motion[1], contact[3]) / 0.1)
    return F_x + thrust, F_y, T + thrust * vehicle.r


EFFECT = Effect(
    id="grouser_thrust",
    family="soil",
    hook="wheel force",
    size=Parameter(name="share", unit="-", low=-0.6, high=1.5),
    plausible=lambda vehicle: 0.2,
    sentence="the tread adds {size} of the load to the thrust",
    look_alikes=("friction_angle", "shear_modulus"),
    separated_by="steady pulls at several slips",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
