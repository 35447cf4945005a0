"""The sinkage exponent grows with slip: a spinning wheel digs itself in."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.vehicle_model import with_exponent
from offroad_env.physics.wheel_soil import slip_ratio

__all__ = ["EFFECT"]


@inline_kernel
def _law(soil, row, motion, where):
    slip = slip_ratio(motion[0], motion[1], where[3])
    # Smooth at zero slip, where a bend of n would show in every force.
    return with_exponent(soil, max(soil.n + row[0] * (math.sqrt(slip * slip + 1e-4) - 1e-2), 0.05))


EFFECT = Effect(
    id="slip_sinkage",
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="-", low=-3.0, high=5.0),
    plausible=lambda vehicle: 1.0,
    sentence="n grows by {size} from rolling to full slip",
    look_alikes=("bulldozing", "grouser_thrust"),
    separated_by="steady pulls at several slips",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
