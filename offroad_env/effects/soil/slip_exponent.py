"""The sinkage exponent grows with slip: a spinning wheel digs itself in."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.axle import with_exponent
from offroad_env.physics.records import AxlePlace, FloatArray, Soil, WheelMotion
from offroad_env.physics.slip import slip_ratio

__all__ = ["EFFECT"]

#: Smallest exponent of a soil [-], as in `make_soil`.
_SMALLEST = 0.05


@inline_kernel
def _law(soil: Soil, row: FloatArray, motion: WheelMotion, place: AxlePlace) -> Soil:
    slope, slip = row[0], slip_ratio(motion.rim_speed, motion.v_l, place.v_eps)
    # The size of the slip, smooth at zero, where a kink of n would show in every force.
    return with_exponent(soil, max(soil.n + slope * (math.sqrt(slip * slip + 1e-4) - 1e-2), _SMALLEST))


EFFECT = Effect(
    id="slip_exponent",
    former_ids=("slip_sinkage",),
    family="soil",
    hook="soil state",
    size=Parameter(name="slope", unit="-", low=-3.0, high=5.0),
    plausible=lambda vehicle: 1.0,
    sentence="n grows by {size} from rolling to full slip",
    source="Ding et al., J. Central South University of Technology 17 (2010) 129-135: sinkage exponent "
    "that changes with the slip ratio",
    look_alikes=("bulldozing", "grouser_thrust"),
    separated_by="steady pulls at several slips",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
