"""A constant moment turns the vehicle."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    return replace(forces, M_z=forces.M_z + row[0])


EFFECT = Effect(
    id="yaw_moment",
    family="lateral",
    hook="body force",
    size=Parameter(name="moment", unit="N m", low=-1e6, high=1e6),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY * (vehicle.l_f + vehicle.l_r),
    sentence="a moment of {size} turns the vehicle to the left",
    source="definition: a constant yaw moment",
    look_alikes=("steer_offset", "one_sided_brake"),
    separated_by="straight driving, slow and fast",
    law=_law,
)
