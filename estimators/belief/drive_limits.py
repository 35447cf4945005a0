"""What the soil holds by a belief fitted to a drive, and whether its model is adequate.

A fit to a drive is a point and a normal approximation around it. Soil that scatters acts on all channels
together, and the posterior is a bent ridge, so the approximation is too narrow: its standard deviations are
widened by what tuning drives ask for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimators.belief.drive_errors import GROUPS
from estimators.belief.drive_fit import DriveFit
from estimators.belief.drive_numbers import DRIVE_NUMBERS, STEPS, plant_of_drive
from estimators.filters.soil_belief_holds import LIMITS, transform_limits
from estimators.filters.soil_belief_points import N
from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant
from offroad_env.simulation.soil_holds import what_soil_holds

__all__ = ["FittedLimitSettings", "FittedLimits", "drive_limits", "fitted_limits", "limit_slopes"]

#: Share of the steps of `STEPS` over which limits are differentiated.
_SHARE = 0.2


@dataclass(frozen=True, kw_only=True)
class FittedLimitSettings:
    """Chosen on tuning drives over whole soils with all nuisances; each has a test that it matters."""

    #: Factor of the standard deviations of the normal approximation: 95 % of the intervals hold then.
    wider: float = 1.0
    #: Largest factor on the errors of a typical drive that a fit may need and still be valid: wrong laws of
    #: the wheel need more.
    adequate: float = 1.3

    def __post_init__(self) -> None:
        for name in ("wider", "adequate"):
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


def limit_slopes(plant: Plant, numbers: FloatArray) -> FloatArray:
    """(6, 10) derivatives of the limits by the numbers of a drive."""
    columns = [
        (drive_limits(plant, numbers + step) - drive_limits(plant, numbers - step)) / (2.0 * step[i])
        for i, step in enumerate(_SHARE * np.diag(STEPS))
    ]
    return np.array(columns).T


def fitted_limits(plant: Plant, fit: DriveFit, settings: FittedLimitSettings | None = None) -> FittedLimits:
    """What the soil holds by a fit to a drive of the vehicle ``plant``."""
    settings = settings or FittedLimitSettings()
    own = len(DRIVE_NUMBERS)
    numbers, covariance = fit.numbers[:own], settings.wider**2 * fit.covariance[:own, :own]
    slopes, centre = limit_slopes(plant, numbers), drive_limits(plant, numbers)
    sd = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
    sound = bool(np.isfinite(centre).all() and np.isfinite(sd).all())
    return FittedLimits(
        centre=centre,
        sd=sd,
        n=(float(numbers[N]), math.sqrt(float(covariance[N, N]))),
        valid=sound and float(fit.scales[: len(GROUPS)].max()) <= settings.adequate,
    )
