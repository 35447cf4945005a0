"""A wheel that slides sideways pushes soil before it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    speed = math.sqrt(motion[1] * motion[1] + motion[2] * motion[2] + contact[3] * contact[3])
    area = 2.0 * vehicle.wheels_per_axle * vehicle.r * contact[1]
    return F_x, F_y - row[0] * area * motion[2] / speed, T


EFFECT = Effect(
    id="bulldozing",
    family="soil",
    hook="wheel force",
    size=Parameter(name="stress", unit="N/m^2", low=-1e6, high=1e7),
    plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * vehicle.r * 0.05),
    sentence="the side of a wheel pushes soil with {size} of the area that has sunk",
    look_alikes=("shear_modulus", "friction_angle"),
    separated_by="a steady circle at several speeds",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
