"""The rear wheels run in the ruts of the front wheels, on soil pressed before."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_pressure

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    if where[2] > 0.0:
        return soil
    return with_pressure(soil, soil.n, 1.0 + row[0])


EFFECT = Effect(
    id="multi_pass",
    family="soil",
    hook="soil state",
    size=Parameter(name="share", unit="-", low=-0.9, high=10.0),
    plausible=lambda vehicle: 1.0,
    sentence="the soil under the rear wheels is {size} stiffer",
    look_alikes=("cg_shift",),
    separated_by="crab steering, so that the rear wheels leave the ruts",
    soil_only=True,
    law=_law,
)
