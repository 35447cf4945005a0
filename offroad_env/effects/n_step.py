"""The soil changes at a border across the route."""

from __future__ import annotations

import math

from offroad_env.effects.places import borders
from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import smooth_step
from offroad_env.physics.vehicle_model import with_exponent

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    along = where[0] * math.cos(row[2]) + where[1] * math.sin(row[2]) - row[1]
    return with_exponent(soil, max(soil.n + row[0] * smooth_step(0.5 + along), 0.05))


EFFECT = Effect(
    id="n_step",
    family="soil",
    hook="soil state",
    size=Parameter(name="step", unit="-", low=-1.5, high=1.5),
    plausible=lambda vehicle: 0.3,
    sentence="n is {size} larger beyond a border across the route",
    look_alikes=("n_trend",),
    separated_by="crossing the border both ways",
    soil_only=True,
    others=(Parameter(name="place", unit="m"), Parameter(name="direction", unit="rad")),
    places=borders,
    law=_law,
)
