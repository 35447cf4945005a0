"""The suspension has a stop that the model lacks."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.records import AxleSpring, FloatArray, SpringState

__all__ = ["EFFECT"]

#: Compression at which the stop begins [m].
_TRAVEL = 0.03


@inline_kernel
def _law(N_0: float, row: FloatArray, state: SpringState, spring: AxleSpring) -> float:
    share: float = row[0]
    beyond = -_TRAVEL - state.height
    # The larger of `beyond` and zero, rounded over 5 mm.
    smooth = 0.5 * (beyond + math.sqrt(beyond * beyond + 2.5e-5))
    return N_0 + share * spring.k * smooth


EFFECT = Effect(
    id="bump_stop",
    family="suspension",
    hook="suspension",
    size=Parameter(name="share", unit="-", low=-0.9, high=50.0),
    plausible=lambda vehicle: 5.0,
    sentence="beyond 3 cm of travel the suspension is {size} of its stiffness stiffer",
    source="assumption of this project: a second linear spring beyond a fixed travel",
    look_alikes=("damper_nonlinear",),
    separated_by="one large bump",
    law=_law,
)
