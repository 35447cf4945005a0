"""Grousers or a tread add thrust to what smooth wheels have."""

from __future__ import annotations

import math

from offroad_env.effects.protocol import Effect, Parameter
from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import AxleContact, AxleForces, FloatArray, WheelMotion
from offroad_env.physics.slip import slip_ratio

__all__ = ["EFFECT"]

#: Slip at which the thrust of the tread has reached three quarters of its largest value [-].
_SLIP = 0.1


@inline_kernel
def _law(forces: AxleForces, row: FloatArray, motion: WheelMotion, contact: AxleContact) -> AxleForces:
    share = row[0]
    thrust = share * contact.F_n * math.tanh(slip_ratio(motion.rim_speed, motion.v_l, contact.v_eps) / _SLIP)
    return replace(forces, F_x=forces.F_x + thrust, torque=forces.torque + thrust * contact.r)


EFFECT = Effect(
    id="grouser_thrust",
    family="soil",
    hook="wheel force",
    size=Parameter(name="share", unit="-", low=-0.6, high=1.5),
    plausible=lambda vehicle: 0.2,
    sentence="the tread adds {size} of the load to the thrust",
    source="assumption of this project: thrust in proportion to the load that saturates with slip",
    look_alikes=("friction_angle", "shear_modulus"),
    separated_by="steady pulls at several slips",
    models=("full", "paper", "rig"),
    soil_only=True,
    law=_law,
)
