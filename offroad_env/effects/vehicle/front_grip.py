"""The front tyres hold the vehicle sideways more or less than the rear ones: it over- or understeers.

Not searched as a cause: on hard ground it is a nuisance parameter of every fit.
"""

from __future__ import annotations

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    share = row[0]
    if contact.arm > 0.0:
        return replace(forces, F_y=(1.0 + share) * forces.F_y)
    return forces


EFFECT = Effect(
    id="front_grip",
    family="lateral",
    hook="wheel force",
    size=Parameter(name="share", unit="-", low=-0.9, high=3.0),
    plausible=lambda vehicle: 0.3,
    sentence="the front tyres hold {size} of their side force more than the rear ones at the same slip",
    source="definition: scale factor of the side force of the front axle",
    look_alikes=("steer_gain", "cg_shift"),
    separated_by="steady circles at several speeds",
    hard_only=True,
    searched=False,
    law=_law,
)
