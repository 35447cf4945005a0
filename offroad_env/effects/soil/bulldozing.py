"""A wheel that slides sideways pushes soil before it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    stress = row[0]
    speed = math.sqrt(motion.v_l * motion.v_l + motion.v_c * motion.v_c + contact.v_eps * contact.v_eps)
    area = 2.0 * contact.wheels * contact.r * contact.sinkage
    return replace(forces, F_y=forces.F_y - stress * area * motion.v_c / speed)


EFFECT = Effect(
    id="bulldozing",
    family="soil",
    hook="wheel force",
    size=Parameter(name="stress", unit="N/m^2", low=-1e6, high=1e7),
    plausible=lambda vehicle: 0.3 * vehicle.m * GRAVITY / (4.0 * vehicle.r * 0.05),
    sentence="the side of a wheel pushes soil with {size} of the area that has sunk",
    source="assumption of this project: a mean stress on the sunk side of the wheel, in place of the "
    "bulldozing resistance of Hegedus in the wheel model of Ishigami et al., J. Field Robotics 24 (2007)",
    look_alikes=("shear_modulus", "friction_angle"),
    separated_by="a steady circle at several speeds",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
