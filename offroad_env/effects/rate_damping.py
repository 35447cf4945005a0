"""The soil bears more, the faster it is pressed."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_pressure

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    return with_pressure(soil, soil.n, max(1.0 + row[0] * math.sqrt(motion[1] * motion[1] + 1e-4), 0.1))


EFFECT = Effect(
    id="rate_damping",
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="s/m", low=-0.1, high=2.0),
    plausible=lambda vehicle: 0.1,
    sentence="the soil bears {size} more for each metre per second of speed",
    look_alikes=("aero_drag",),
    separated_by="the same line at walking pace and fast",
    soil_only=True,
    law=_law,
)
