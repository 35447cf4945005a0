"""A wheel that travels faster than its rim pushes soil ahead of it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    # Passive earth pressure grows with depth: half of it over b h. A rim that spins throws the soil back.
    speed = math.sqrt(motion[0] * motion[0] + motion[1] * motion[1] + contact[3] * contact[3])
    area = vehicle.wheels_per_axle * vehicle.b * contact[1]
    return F_x - 0.5 * row[0] * contact[1] * area * motion[1] / (speed + 1e-12), F_y, T


EFFECT = Effect(
    id="front_bulldozing",
    family="longitudinal",
    hook="wheel force",
    size=Parameter(name="gradient", unit="N/m^3", low=-1e7, high=1e8),
    plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * 0.5 * vehicle.b * (0.4 * vehicle.r) ** 2),
    sentence="soil ahead of the wheel resists with a pressure that grows by {size} of depth",
    look_alikes=("rut_drag", "drawbar_offset"),
    separated_by="braked and driven trials at several sinkages",
    models=("rig",),
    soil_only=True,
    law=_law,
)
