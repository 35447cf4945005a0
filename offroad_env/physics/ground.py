"""The ground: height with its exact derivatives, and the sinkage exponent from place to place."""

from __future__ import annotations

import math
from typing import NamedTuple

from offroad_env.physics._jit import kernel
from offroad_env.physics.numerics import LANES, lane_rows, lane_sum, sin_cos, smooth_step
from offroad_env.physics.records import FloatArray, Ground, SoilMap

__all__ = ["GroundShape", "ground_height", "ground_heights", "ground_readings", "sinkage_exponent"]


class GroundShape(NamedTuple):
    """The undeformed ground at a point."""

    H: float  #: height [m]
    H_X: float  #: slope dH/dX [-]
    H_Y: float  #: slope dH/dY [-]
    H_XX: float  #: curvature d2H/dX2 [1/m]
    H_XY: float  #: mixed derivative [1/m]
    H_YY: float  #: curvature d2H/dY2 [1/m]


@kernel
def _wave_sums(waves: FloatArray, X: float, Y: float) -> GroundShape:
    """Height, gradient and Hessian of all waves at (X, Y).

    Blocks of waves side by side, each lane with its own sums: straight vector code, and the same
    order of the sums on every machine. Lanes beyond the last wave repeat it with amplitude 0.
    """
    count = waves.shape[0]
    rows = lane_rows()
    for i in range(LANES):
        for row in range(6):
            rows[row, i] = 0.0
    for block in range((count + LANES - 1) // LANES):
        for i in range(LANES):
            wave = min(block * LANES + i, count - 1)
            p, q = waves[wave, 1], waves[wave, 2]
            s, c = sin_cos(p * X + q * Y + waves[wave, 3])
            A = waves[wave, 0] if block * LANES + i < count else 0.0
            s, c = A * s, A * c
            rows[0, i] += s
            rows[1, i] += c * p
            rows[2, i] += c * q
            rows[3, i] -= s * p * p
            rows[4, i] -= s * p * q
            rows[5, i] -= s * q * q
    return GroundShape(
        lane_sum(rows[0]),
        lane_sum(rows[1]),
        lane_sum(rows[2]),
        lane_sum(rows[3]),
        lane_sum(rows[4]),
        lane_sum(rows[5]),
    )


@kernel
def ground_readings(ground: Ground, X: float, Y: float) -> GroundShape:
    """Height, gradient and Hessian of the undeformed ground at (X, Y) [m], all exact."""
    H = H_X = H_Y = H_XX = H_XY = H_YY = 0.0
    if ground.waves.shape[0] > 0:
        H, H_X, H_Y, H_XX, H_XY, H_YY = _wave_sums(ground.waves, X, Y)
    plane = ground.H_0 + ground.S_x * X + ground.S_y * Y
    return GroundShape(H + plane, H_X + ground.S_x, H_Y + ground.S_y, H_XX, H_XY, H_YY)


@kernel
def ground_height(ground: Ground, X: float, Y: float) -> float:
    """Height of the undeformed ground H(X, Y) [m]."""
    return ground_readings(ground, X, Y).H


@kernel
def sinkage_exponent(soil_map: SoilMap, n_base: float, X: float, Y: float) -> float:
    """Sinkage exponent n at (X, Y) [-]: the base soil's outside every patch.

    Across the edge of a patch, from ``radius - edge/2`` to ``radius + edge/2`` from its centre, n
    passes from the value beneath to the patch's own by a C2 step; later rows lie over earlier ones.
    """
    n = n_base
    for i in range(soil_map.patches.shape[0]):
        x, y = X - soil_map.patches[i, 0], Y - soil_map.patches[i, 1]
        outer = soil_map.patches[i, 2] + 0.5 * soil_map.edge
        squared = x * x + y * y
        if squared < outer * outer:
            inside = smooth_step((outer - math.sqrt(squared)) / soil_map.edge)
            n = (1.0 - inside) * n + inside * soil_map.patches[i, 3]
    return n


@kernel
def ground_heights(ground: Ground, X: FloatArray, Y: FloatArray, out: FloatArray) -> None:
    """``ground_height`` at every point of the flat arrays ``X, Y`` [m] into ``out`` [m]."""
    for i in range(out.shape[0]):
        out[i] = ground_height(ground, X[i], Y[i])
