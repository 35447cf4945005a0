"""The left brakes take more than their share."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics import state as at
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import BodyForces, FloatArray, Vehicle

__all__ = ["EFFECT"]

#: Speed below which braking fades, since friction has no sign at rest [m/s].
_SLOW = 0.2


@inline_kernel
def _law(forces: BodyForces, row: FloatArray, x: FloatArray, vehicle: Vehicle) -> BodyForces:
    share = row[0]
    # The left brakes give (1 + share) / 2 of the braking force, the right ones (1 - share) / 2.
    moment = share * forces.brake / vehicle.r * 0.5 * vehicle.track * math.tanh(x[at.V_X] / _SLOW)
    return replace(forces, M_z=forces.M_z + moment)


EFFECT = Effect(
    id="one_sided_brake",
    family="longitudinal",
    hook="body force",
    size=Parameter(name="share", unit="-", low=-1.0, high=1.0),
    plausible=lambda vehicle: 0.25,
    sentence="the left brakes take {size} more than their share",
    source="definition: moment of unequal brake forces at half the track",
    look_alikes=("yaw_moment", "steer_offset"),
    separated_by="hard braking with straight steering",
    needs=(("torque_f", "torque_r", "drive_force"),),
    law=_law,
)
