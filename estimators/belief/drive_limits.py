"""What the soil holds by a belief fitted to a drive, and whether its model is adequate.

A fit to a drive is a point and a normal approximation around it. The posterior is a bent ridge, more
cohesion with less friction, along which the losses are equal within one, so the approximation is too narrow:
its standard deviations are widened by what tuning drives ask for, and the limits follow it as far as that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.belief.drive_fit import DriveFit
from estimators.belief.drive_numbers import DRIVE_NUMBERS, STEPS, bounds_of_drive, plant_of_drive
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
#: Least standard deviation of a limit, or of n: beyond its range a limit does not move.
_LEAST_SD = 1e-3


@dataclass(frozen=True, kw_only=True)
class FittedLimitSettings:
    """Chosen on tuning drives over whole soils with all nuisances; each has a test that it matters."""

    #: Factor of the standard deviations of the normal approximation: 95 % of the intervals hold then.
    wider: float = 2.0
    #: Largest factor on the errors of a typical drive, and on the usual scatter of the soil, that a fit may
    #: need and still be valid: wrong laws of the wheel need more.
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
    """What the soil holds by a fit to a drive of the vehicle ``plant``.

    The limits are taken as parabolas through pairs of points along the columns L_i of the widened
    covariance's Cholesky factor: mean f + sum bend_i / 2, variance sum slope_i^2 + sum bend_i^2 / 2, as
    `limits_of_belief` has them.
    """
    settings = settings or FittedLimitSettings()
    own = len(DRIVE_NUMBERS)
    factor = settings.wider * np.linalg.cholesky(fit.covariance[:own, :own])
    low, high = bounds_of_drive()
    here, ahead, opposite = (
        np.array([_limits_and_n(plant, np.clip(fit.numbers[:own] + move, low, high)) for move in moves])
        for moves in (np.zeros((1, own)), factor.T, -factor.T)
    )
    # Where one side does not carry the vehicle, the other one has the slope.
    ahead = np.where(np.isfinite(ahead), ahead, 2.0 * here - opposite)
    opposite = np.where(np.isfinite(opposite), opposite, 2.0 * here - ahead)
    slope, bend = 0.5 * (ahead - opposite), ahead + opposite - 2.0 * here
    mean = here[0] + 0.5 * bend.sum(axis=0)
    sd = np.maximum(np.sqrt((slope**2 + 0.5 * bend**2).sum(axis=0)), _LEAST_SD)
    sound = bool(np.isfinite(mean).all() and np.isfinite(sd).all())
    return FittedLimits(
        centre=mean[:LIMITS],
        sd=sd[:LIMITS],
        n=(float(mean[-1]), float(sd[-1])),
        valid=sound and float(fit.scales.max()) <= settings.adequate,
    )


def _limits_and_n(plant: Plant, numbers: FloatArray) -> FloatArray:
    """(7,) limits, then n."""
    return np.append(drive_limits(plant, numbers), numbers[N])
