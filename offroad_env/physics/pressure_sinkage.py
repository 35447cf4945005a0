"""Pressure of soil against sinkage: Bekker's law."""

from __future__ import annotations

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import fast_exp, fast_log
from offroad_env.physics.records import Soil

__all__ = ["bekker_modulus", "bekker_pressure"]

#: Smallest argument of the logarithm: at the edge of the patch the sinkage is zero.
_SMALLEST = 1e-300


@inline_kernel
def bekker_modulus(soil: Soil, b: float) -> float:
    """Modulus k_c/b + k_phi of a plate or wheel of width ``b`` [m], in [Pa/m^n]."""
    return soil.k_c / b + soil.k_phi


@inline_kernel
def bekker_pressure(modulus: float, n: float, z: float) -> float:
    """Pressure [Pa] at sinkage ``z`` (BT sigma; Bekker, Introduction to Terrain-Vehicle Systems, 1969).

    ``modulus`` of `bekker_modulus` for ``z`` in [m], or the pressure at a reference sinkage for ``z`` as
    a share of that.
    """
    return modulus * fast_exp(n * fast_log(max(z, _SMALLEST)))  # (k_c/b + k_phi) z^n
