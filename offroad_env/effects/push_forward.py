"""A force on the body along its axis: the probe of the finder for what has no name."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, x, vehicle):
    F_x, F_y, M_z = forces
    return F_x + row[0], F_y, M_z


EFFECT = Effect(
    id="push_forward",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="force", unit="N", low=-1e7, high=1e7),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY,
    sentence="a force of {size} pushes forward",
    searched=False,
    law=_law,
)
