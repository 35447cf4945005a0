"""What the soil holds by a belief over whole soils: mean and covariance of the limits, without a sample.

The limits are evaluated at sigma points of a reference belief, one point an update, so that no update is
long. Along the columns of the reference's Cholesky factor they are taken as parabolas; between two
references the belief moves on them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.filters.soil_belief_points import (
    GRADE,
    POINTS,
    SAMPLED,
    Sigma,
    place_sigma_points,
    plant_of_point,
)
from offroad_env.physics._jit import inline_kernel, kernel
from offroad_env.physics.axle import Plant
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.packing import PackedPlant, unpack
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.soil_holds import HIGHEST_SLIP, SoilHolds, limits_at

__all__ = [
    "LIMITS",
    "LOGARITHMIC",
    "SHIFT",
    "LimitSurrogate",
    "least_sd",
    "limits_of_belief",
    "moved_since",
    "new_surrogate",
    "refresh_surrogate",
    "share_of_slope",
    "sharpen",
    "sharpened_limits",
    "transform_limits",
    "whole_surrogate",
]

#: Limits in the order of `SoilHolds`.
LIMITS = len(SoilHolds._fields)
#: Which of them are normal in their logarithm, and what is added before it is taken, in weights of the
#: vehicle: pull is what is left of the thrust, which is positive. The best slip is not among them.
LOGARITHMIC, SHIFT = (True, True, False, True, True, True), (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)
#: Range of the numbers whose logarithm is taken, in their own units, of pull in weights: beyond, a soil is as
#: bad, or as good, as there is any.
_SMALLEST, _LARGEST = (1e-2, 2e-2, 0.0, 1.0, 1e-4, 5e-2), (1e3, 1e3, 1.0, 1e8, 1e2, 1e3)
#: Least standard deviation of a limit on that scale, and in its own unit [m/s^2, N, -, N, m, m]: where all
#: soils of a belief are as bad as there is any, the limit does not depend on them, yet it is not known.
_LEAST_SD = 1e-3
_RESOLUTION = (0.03, 0.0, 0.0, 1.0, 2e-4, 0.05)
#: Distance of the reference's points from its mean, in standard deviations: as far as an interval reaches
#: where the belief is wide would be 2; beyond 1 soils of the population do not carry the vehicle.
_DISTANCE = 1.0
#: Least standard deviation of the best slip [-].
_SLIP_SD = 0.03


class LimitSurrogate(NamedTuple):
    """Parabolas of the limits over a reference belief, and the next reference while it is evaluated."""

    mean: FloatArray  #: (SAMPLED,) of the reference
    factor: FloatArray  #: (SAMPLED, SAMPLED) its Cholesky factor
    value: FloatArray  #: (LIMITS,) at the mean
    slope: FloatArray  #: (LIMITS, SAMPLED) per column of the factor
    bend: FloatArray  #: (LIMITS, SAMPLED) second derivative per column
    next: Sigma  #: points of the next reference
    found: FloatArray  #: (POINTS, LIMITS) at its points
    done: FloatArray  #: (1,) how many of them are evaluated


def new_surrogate() -> LimitSurrogate:
    """A surrogate without values."""
    sigma = Sigma(np.zeros((SAMPLED, SAMPLED)), np.full(SAMPLED, _DISTANCE), np.zeros((POINTS, SAMPLED)))
    return LimitSurrogate(
        np.zeros(SAMPLED),
        np.eye(SAMPLED),
        np.zeros(LIMITS),
        np.zeros((LIMITS, SAMPLED)),
        np.zeros((LIMITS, SAMPLED)),
        sigma,
        np.zeros((POINTS, LIMITS)),
        np.zeros(1),
    )


@inline_kernel
def _weight(plant: Plant) -> float:
    """Weight of the nominal vehicle [N]."""
    return plant.vehicle.m * GRAVITY


@kernel
def _evaluate(plant: Plant, x: FloatArray, out: FloatArray) -> None:
    """Limits (LIMITS,) at a point as `transformed_limits`; NaN where the soil does not carry the vehicle."""
    transform_limits(limits_at(plant_of_point(plant, x), (0.0, 0.0)), _weight(plant), out)


@kernel
def transform_limits(held: SoilHolds, weight: float, out: FloatArray) -> None:
    """Limits (LIMITS,) on the scale where the belief is normal; ``weight`` [N] of the nominal vehicle."""
    for i, value in enumerate(held):
        out[i] = value
        if LOGARITHMIC[i]:
            unit = weight if SHIFT[i] > 0.0 else 1.0
            inside = min(max(value / unit + SHIFT[i], _SMALLEST[i]), _LARGEST[i])
            out[i] = math.nan if math.isnan(value) else math.log(unit * inside)


@kernel
def least_sd(k: int, centre: float) -> float:
    """Least standard deviation of limit ``k`` about a mean on the scale where the belief is normal."""
    return _LEAST_SD + (_RESOLUTION[k] * math.exp(-centre) if LOGARITHMIC[k] else 0.0)


@kernel
def _adopt(surrogate: LimitSurrogate) -> None:
    """Make the evaluated reference the one in use, unless its mean does not carry the vehicle."""
    sigma, found = surrogate.next, surrogate.found
    if not math.isfinite(found[0, 4]):
        return
    surrogate.mean[:], surrogate.factor[:] = sigma.points[0], sigma.factor
    surrogate.value[:] = found[0]
    for k in range(LIMITS):
        for i in range(SAMPLED):
            ahead, opposite = found[1 + i, k], found[1 + SAMPLED + i, k]
            middle, scale = found[0, k], sigma.scales[i]
            # Where one side does not carry the vehicle, the other one has the slope.
            if not math.isfinite(ahead):
                ahead = 2.0 * middle - opposite
            if not math.isfinite(opposite):
                opposite = 2.0 * middle - ahead
            if not math.isfinite(ahead):
                ahead = opposite = middle
            surrogate.slope[k, i] = (ahead - opposite) / (2.0 * scale)
            surrogate.bend[k, i] = (ahead + opposite - 2.0 * middle) / (scale * scale)


@kernel
def refresh_surrogate(
    surrogate: LimitSurrogate, packed: PackedPlant, mean: FloatArray, cov: FloatArray, points: int
) -> bool:
    """Evaluate up to ``points`` more points of the next reference; whether a new one is in use now."""
    plant = unpack(packed)
    for _ in range(points):
        if surrogate.done[0] == 0.0:
            place_sigma_points(mean, cov, surrogate.next)
        i = int(surrogate.done[0])
        _evaluate(plant, surrogate.next.points[i], surrogate.found[i])
        surrogate.done[0] += 1.0
        if i == POINTS - 1:
            surrogate.done[0] = 0.0
            _adopt(surrogate)
            return True
    return False


#: References of the last priors: episodes that start from one prior share it.
_references: dict[bytes, list[FloatArray]] = {}
_REFERENCES = 16


def whole_surrogate(
    surrogate: LimitSurrogate, packed: PackedPlant, mean: FloatArray, cov: FloatArray
) -> None:
    """Evaluate a reference at once, or take that of the same plant and belief."""
    effects = np.empty(0) if packed.effects is None else packed.effects
    parts = packed.numbers, packed.patches, effects, mean, cov
    key = b"|".join(part.tobytes() for part in parts) + repr(packed.structure).encode()
    in_use = surrogate.mean, surrogate.factor, surrogate.value, surrogate.slope, surrogate.bend
    surrogate.done[0] = 0.0
    if key not in _references:
        refresh_surrogate(surrogate, packed, mean, cov, POINTS)
        if len(_references) >= _REFERENCES:
            _references.clear()
        _references[key] = [array.copy() for array in in_use]
    for array, kept in zip(in_use, _references[key], strict=True):
        array[:] = kept


@kernel
def moved_since(surrogate: LimitSurrogate, mean: FloatArray, cov: FloatArray) -> float:
    """How far a belief is from the reference, in the columns of its factor: of a mean, or of a deviation."""
    L, u, most = surrogate.factor, np.empty(SAMPLED), 0.0
    column = np.empty(SAMPLED)
    for i in range(SAMPLED):
        total = mean[i] - surrogate.mean[i]
        for j in range(i):
            total -= L[i, j] * u[j]
        u[i] = total / L[i, i]
        most = max(most, abs(u[i]))
    for k in range(SAMPLED):
        # Row k of the inverse of L, and the variance that the belief has along it.
        for i in range(k, -1, -1):
            total = 1.0 if i == k else 0.0
            for j in range(i + 1, k + 1):
                total -= column[j] * L[j, i]
            column[i] = total / L[i, i]
        variance = 0.0
        for i in range(k + 1):
            for j in range(k + 1):
                variance += column[i] * cov[i, j] * column[j]
        most = max(most, abs(math.sqrt(max(variance, 0.0)) - 1.0))
    return most


@kernel
def _with_slopes(L: FloatArray, slope: FloatArray, cov: FloatArray, out: FloatArray) -> None:
    """Covariance (2,) with the slopes of the ground of a limit with ``slope`` (SAMPLED,) per column of L."""
    for j in range(2):
        out[j], u = 0.0, np.empty(SAMPLED)
        for i in range(SAMPLED):
            total = cov[i, GRADE + j]
            for k in range(i):
                total -= L[i, k] * u[k]
            u[i] = total / L[i, i]
            out[j] += slope[i] * u[i]


@kernel
def limits_of_belief(
    surrogate: LimitSurrogate,
    mean: FloatArray,
    cov: FloatArray,
    out_mean: FloatArray,
    out_sd: FloatArray,
    out_slope: FloatArray,
) -> None:
    """Mean and standard deviation (LIMITS,) of the limits, of the logarithm of the positive ones.

    ``out_slope`` (LIMITS, 2) : their covariances with the slopes of the ground.

    Of parabolas of a normal u with the mean m and the covariance S: value + slope m + bend (m^2 + S_ii)/2,
    and the variance g S g + sum (bend S_ii)^2/2 with g = slope + bend m, the squares of different columns
    taken as independent.
    """
    u, slope = np.empty(SAMPLED), np.empty(SAMPLED)
    L = surrogate.factor
    for i in range(SAMPLED):
        total = mean[i] - surrogate.mean[i]
        for j in range(i):
            total -= L[i, j] * u[j]
        u[i] = total / L[i, i]
    # S = L^-1 P L^-T, by forward substitution on both sides.
    half, S = np.empty((SAMPLED, SAMPLED)), np.empty((SAMPLED, SAMPLED))
    for k in range(SAMPLED):
        for i in range(SAMPLED):
            total = cov[i, k]
            for j in range(i):
                total -= L[i, j] * half[j, k]
            half[i, k] = total / L[i, i]
    for k in range(SAMPLED):
        for i in range(SAMPLED):
            total = half[k, i]
            for j in range(i):
                total -= L[i, j] * S[k, j]
            S[k, i] = total / L[i, i]
    for k in range(LIMITS):
        centre, variance = surrogate.value[k], 0.0
        for i in range(SAMPLED):
            bend = surrogate.bend[k, i]
            slope[i] = surrogate.slope[k, i] + bend * u[i]
            centre += surrogate.slope[k, i] * u[i] + 0.5 * bend * (u[i] * u[i] + S[i, i])
            variance += 0.5 * (bend * S[i, i]) ** 2
        for i in range(SAMPLED):
            for j in range(SAMPLED):
                variance += slope[i] * S[i, j] * slope[j]
        out_mean[k], out_sd[k] = centre, math.hypot(math.sqrt(max(variance, 0.0)), least_sd(k, centre))
        _with_slopes(L, slope, cov, out_slope[k])
    # Pull hardly changes around its best slip, and the search for it ends there or at the highest slip.
    out_mean[2] = min(max(out_mean[2], 0.0), HIGHEST_SLIP)
    out_sd[2] = max(out_sd[2], _SLIP_SD)


@kernel
def sharpen(
    sd: FloatArray, prior_sd: FloatArray, information: FloatArray, spared: FloatArray, fresh: float
) -> None:
    """Count the information beyond a prior's ``information`` times, number by number (K,), in place.

    A likelihood to a power (tempering), for what is nearly normal: 1/sd^2 = 1/prior^2 + information x gained.
    ``spared`` (K,) is the part of the variances of which this is not so. Of all that is learnt the share
    ``fresh`` counts.
    """
    for k in range(sd.shape[0]):
        apart = min(spared[k], 0.999 * sd[k] * sd[k])
        known, own = 1.0 / (prior_sd[k] * prior_sd[k]), sd[k] * sd[k] - apart
        gained = 1.0 / own - known
        if gained > 0.0 and math.isfinite(prior_sd[k]):
            own = 1.0 / (known + fresh * information[k] * gained)
            sd[k] = math.sqrt(own + apart / fresh)


@kernel
def share_of_slope(shared: FloatArray, cov: FloatArray) -> float:
    """Variance of a number that knowing the slopes of the ground would take away.

    ``shared`` (2,) : its covariances with them; ``cov`` (SIZE, SIZE) : of the belief.
    """
    first, second, both = cov[GRADE, GRADE], cov[GRADE + 1, GRADE + 1], cov[GRADE, GRADE + 1]
    determinant = first * second - both * both
    if not determinant > 0.0:
        return 0.0
    square = shared[0] * shared[0] * second + shared[1] * shared[1] * first
    share: float = max((square - 2.0 * shared[0] * shared[1] * both) / determinant, 0.0)
    return share


@kernel
def sharpened_limits(
    surrogate: LimitSurrogate,
    mean: FloatArray,
    cov: FloatArray,
    out: tuple[FloatArray, FloatArray, FloatArray],
    prior_sd: FloatArray,
    information: FloatArray,
    fresh: float,
) -> None:
    """`limits_of_belief` into ``out``, and `sharpen` but for what the slopes of the ground leave unknown."""
    means, sds, shared = out
    limits_of_belief(surrogate, mean, cov, means, sds, shared)
    spared = np.empty(LIMITS)
    for k in range(LIMITS):
        spared[k] = share_of_slope(shared[k], cov)
    sharpen(sds, prior_sd, information, spared, fresh)
