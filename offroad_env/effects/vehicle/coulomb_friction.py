"""Dry friction in the suspension."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import AxleSpring, FloatArray, SpringState

__all__ = ["EFFECT"]

#: Rate of the suspension below which friction fades, since it has no sign at rest [m/s].
_SLOW = 0.02


@inline_kernel
def _law(N_0: float, row: FloatArray, state: SpringState, spring: AxleSpring) -> float:
    force: float = row[0]
    return N_0 - force * math.tanh(state.rate / _SLOW)


EFFECT = Effect(
    id="coulomb_friction",
    family="suspension",
    hook="suspension",
    size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
    plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY,
    sentence="each axle's suspension has {size} of dry friction",
    source="Coulomb's friction, regularised at zero speed (Olsson et al., European J. of Control 4, 1998)",
    look_alikes=("damper_nonlinear",),
    separated_by="bumps, small and large",
    law=_law,
)
