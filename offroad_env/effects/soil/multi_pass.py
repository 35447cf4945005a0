"""The rear wheels run in the ruts of the front wheels, on soil pressed before."""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_pressure
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    if place.arm > 0.0:
        return soil
    return with_pressure(soil, soil.n, 1.0 + row[0])


EFFECT = Effect(
    id="multi_pass",
    family="soil",
    hook="soil state",
    size=Parameter(name="share", unit="-", low=-0.9, high=10.0),
    plausible=lambda vehicle: 1.0,
    sentence="the soil under the rear wheels is {size} stiffer",
    source="assumption of this project: sinkage moduli scaled under the rear wheels, for the effect of "
    "passes in one rut (Holm, J. Terramechanics 6, 1969)",
    look_alikes=("cg_shift",),
    separated_by="crab steering, so that the rear wheels leave the ruts",
    soil_only=True,
    law=_law,
)
