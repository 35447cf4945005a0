"""The ground climbs towards +Y, unseen by the model."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    pull = row[0] * vehicle.m * GRAVITY
    return replace(
        forces, F_x=forces.F_x - pull * math.sin(x[at.YAW]), F_y=forces.F_y - pull * math.cos(x[at.YAW])
    )


EFFECT = Effect(
    id="bank",
    family="lateral",
    hook="body force",
    size=Parameter(name="slope", unit="-", low=-0.5, high=0.5),
    plausible=lambda vehicle: 0.1,
    sentence="the ground climbs by {size} towards +y",
    source="definition: component of the weight along a plane that climbs towards +y",
    look_alikes=("accel_bias_y", "imu_misalignment_roll"),
    separated_by="the same line both ways",
    law=_law,
)
