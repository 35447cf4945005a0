"""A wheel that travels faster than its rim pushes soil ahead of it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion
from offroad_env.physics.slip import TINY_SPEED

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    gradient = row[0]
    speed = math.sqrt(
        motion.rim_speed * motion.rim_speed + motion.v_l * motion.v_l + contact.v_eps * contact.v_eps
    )
    area = contact.wheels * contact.b * contact.sinkage
    # Half the pressure at the lowest point, since it grows from zero. A rim that spins throws the soil back.
    force = 0.5 * gradient * contact.sinkage * area * motion.v_l / (speed + TINY_SPEED)
    return replace(forces, F_x=forces.F_x - force)


EFFECT = Effect(
    id="front_bulldozing",
    family="longitudinal",
    hook="wheel force",
    size=Parameter(name="gradient", unit="N/m^3", low=-1e7, high=1e8),
    plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * 0.5 * vehicle.b * (0.4 * vehicle.r) ** 2),
    sentence="soil ahead of the wheel resists with a pressure that grows by {size} of depth",
    source="Rankine's passive earth pressure, linear in depth (Terzaghi, Theoretical Soil Mechanics, 1943); "
    "assumption of this project: the share of it at a given slip",
    look_alikes=("rut_drag", "drawbar_offset"),
    separated_by="braked and driven trials at several sinkages",
    models=("rig",),
    soil_only=True,
    law=_law,
)
