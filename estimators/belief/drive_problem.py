"""Residuals of a drive that is simulated open loop, and their derivatives: what fits and samplers share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from estimators.belief.drive_errors import ROAD_ERRORS, DriveErrors, errors_of
from estimators.belief.drive_numbers import bounds_of_drive, plant_of_drive, prior_of_drive, steps_of_drive
from estimators.belief.drive_samples import COMPARED, DriveSamples, simulated_drive
from estimators.belief.drive_scatter import scatter_covariance
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import SoilSpread

__all__ = ["DriveProblem", "Surroundings"]

#: Share of the steps of `steps_of_drive` over which residuals are differentiated. Along the bent ridge of the
#: posterior they are so curved that whole steps end a search far from the optimum.
_FINE = 0.03
#: Residual that every mean counts with where the soil does not carry the vehicle, in standard deviations.
_STUCK = 30.0


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What is unknown of the ground beside soil and vehicle."""

    grade: float = 0.0  #: standard deviation of its slope towards each of two axes [-]; 0: it is known
    scatter: SoilSpread | None = None  #: of the soil in space, up to a factor that each drive tells

    def __post_init__(self) -> None:
        if not 0.0 <= self.grade < 1.0:
            raise InvalidParameter(f"grade must be in [0, 1), got {self.grade}")


class DriveProblem:
    """Residuals of a drive and their derivatives, in standard deviations."""

    def __init__(self, plant: Plant, samples: DriveSamples, surroundings: Surroundings | None = None) -> None:
        self.plant, self.samples = plant, samples
        self.surroundings = surroundings or Surroundings()
        self.means, self.counts = samples.measured()
        self.speed: FloatArray = np.maximum(self.means[:, COMPARED.index("speed")], 0.0)
        self.prior, cov = prior_of_drive(self.surroundings.grade)
        self.prior_factor = np.linalg.cholesky(cov)
        self.information: FloatArray = np.linalg.inv(cov).astype(np.float64)
        self.low, self.high = bounds_of_drive(len(self.prior))
        self.whiten = np.empty(0)
        self._raw: tuple[FloatArray, FloatArray] | None = None  # numbers, and derivatives there

    def errors(self, numbers: FloatArray) -> FloatArray | None:
        """(7 B,) measured less simulated, channel by channel; None where the vehicle gets stuck."""
        try:
            simulated = simulated_drive(plant_of_drive(self.plant, numbers), self.samples)
        except SolverFailure:
            return None
        found: FloatArray = (self.means - simulated).T.reshape(-1)
        return found

    def residuals(self, numbers: FloatArray) -> FloatArray:
        """(7 B + P,) white residuals, those of the prior last."""
        errors = self.errors(numbers)
        if errors is None:
            white = np.full(self.means.size, _STUCK)
        else:
            white = solve_triangular(self.whiten, errors, lower=True)
        return np.concatenate([white, self._from_prior(numbers)])

    def _from_prior(self, numbers: FloatArray) -> FloatArray:
        found: FloatArray = solve_triangular(self.prior_factor, numbers - self.prior, lower=True)
        return found

    def slopes(self, numbers: FloatArray) -> FloatArray:
        """(7 B + P, P) derivatives."""
        white = solve_triangular(self.whiten, self.raw_slopes(numbers), lower=True)
        own = solve_triangular(self.prior_factor, np.eye(len(numbers)), lower=True)
        return np.concatenate([white, own])

    def raw_slopes(self, numbers: FloatArray) -> FloatArray:
        """(7 B, P) derivatives of the errors; those of the last place are kept."""
        if self._raw is None or not np.array_equal(self._raw[0], numbers):
            self._raw = numbers.copy(), self._differences(numbers)
        return self._raw[1]

    def _differences(self, numbers: FloatArray) -> FloatArray:
        """The same by a difference to the side on which the vehicle gets on."""
        here, J = self.errors(numbers), np.zeros((self.means.size, len(numbers)))
        if here is None:
            return J
        for i, step in enumerate(_FINE * steps_of_drive(len(numbers))):
            for side in (step, -step):
                moved = numbers.copy()
                moved[i] += side
                inside = self.low[i] <= moved[i] <= self.high[i]
                errors = self.errors(moved) if inside else None
                if errors is not None:
                    J[:, i] = (errors - here) / side
                    break
        return J

    def model_errors(self, numbers: FloatArray | None = None) -> DriveErrors:
        """Covariances; with those of soil that scatters around ``numbers`` (P,), where it does."""
        spread = self.surroundings.scatter
        if spread is None or numbers is None:
            return errors_of(self.samples, self.counts, self.speed)
        errors = errors_of(self.samples, self.counts, self.speed, ROAD_ERRORS)
        try:
            scatter = scatter_covariance(plant_of_drive(self.plant, numbers), self.samples, spread)
        except SolverFailure:
            scatter = np.zeros((self.means.size, self.means.size))
        return replace(errors, groups=np.concatenate([errors.groups, scatter[None]]))
