"""A force on the body to its left: tests the equation of motion that it enters."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    return replace(forces, F_y=forces.F_y + row[0])


EFFECT = Effect(
    id="push_left",
    family="lateral",
    hook="body force",
    size=Parameter(name="force", unit="N", low=-1e7, high=1e7),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY,
    sentence="a force of {size} pushes to the left",
    source="definition: a constant force on the body",
    searched=False,
    law=_law,
)
