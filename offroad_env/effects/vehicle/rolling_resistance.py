"""Bearings and tyres resist more than stated."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]

#: Speed below which the resistance fades, since friction has no sign at rest [m/s].
_SLOW = 0.2


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    share = row[0]
    return replace(forces, F_x=forces.F_x - share * vehicle.m * GRAVITY * math.tanh(x[at.V_X] / _SLOW))


EFFECT = Effect(
    id="rolling_resistance",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="share", unit="-", low=-0.5, high=1.0),
    plausible=lambda vehicle: 0.1,
    sentence="rolling resistance is {size} of the weight larger than stated",
    source="Gillespie, Fundamentals of Vehicle Dynamics (1992): rolling resistance in proportion to weight",
    look_alikes=("rut_drag", "aero_drag", "torque_scale", "grade"),
    separated_by="towing the vehicle over hard ground",
    law=_law,
)
