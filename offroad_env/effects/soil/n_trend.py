"""The sinkage exponent drifts along the route."""

from __future__ import annotations

import math

from offroad_env.effects.places import PLACE_AND_DIRECTION, middle_of_route
from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_exponent
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion

__all__ = ["EFFECT"]

#: Smallest exponent of a soil [-], as in `make_soil`.
_SMALLEST = 0.05


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    slope, middle, direction = row[0], row[1], row[2]
    beyond = place.x * math.cos(direction) + place.y * math.sin(direction) - middle
    # The slope is one per 100 m.
    return with_exponent(soil, max(soil.n + 0.01 * slope * beyond, _SMALLEST))


EFFECT = Effect(
    id="n_trend",
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="1/(100 m)", low=-10.0, high=10.0),
    plausible=lambda vehicle: 0.3,
    sentence="n grows by {size} along the route",
    source="assumption of this project: n linear in the position along the route",
    look_alikes=("n_step",),
    separated_by="the same line both ways",
    soil_only=True,
    others=PLACE_AND_DIRECTION,
    places=middle_of_route,
    law=_law,
)
