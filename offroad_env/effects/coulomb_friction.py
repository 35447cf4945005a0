"""Dry friction in the suspension."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import GRAVITY

__all__ = ["EFFECT"]


@inline_kernel
def _law(N_0, row, spring, axle):
    return N_0 - row[0] * math.tanh(spring[1] / 0.02)


EFFECT = Effect(
    id="coulomb_friction",
    family="suspension",
    hook="suspension",
    size=Parameter(name="force", unit="N", low=-1e5, high=1e5),
    plausible=lambda vehicle: 0.1 * vehicle.m * GRAVITY,
    sentence="each axle's suspension has {size} of dry friction",
    look_alikes=("damper_nonlinear",),
    separated_by="bumps, small and large",
    law=_law,
)
