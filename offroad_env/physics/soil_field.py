"""Soil that varies from place to place: patches of other soils, and a random field over all of it.

A random field moves five numbers of the soil: the pressure at 5 cm, the exponent n, cohesion, tan(phi) and
the shear moduli. n alone would change the pressure of a wheel by orders of magnitude: (z / 5 cm)^n turns
about 5 cm, the middle of what wheels sink. The four positive numbers vary by their logarithm.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.numerics import (
    LANES,
    fast_exp,
    fast_log,
    lane_rows,
    lane_sum,
    sin_cos,
    smooth_clamp,
    smooth_step,
)
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray, Soil, SoilField

__all__ = [
    "REFERENCE_SINKAGE",
    "Deviation",
    "field_deviation",
    "local_soil",
    "local_soils",
    "soil_in_patches",
]

#: Sinkage at which the pressure and the exponent vary independently of each other [m].
REFERENCE_SINKAGE = 0.05
#: Range of the exponent, and how smoothly it is held there.
_N_LOW, _N_HIGH, _N_EDGE = 0.05, 2.5, 0.02


class Deviation(NamedTuple):
    """How the soil at a place departs from the base soil."""

    log_pressure: float  #: of the logarithm of the pressure at 5 cm, of any width
    n: float  #: of the exponent [-]
    log_c: float  #: of the logarithm of the cohesion
    log_tan_phi: float  #: of the logarithm of tan(phi)
    log_shear_modulus: float  #: of the logarithm of both shear moduli


@kernel
def field_deviation(waves: FloatArray, X: float, Y: float) -> Deviation:
    """Sum of the plane waves (M, 12) of a `SoilField` at (X, Y) [m]; in blocks, as those of the ground."""
    count = waves.shape[0]
    rows = lane_rows()
    for i in range(LANES):
        for row in range(5):
            rows[row, i] = 0.0
    for block in range((count + LANES - 1) // LANES):
        for i in range(LANES):
            wave = min(block * LANES + i, count - 1)
            s, c = sin_cos(waves[wave, 0] * X + waves[wave, 1] * Y)
            real = 1.0 if block * LANES + i < count else 0.0
            s, c = real * s, real * c
            rows[0, i] += waves[wave, 2] * s + waves[wave, 7] * c
            rows[1, i] += waves[wave, 3] * s + waves[wave, 8] * c
            rows[2, i] += waves[wave, 4] * s + waves[wave, 9] * c
            rows[3, i] += waves[wave, 5] * s + waves[wave, 10] * c
            rows[4, i] += waves[wave, 6] * s + waves[wave, 11] * c
    return Deviation(
        lane_sum(rows[0]), lane_sum(rows[1]), lane_sum(rows[2]), lane_sum(rows[3]), lane_sum(rows[4])
    )


@inline_kernel
def _power(x: float, exponent: float) -> float:
    """x^exponent of a positive number."""
    return fast_exp(exponent * fast_log(x))


@inline_kernel
def _mixed(share: float, inside: float, outside: float) -> float:
    """``share`` of ``inside`` and the rest of ``outside``."""
    return share * inside + (1.0 - share) * outside


@kernel
def soil_in_patches(field: SoilField, soil: Soil, X: float, Y: float) -> Soil:
    """The soil of the patches at (X, Y) [m], of ``soil`` outside of them; later rows lie over earlier ones.

    Across an edge the pressures at 5 cm, n, c, tan(phi), the shear moduli and the shares of the contact
    angles pass from one soil to the other by one C2 step: whatever is positive in both stays so.
    """
    here = soil
    for i in range(field.patches.shape[0]):
        row = field.patches[i]
        x, y = X - row[0], Y - row[1]
        outer = row[2] + 0.5 * field.edge
        squared = x * x + y * y
        if squared < outer * outer:
            share = smooth_step((outer - math.sqrt(squared)) / field.edge)
            before = _power(REFERENCE_SINKAGE, here.n)
            n = _mixed(share, row[5], here.n)
            per_power = 1.0 / _power(REFERENCE_SINKAGE, n)
            here = replace(
                here,
                k_c=_mixed(share, row[3], here.k_c * before) * per_power,
                k_phi=_mixed(share, row[4], here.k_phi * before) * per_power,
                n=n,
                c=_mixed(share, row[6], here.c),
                phi=math.atan(_mixed(share, row[7], math.tan(here.phi))),
                k_x=_mixed(share, row[8], here.k_x),
                k_y=_mixed(share, row[9], here.k_y),
                a_0=_mixed(share, row[10], here.a_0),
                a_1=_mixed(share, row[11], here.a_1),
                b_0=_mixed(share, row[12], here.b_0),
                b_1=_mixed(share, row[13], here.b_1),
            )
    return here


@kernel
def _natural_soil(field: SoilField, base: Soil, X: float, Y: float) -> Soil:
    """The soil at (X, Y) [m]: that of the patches there, moved by the random field."""
    soil = soil_in_patches(field, base, X, Y)
    if field.waves.shape[0] == 0:
        return soil
    moved = field_deviation(field.waves, X, Y)
    n = smooth_clamp(soil.n + moved.n, _N_LOW, _N_HIGH, _N_EDGE)
    # (k_c/b + k_phi) 0.05^n times exp(log_pressure), whatever the width.
    factor = fast_exp(moved.log_pressure) * _power(REFERENCE_SINKAGE, soil.n - n)
    longer = fast_exp(moved.log_shear_modulus)
    return replace(
        soil,
        k_c=factor * soil.k_c,
        k_phi=factor * soil.k_phi,
        n=n,
        c=soil.c * fast_exp(moved.log_c),
        phi=math.atan(math.tan(soil.phi) * fast_exp(moved.log_tan_phi)),
        k_x=longer * soil.k_x,
        k_y=longer * soil.k_y,
    )


@inline_kernel
def local_soil(field: SoilField | None, soil: Soil, X: float, Y: float) -> Soil:
    """The soil at (X, Y) [m]: ``soil`` itself where there is no field."""
    if field is None:
        return soil
    return _natural_soil(field, soil, X, Y)


@kernel
def local_soils(field: SoilField, base: Soil, X: FloatArray, Y: FloatArray, out: FloatArray) -> None:
    """(k_c, k_phi, n, c, phi, k_x) at every point of the flat arrays ``X, Y`` [m] into ``out`` (N, 6)."""
    for i in range(out.shape[0]):
        soil = _natural_soil(field, base, X[i], Y[i])
        out[i, 0], out[i, 1], out[i, 2] = soil.k_c, soil.k_phi, soil.n
        out[i, 3], out[i, 4], out[i, 5] = soil.c, soil.phi, soil.k_x
