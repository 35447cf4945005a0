"""Soil that a wheel slides over bears less, along the wheel or across it."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.effects.soil.combined_slip import combined_slip
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_pressure
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    rate = row[0]
    return with_pressure(soil, soil.n, math.exp(-rate * combined_slip(motion, place.v_eps)))


EFFECT = Effect(
    id="soil_loosening",
    family="soil",
    hook="soil state",
    size=Parameter(name="rate", unit="-", low=-3.0, high=8.0),
    plausible=lambda vehicle: 1.0,
    sentence="the bearing pressure falls by exp(-{size} s) with the slip s along and across the wheel",
    source="assumption of this project: bearing pressure that falls exponentially with the combined slip",
    look_alikes=("slip_exponent", "slip_sinkage"),
    separated_by="straight and oblique trials at many slips, from rolling to locked and spinning",
    models=("rig",),
    soil_only=True,
    law=_law,
)
