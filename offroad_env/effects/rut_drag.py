"""The walls of the rut drag at the wheels."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    area = 4.0 * vehicle.r * contact[1]  # two walls a rut, about as long as the wheel is wide
    return F_x - row[0] * area * math.tanh(motion[1] / 0.2), F_y, T


EFFECT = Effect(
    id="rut_drag",
    family="longitudinal",
    hook="wheel force",
    size=Parameter(name="stress", unit="N/m^2", low=-1e6, high=1e6),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY / (4.0 * vehicle.r * 0.05),
    sentence="the walls of the rut drag with {size} of their area",
    look_alikes=("rolling_resistance", "grade"),
    separated_by="the same line again, in its own ruts",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
