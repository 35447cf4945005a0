"""A torque on the rear wheels: tests their equation of rotation."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    torque = row[0] if contact.arm < 0.0 else 0.0
    return replace(forces, torque=forces.torque - torque)


EFFECT = Effect(
    id="spin_rear",
    family="wheel",
    hook="wheel force",
    size=Parameter(name="torque", unit="N m", low=-1e7, high=1e7),
    plausible=lambda vehicle: 0.05 * vehicle.m * GRAVITY * vehicle.r,
    sentence="a torque of {size} turns the rear wheels",
    source="definition: a constant torque on the wheels",
    models=("full",),
    searched=False,
    law=_law,
)
