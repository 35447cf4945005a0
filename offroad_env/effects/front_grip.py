"""The front tyres hold the vehicle sideways more or less than the rear ones: it over- or understeers.

No cause that a finder names: on hard ground it is one of the things that nobody knows beforehand.
"""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, motion, contact, vehicle):
    F_x, F_y, T = forces
    if contact[2] > 0.0:
        return F_x, (1.0 + row[0]) * F_y, T
    return forces


EFFECT = Effect(
    id="front_grip",
    family="lateral",
    hook="wheel force",
    size=Parameter(name="share", unit="-", low=-0.9, high=3.0),
    plausible=lambda vehicle: 0.3,
    sentence="the front tyres hold {size} of their side force more than the rear ones at the same slip",
    look_alikes=("steer_gain", "cg_shift"),
    separated_by="steady circles at several speeds",
    hard_only=True,
    searched=False,
    law=_law,
)
