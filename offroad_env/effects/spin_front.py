"""A torque on the front wheels: the probe of the finder for what has no name."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    return F_x, F_y, T - (row[0] if contact[2] > 0.0 else 0.0)


EFFECT = Effect(
    id="spin_front",
    family="wheel",
    hook="wheel force",
    size=Parameter(name="torque", unit="N m", low=-1e7, high=1e7),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY * vehicle.r,
    sentence="a torque of {size} turns the front wheels",
    models=("full",),
    searched=False,
    law=_law,
)
