"""Forces of a wheel on ground that does not yield."""

from __future__ import annotations

import math

from offroad_env.physics._jit import kernel
from offroad_env.physics.records import AxleForces, Soil, WheelMotion
from offroad_env.physics.slip import TINY_SPEED

__all__ = ["hard_ground_forces"]


@kernel
def hard_ground_forces(soil: Soil, r: float, load: float, motion: WheelMotion, v_eps: float) -> AxleForces:
    """Forces by the slip stiffnesses ``C_kappa`` and ``C_alpha``; at most ``mu`` times the load [N].

    One force along the combined slip (C_kappa s_x, -C_alpha tan beta) = C_alpha slip, mu N
    tanh(C_alpha |slip| / mu): the similarity form of Pacejka (Tire and Vehicle Dynamics, section 4.3),
    slips normalised by their own stiffness, with tanh as master curve.
    """
    largest = max(motion.rim_speed * motion.rim_speed, motion.v_l * motion.v_l)
    D = math.sqrt(largest + v_eps * v_eps) + TINY_SPEED
    slip_x = soil.C_kappa / soil.C_alpha * (motion.rim_speed - motion.v_l) / D
    slip_y = -motion.v_c / D
    slip = math.sqrt(slip_x * slip_x + slip_y * slip_y)
    gain = soil.C_alpha * load
    if slip > 1e-9:
        gain = soil.mu * load * math.tanh(soil.C_alpha * slip / soil.mu) / slip
    return AxleForces(gain * slip_x, gain * slip_y, gain * slip_x * r)
