"""The walls of the rut drag at the wheels."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion

__all__ = ["EFFECT"]

#: Speed below which the drag fades, since friction has no sign at rest [m/s].
_SLOW = 0.2


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    stress = row[0]
    area = 2.0 * contact.wheels * contact.r * contact.sinkage  # two walls a rut, each a wheel radius long
    return replace(forces, F_x=forces.F_x - stress * area * math.tanh(motion.v_l / _SLOW))


EFFECT = Effect(
    id="rut_drag",
    family="longitudinal",
    hook="wheel force",
    size=Parameter(name="stress", unit="N/m^2", low=-1e6, high=1e6),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY / (4.0 * vehicle.r * 0.05),
    sentence="the walls of the rut drag with {size} of their area",
    source="assumption of this project: a mean stress on walls about a wheel radius long",
    look_alikes=("rolling_resistance", "grade"),
    separated_by="the same line again, in its own ruts",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
