"""Slip deepens the sinkage by Lyasko's factor: the wheel carries soil away, along itself or across."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.effects.soil.combined_slip import combined_slip
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_pressure
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion
from offroad_env.physics.slip_sinkage import lyasko_sinkage_factor

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    power = row[0]
    deeper = lyasko_sinkage_factor(combined_slip(motion, place.v_eps))
    # A plate as much deeper needs the exponent n of it as pressure.
    return with_pressure(soil, soil.n, math.exp(-soil.n * power * math.log(deeper)))


EFFECT = Effect(
    id="slip_sinkage",
    former_ids=("slip_digging",),
    family="soil",
    hook="soil state",
    size=Parameter(name="power", unit="-", low=-1.0, high=4.0),
    plausible=lambda vehicle: 1.0,
    sentence="slip deepens the sinkage by Lyasko's factor to the power {size}",
    source="Lyasko, J. Terramechanics 47 (2010) 21-31; assumption of this project: to a power, and with "
    "the combined slip",
    look_alikes=("slip_exponent", "soil_loosening"),
    separated_by="straight and oblique trials at many slips, from rolling to locked and spinning",
    models=("rig",),
    soil_only=True,
    law=_law,
)
