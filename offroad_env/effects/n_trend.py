"""The sinkage exponent drifts along the route."""

from __future__ import annotations

import math

from offroad_env.effects.places import middle_of_route
from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_exponent

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    along = where[0] * math.cos(row[2]) + where[1] * math.sin(row[2]) - row[1]
    return with_exponent(soil, max(soil.n + 0.01 * row[0] * along, 0.05))


EFFECT = Effect(
    id="n_trend",
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="1/(100 m)", low=-10.0, high=10.0),
    plausible=lambda vehicle: 0.3,
    sentence="n grows by {size} along the route",
    look_alikes=("n_step",),
    separated_by="the same line both ways",
    soil_only=True,
    others=(Parameter(name="place", unit="m"), Parameter(name="direction", unit="rad")),
    places=middle_of_route,
    law=_law,
)
