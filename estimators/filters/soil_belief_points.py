"""Sigma points of the online belief over whole soils, and the vehicle and soil that each of them stands for.

The belief is a normal distribution over `SIZE` numbers. Those of the soil and the mass act on the vehicle in
a way that only its model knows: a pair of sigma points each, not both of which always drive. The others add
to readings, and gravity along a slope to the acceleration: their effect is known.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from estimators.numerics.unscented import guarded_cholesky
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.record_operations import replace
from offroad_env.physics.records import FloatArray, Soil
from offroad_env.physics.soil_field import REFERENCE_SINKAGE

__all__ = [
    "A_0",
    "BELIEF_NAMES",
    "B_0",
    "COPIES",
    "GRADE",
    "LOG_C",
    "LOG_K",
    "LOG_MASS",
    "LOG_PRESSURE",
    "PAIRS",
    "PHI",
    "POINTS",
    "SAMPLED",
    "SIZE",
    "N",
    "Sigma",
    "keep_in_range",
    "place_sigma_points",
    "plant_of_point",
]

#: The numbers of a belief.
BELIEF_NAMES = (
    "log p(5 cm)",
    "n",
    "log c",
    "phi",
    "log K",
    "a_0",
    "b_0",
    "log mass",
    "bias a_x",
    "bias a_y",
    "bias yaw rate",
    "rim scale",
    "slope X",
    "slope Y",
)
(LOG_PRESSURE, N, LOG_C, PHI, LOG_K, A_0, B_0, LOG_MASS) = range(8)
SIZE, SAMPLED = len(BELIEF_NAMES), 8
#: The first of the slopes of the ground towards X and Y, beyond those of its map.
GRADE = SIZE - 2
#: The mean, and a pair for every sampled number.
POINTS = 2 * SAMPLED + 1
#: Columns of the Cholesky factor along which vehicles drive on both points of the pair. The others are what
#: contact angles and mass have beyond the rest of the soil: little, and so nearly linear that the difference
#: to the mean does.
PAIRS = A_0
#: Vehicles that drive: on the mean, on every point ahead, and on the opposite ones of `PAIRS`.
COPIES = 1 + SAMPLED + PAIRS

#: Lowest and highest values of what is sampled: beyond, no soil has been measured, or the laws of the wheel
#: end.
_LOWEST = (math.log(1e3), 0.15, math.log(10.0), 0.05, math.log(1e-3), 0.1, -0.3, -0.7)
_HIGHEST = (math.log(1e8), 1.9, math.log(2e5), 0.9, math.log(0.1), 0.6, 0.0, 0.7)


class Sigma(NamedTuple):
    """Sigma points in pairs along the columns of a Cholesky factor."""

    factor: FloatArray  #: (SAMPLED, SAMPLED) lower triangle L with L L^T = covariance of what is sampled
    scales: FloatArray  #: (SAMPLED,) distance of a pair from the mean, in columns of ``factor``
    points: FloatArray  #: (POINTS, SAMPLED) the mean, the points ahead, those opposite


@inline_kernel
def _clipped(x: float, i: int) -> float:
    """A number of the belief inside its range."""
    return min(max(x, _LOWEST[i]), _HIGHEST[i])


@kernel
def keep_in_range(mean: FloatArray) -> None:
    """Move a mean (SIZE,) into the range of what is sampled, in place."""
    for i in range(SAMPLED):
        mean[i] = _clipped(mean[i], i)


@kernel
def place_sigma_points(mean: FloatArray, cov: FloatArray, sigma: Sigma) -> int:
    """Sigma points of a belief (SIZE,), (SIZE, SIZE); returns how many pivots had to be repaired."""
    factor, scales, points = sigma
    repairs = guarded_cholesky(cov[:SAMPLED, :SAMPLED].copy(), factor)
    for j in range(SAMPLED):
        points[0, j] = mean[j]
    for i in range(SAMPLED):
        for j in range(SAMPLED):
            offset = scales[i] * factor[j, i]
            points[1 + i, j] = _clipped(mean[j] + offset, j)
            points[1 + SAMPLED + i, j] = _clipped(mean[j] - offset, j)
    return repairs


@kernel
def _soil_of_point(base: Soil, x: FloatArray) -> Soil:
    """The soil of a point (SAMPLED,); all of its modulus is frictional."""
    modulus = math.exp(x[LOG_PRESSURE] - x[N] * math.log(REFERENCE_SINKAGE))
    K = math.exp(x[LOG_K])
    return replace(
        base,
        k_c=0.0,
        k_phi=modulus,
        n=x[N],
        c=math.exp(x[LOG_C]),
        phi=x[PHI],
        k_x=K,
        k_y=K,
        a_0=x[A_0],
        b_0=x[B_0],
    )


@kernel
def plant_of_point(plant: Plant, x: FloatArray) -> Plant:
    """The plant with soil and mass of a point (SAMPLED,)."""
    vehicle = replace(plant.vehicle, m=plant.vehicle.m * math.exp(x[LOG_MASS]))
    return replace(plant, vehicle=vehicle, soil=_soil_of_point(plant.soil, x))
