"""A constant moment turns the vehicle."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, x, vehicle):
    F_x, F_y, M_z = forces
    return F_x, F_y, M_z + row[0]


EFFECT = Effect(
    id="yaw_moment",
    family="lateral",
    hook="body force",
    size=Parameter(name="moment", unit="N m", low=-1e6, high=1e6),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY * (vehicle.l_f + vehicle.l_r),
    sentence="a moment of {size} turns the vehicle to the left",
    look_alikes=("steer_offset", "one_sided_brake"),
    separated_by="straight driving, slow and fast",
    law=_law,
)
