"""The suspension has a stop that the model lacks."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel

__all__ = ["EFFECT"]


@inline_kernel
def _law(N_0, row, spring, axle):
    beyond = -0.03 - spring[0]
    smooth = 0.5 * (beyond + math.sqrt(beyond * beyond + 2.5e-5))
    return N_0 + row[0] * axle[1] * smooth


EFFECT = Effect(
    id="bump_stop",
    family="suspension",
    hook="suspension",
    size=Parameter(name="share", unit="-", low=-0.9, high=50.0),
    plausible=lambda vehicle: 5.0,
    sentence="beyond 3 cm of travel the suspension is {size} of its stiffness stiffer",
    look_alikes=("damper_nonlinear",),
    separated_by="one large bump",
    law=_law,
)
