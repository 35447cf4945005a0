"""Pressure of soil against sinkage: Bekker's law, unloading and reloading."""

from __future__ import annotations

import math

from offroad_env.physics._jit import inline_kernel
from offroad_env.physics.numerics import fast_exp, fast_log
from offroad_env.physics.records import Soil

__all__ = [
    "bekker_modulus",
    "bekker_pressure",
    "hull_width",
    "rebound_modulus",
    "rebound_pressure",
]

#: Smallest argument of the logarithm: at the edge of the patch the sinkage is zero.
_SMALLEST = 1e-300
#: Sinkage that a quotient is formed with [m]: a tyre on firm clay sinks by less than an atom's size.
_SHALLOWEST = 1e-100
#: Height over which nodes of a grid count as touched by a wheel (Chrono's default), and what of a wheel's
#: width falls between its outermost nodes, for a grid of 0.04 m [m].
_TEST, _GRID = 0.1, 0.02


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


@inline_kernel
def rebound_pressure(largest: float, modulus: float, rise: float) -> float:
    """Pressure [Pa] of soil that has borne ``largest`` [Pa] and has risen by ``rise`` [m] since.

    Unloading and reloading follow one straight line of slope ``modulus`` [Pa/m] (Krenn & Hirzinger, SCM:
    a soil contact model for planetary rover simulation, 2009; Wong, Theory of Ground Vehicles, 4.3).
    """
    return max(largest - modulus * rise, 0.0)


@inline_kernel
def rebound_modulus(elastic: float, largest: float, z: float) -> float:
    """Slope of unloading [Pa/m] from ``largest`` [Pa] at the sinkage ``z`` [m].

    Soil does not rise above its undisturbed surface: where Bekker's law is steeper than ``elastic``,
    the slope tends to the secant.
    """
    secant = largest / max(z, _SHALLOWEST)
    return math.sqrt(elastic * elastic + secant * secant)


@inline_kernel
def hull_width(b: float, r: float, h: float) -> float:
    """Width [m] that k_c is divided by where it comes from the hull of the contact's grid nodes.

    1/width = perimeter / (2 area) of a rectangle: the wheel's width, of which a grid loses ``_GRID``,
    and the chord of the rim ``_TEST`` above the soil, undisturbed ahead and flattened behind. An
    artefact of soil on a grid (Project Chrono, `SCMTerrain`).
    """
    deep, flat = min(h + _TEST, r), min(_TEST, r)
    chord = math.sqrt(deep * (2.0 * r - deep)) + math.sqrt(flat * (2.0 * r - flat))
    return 1.0 / (1.0 / max(b - _GRID, 0.5 * b) + 1.0 / chord)
