"""Slip of a wheel, and the velocities that shear the soil under it.

The kernels take velocities, never a ratio: with ``D`` the regularised rim speed,
``a = r omega / D``, ``kappa = v_l / D`` and ``ct = v_c / D``. For a driven wheel at speed
``a = 1``, ``kappa = 1 - s`` and ``ct = (1 - s) tan(beta)``, which is the form of Buzhardt &
Tallapragada (BT); for a braked wheel the same displacement integral holds and tends to full
mobilisation as the wheel locks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import smooth_step
from offroad_env.physics.records import WheelMotion

__all__ = [
    "TINY_SPEED",
    "ShearKinematics",
    "constant_slip_rim",
    "rolling_direction",
    "shear_kinematics",
    "slip_ratio",
]

#: Added to a speed that divides: a perfectly locked wheel without ``v_eps`` divides by this [m/s].
TINY_SPEED = 1e-12


class ShearKinematics(NamedTuple):
    """Velocities of a wheel over its regularised rim speed ``D``."""

    a: float  #: r omega / D [-]
    kappa: float  #: v_l / D [-]
    ct: float  #: v_c / D [-]


@inline_kernel
def slip_ratio(r_omega: float, v_l: float, v_eps: float) -> float:
    """(r omega - v) / max(|r omega|, |v|), held in [-1, 1]; fades to 0 below ``v_eps`` [m/s].

    Driving it is the paper's s (BT s), braking it refers to v. Continuous with its slope at
    r omega = v; at standstill the plain ratio would jump between -1 and 1 with every rounding error.
    """
    largest = max(abs(r_omega), abs(v_l))
    if largest <= 0.0:
        return 0.0
    if v_eps > 0.0:
        largest = math.sqrt(largest * largest + v_eps * v_eps)
    return min(max((r_omega - v_l) / largest, -1.0), 1.0)


@inline_kernel
def constant_slip_rim(slip: float, v_l: float) -> float:
    """Rim speed [m/s] that gives ``slip`` at the speed ``v_l`` [m/s]: the paper's s driving, of v braking."""
    return v_l / (1.0 - slip) if slip >= 0.0 else v_l * (1.0 + slip)


@inline_kernel
def shear_kinematics(motion: WheelMotion, v_eps: float) -> ShearKinematics:
    """Velocities over the regularised rim speed.

    ``v_eps`` [m/s] removes the singularity at standstill: below it the soil resists like a
    viscous medium, so a parked vehicle creeps instead of chattering.
    """
    D = math.sqrt(motion.rim_speed * motion.rim_speed + v_eps * v_eps) + TINY_SPEED
    return ShearKinematics(motion.rim_speed / D, motion.v_l / D, motion.v_c / D)


@inline_kernel
def rolling_direction(motion: WheelMotion, v_eps: float) -> float:
    """Share of the forward-rolling pattern: 1 forward, 0 in reverse, C2 between.

    The side that leads is the one the wheel travels to, over ``v_eps`` either way. The rim must not
    decide: the resistance of the soil ahead would push a wheel that spins on the spot backwards.
    """
    if v_eps <= 0.0:
        return 1.0
    return smooth_step(0.5 * (1.0 + motion.v_l / v_eps))
