"""A force on the body along its axis: tests the equation of motion that it enters."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    return replace(forces, F_x=forces.F_x + row[0])


EFFECT = Effect(
    id="push_forward",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="force", unit="N", low=-1e7, high=1e7),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY,
    sentence="a force of {size} pushes forward",
    source="definition: a constant force on the body",
    searched=False,
    law=_law,
)
