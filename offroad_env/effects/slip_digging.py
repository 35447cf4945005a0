"""Sliding multiplies the sinkage, along the wheel or across it: the wheel carries soil away."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.effects.whole_slip import whole_slip
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_pressure

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    # Lyasko, J. Terramechanics 47 (2010) 21-31: sinkage (1 + s)/(1 - s/2) times as deep, for driven
    # wheels that run straight; here s is the whole slip, and a plate needs the power n of it.
    s = whole_slip(motion, where[3])
    deeper = (1.0 + s) / (1.0 - 0.5 * s)
    return with_pressure(soil, soil.n, math.exp(-soil.n * row[0] * math.log(deeper)))


EFFECT = Effect(
    id="slip_digging",
    family="soil",
    hook="soil state",
    size=Parameter(name="power", unit="-", low=-1.0, high=4.0),
    plausible=lambda vehicle: 1.0,
    sentence="sliding deepens the sinkage by Lyasko's factor to the power {size}",
    look_alikes=("slip_sinkage", "soil_loosening"),
    separated_by="straight and oblique trials at many slips, from rolling to locked and spinning",
    models=("rig",),
    soil_only=True,
    law=_law,
)
