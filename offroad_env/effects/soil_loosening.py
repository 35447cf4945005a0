"""Soil that a wheel slides over bears less, along the wheel or across it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.effects.whole_slip import whole_slip
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_pressure

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    return with_pressure(soil, soil.n, math.exp(-row[0] * whole_slip(motion, where[3])))


EFFECT = Effect(
    id="soil_loosening",
    family="soil",
    hook="soil state",
    size=Parameter(name="rate", unit="-", low=-3.0, high=8.0),
    plausible=lambda vehicle: 1.0,
    sentence="the bearing pressure falls by exp(-{size} s) with the slip s along and across the wheel",
    look_alikes=("slip_sinkage", "slip_digging"),
    separated_by="straight and oblique trials at many slips, from rolling to locked and spinning",
    models=("rig",),
    soil_only=True,
    law=_law,
)
