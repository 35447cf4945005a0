"""The soil changes at a border across the route."""

from __future__ import annotations

import math

from offroad_env.effects.places import PLACE_AND_DIRECTION, borders
from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_exponent
from offroad_env.physics.numerics import smooth_step
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion

__all__ = ["EFFECT"]

#: Smallest exponent of a soil [-], as in `make_soil`.
_SMALLEST = 0.05


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    step, border, direction = row[0], row[1], row[2]
    beyond = place.x * math.cos(direction) + place.y * math.sin(direction) - border
    return with_exponent(soil, max(soil.n + step * smooth_step(0.5 + beyond), _SMALLEST))


EFFECT = Effect(
    id="n_step",
    family="soil",
    hook="soil state",
    size=Parameter(name="step", unit="-", low=-1.5, high=1.5),
    plausible=lambda vehicle: 0.3,
    sentence="n is {size} larger beyond a border across the route",
    source="assumption of this project: a smooth step of n across a straight border",
    look_alikes=("n_trend",),
    separated_by="crossing the border both ways",
    soil_only=True,
    others=PLACE_AND_DIRECTION,
    places=borders,
    law=_law,
)
