"""Shear stress of soil under a wheel: Mohr-Coulomb strength, mobilised after Janosi & Hanamoto.

Shear displacements ``j`` are in units of the Janosi moduli k_x, k_y. Two laws for the
two directions: each with the whole strength (Buzhardt & Tallapragada, BT), or one strength along the
displacement.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import fast_exp

__all__ = [
    "Shear",
    "Stress",
    "independent_shear",
    "janosi_hanamoto_mobilisation",
    "longitudinal_displacement",
    "mohr_coulomb_strength",
    "resultant_shear",
]

#: Largest exponent that still makes a normal number: 1 - exp(-700) is 1.
_LARGEST_EXPONENT = 700.0


class Stress(NamedTuple):
    """What decides the stresses at a point of the contact patch besides its place."""

    pressure: float  #: Bekker pressure at a sinkage of one radius [Pa]
    n: float  #: sinkage exponent [-]
    c: float  #: cohesion [Pa]
    tan_phi: float  #: [-]
    A_x: float  #: j_x / k_x per angle from the entry [1/rad]
    B_x: float  #: what the travel takes off it, per rise [-]
    C_y: float  #: j_y / k_y per angle from the entry [1/rad]
    side: float  #: sign of j_y


class Shear(NamedTuple):
    """Shear stresses on the rim."""

    x: float  #: along the wheel [Pa]
    y: float  #: across it [Pa]


@inline_kernel
def mohr_coulomb_strength(stress: Stress, sigma: float) -> float:
    """Shear strength tau_max = c + sigma tan(phi) [Pa] at the normal stress ``sigma`` [Pa] (BT tau_max)."""
    return stress.c + sigma * stress.tan_phi


@inline_kernel
def janosi_hanamoto_mobilisation(j: float) -> float:
    """Share 1 - exp(-j/K) of the strength that a shear displacement mobilises, ``j`` >= 0 in units of K.

    BT tau_x, tau_y; Janosi & Hanamoto, Proc. 1st Int. Conf. Mechanics of Soil-Vehicle Systems, 1961.
    """
    return 1.0 - fast_exp(-min(j, _LARGEST_EXPONENT))


@inline_kernel
def longitudinal_displacement(stress: Stress, d: float, rise: float) -> float:
    """j_x / k_x (BT j_x): integral of the slip velocity along the rim from the entry.

    ``d`` = theta_f - theta, ``rise`` = sin(theta_f) - sin(theta).
    """
    return stress.A_x * d - stress.B_x * rise


@inline_kernel
def independent_shear(stress: Stress, sign: float, sigma: float, d: float, rise: float) -> Shear:
    """Each stress with the whole strength (BT tau_x, tau_y), analytic at j = 0; ``sign`` is that of j_x."""
    strength = mohr_coulomb_strength(stress, sigma)
    j_x, j_y = longitudinal_displacement(stress, d, rise), stress.C_y * d
    return Shear(
        strength * (sign * janosi_hanamoto_mobilisation(sign * j_x)),
        strength * (stress.side * janosi_hanamoto_mobilisation(stress.side * j_y)),
    )


@inline_kernel
def resultant_shear(stress: Stress, sigma: float, d: float, rise: float) -> Shear:
    """One strength along the displacement, so Mohr-Coulomb holds for the vector of both stresses."""
    j_x, j_y = longitudinal_displacement(stress, d, rise), stress.C_y * d
    j = math.sqrt(j_x * j_x + j_y * j_y)
    share = mohr_coulomb_strength(stress, sigma) * janosi_hanamoto_mobilisation(j) / max(j, 1e-150)
    return Shear(share * j_x, share * j_y)
