"""What the soil holds by a belief fitted to a drive, and whether its model is adequate.

Limits are taken at samples of the belief (`drive_posterior`): they bend along the ridge of soils that explain
a drive about as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from estimators.belief.drive_errors import GROUPS
from estimators.belief.drive_fit import DriveFit
from estimators.belief.drive_numbers import DRIVE_NUMBERS, plant_of_drive
from estimators.filters.soil_belief_holds import LIMITS, least_sd, transform_limits
from estimators.filters.soil_belief_points import N
from estimators.numerics.importance_sampling import WeightedSamples
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant
from offroad_env.simulation.soil_holds import what_soil_holds

__all__ = ["FittedLimitSettings", "FittedLimits", "drive_limits", "fitted_limits", "limit_slopes"]

#: Draws for the slopes of limits, a power of two.
_DRAWS = 512
#: Least standard deviation of n.
_LEAST_SD = 1e-3
#: Weights below this share of the mean one do not count: their limits need not be found.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, kw_only=True)
class FittedLimitSettings:
    """Chosen on tuning drives over whole soils with all nuisances."""

    #: Largest factor on the errors of a typical road, and on the usual scatter of the soil, that a fit may
    #: need and still be valid.
    adequate: float = 3.0
    #: The same of the sideways motion, where wrong laws of the wheel show first: rough roads need larger
    #: factors of the other errors, too.
    adequate_sideways: float = 1.7

    def __post_init__(self) -> None:
        for name in ("adequate", "adequate_sideways"):
            if not getattr(self, name) > 0.0:
                raise InvalidParameter(f"{name} must be > 0, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class FittedLimits:
    """Belief about the limits in the order of `SoilHolds`, of the logarithm of positive ones, and about n."""

    centre: FloatArray  #: (6,)
    sd: FloatArray  #: (6,)
    n: tuple[float, float]  #: mean and standard deviation [-]
    valid: bool  #: the model explains the drive about as well as the true one explains a typical drive


def drive_limits(plant: Plant, numbers: FloatArray) -> FloatArray:
    """(6,) limits, on the scale on which a belief is normal, of a vehicle with ``numbers`` (10,)."""
    found = np.zeros(LIMITS)
    transform_limits(what_soil_holds(plant_of_drive(plant, numbers)), plant.vehicle.m * GRAVITY, found)
    return found


def limit_slopes(plant: Plant, numbers: FloatArray, covariance: FloatArray) -> FloatArray:
    """(7, 10) derivatives of the limits, then of n, by the numbers of a drive, averaged near ``numbers``.

    Averaged over a normal distribution with ``covariance`` (10, 10), as the bound of a function of uncertain
    numbers needs it: by Stein's lemma the regression of the limits on 512 quasi-random draws. A limit may
    bend within the distribution, where the best slip reaches the end of its range. Draws whose limits do not
    exist are left out.

    Raises
    ------
    SolverFailure
        Where half of the draws have none.
    """
    root = np.linalg.cholesky(covariance)
    draws = qmc.MultivariateNormalQMC(np.zeros(len(numbers)), rng=np.random.default_rng(0)).random(_DRAWS)
    rows = np.array([_limits_and_n(plant, numbers + root @ draw) for draw in draws])
    sound = np.isfinite(rows).all(axis=1)
    if 2 * sound.sum() < _DRAWS:
        raise SolverFailure("the limits do not exist for half of the soils that the drive leaves open")
    design = np.column_stack([np.ones(sound.sum()), draws[sound]])
    by_draw = np.linalg.lstsq(design, rows[sound])[0][1:]
    slopes: FloatArray = np.linalg.solve(root.T, by_draw).T
    return slopes


def fitted_limits(
    plant: Plant, fit: DriveFit, posterior: WeightedSamples, settings: FittedLimitSettings | None = None
) -> FittedLimits:
    """What the soil holds by the samples of a belief fitted to a drive of the vehicle ``plant``."""
    settings = settings or FittedLimitSettings()
    counting = posterior.weights > _NEGLIGIBLE / len(posterior.weights)
    numbers, weights = posterior.values[counting], posterior.weights[counting]
    rest = np.zeros(len(DRIVE_NUMBERS) - numbers.shape[1])  # lag and drag: no limit depends on them
    rows = np.array([_limits_and_n(plant, np.append(row, rest)) for row in numbers])
    sound = np.isfinite(rows).all(axis=1)
    if not sound.any():
        nothing = np.full(LIMITS, np.nan)
        return FittedLimits(centre=nothing, sd=nothing, n=(np.nan, np.nan), valid=False)
    rows, weights = rows[sound], weights[sound] / weights[sound].sum()
    mean = weights @ rows
    sd = np.sqrt(weights @ (rows - mean) ** 2)
    return FittedLimits(
        centre=mean[:LIMITS],
        sd=np.hypot(sd[:LIMITS], [least_sd(k, mean[k]) for k in range(LIMITS)]),
        n=(float(mean[-1]), max(float(sd[-1]), _LEAST_SD)),
        valid=_is_adequate(fit.scales, settings),
    )


def _is_adequate(scales: FloatArray, settings: FittedLimitSettings) -> bool:
    sideways = float(scales[GROUPS.index("sideways")])
    return float(scales.max()) <= settings.adequate and sideways <= settings.adequate_sideways


def _limits_and_n(plant: Plant, numbers: FloatArray) -> FloatArray:
    """(7,) limits, then n."""
    return np.append(drive_limits(plant, numbers), numbers[N])
