"""The soil bears more, the faster it is pressed."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_pressure
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion

__all__ = ["EFFECT"]

#: Smallest factor of the pressure [-]: the soil keeps some strength.
_SMALLEST = 0.1


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    slope = row[0]
    # Smooth at rest: 1e-4 is the square of 1 cm/s.
    speed = math.sqrt(motion.v_l * motion.v_l + 1e-4)
    return with_pressure(soil, soil.n, max(1.0 + slope * speed, _SMALLEST))


EFFECT = Effect(
    id="rate_damping",
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="s/m", low=-0.1, high=2.0),
    plausible=lambda vehicle: 0.1,
    sentence="the soil bears {size} more for each metre per second of speed",
    source="assumption of this project: pressure linear in the travel speed, for the effect of the sinkage "
    "rate (Pope, J. Terramechanics 6, 1969)",
    look_alikes=("aero_drag",),
    separated_by="the same line at walking pace and fast",
    soil_only=True,
    law=_law,
)
