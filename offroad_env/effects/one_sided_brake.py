"""The left brakes take more than their share."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel

__all__ = ["EFFECT"]


@inline_kernel
def _law(forces, row, x, vehicle):
    F_x, F_y, M_z = forces
    return (
        F_x,
        F_y,
        M_z + 0.5 * row[0] * x[at.BRAKE] / vehicle.r * 0.5 * vehicle.track * math.tanh(x[at.V_X] / 0.2),
    )


EFFECT = Effect(
    id="one_sided_brake",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="share", unit="-", low=-1.0, high=1.0),
    plausible=lambda vehicle: 0.5,
    sentence="the left brakes take {size} more than their share",
    look_alikes=("yaw_moment", "steer_offset"),
    separated_by="hard braking with straight steering",
    needs=(("torque_f", "torque_r"),),
    models=("full",),
    law=_law,
)
