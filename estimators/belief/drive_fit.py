"""A belief fitted to a whole drive at once: soil and vehicle that explain all samples together.

The drive is simulated open loop from its start under the commands (`drive_samples`), and the numbers
(`drive_numbers`) that are most probable given all samples are found by the trust-region method of
`scipy.optimize.least_squares`. Errors of the sensors and of the model that do not depend on them are
integrated out (`drive_errors`). A fit to ten seconds takes about two seconds of one core: it is a method to
analyse a drive, or to run beside one, where `online_soil_belief` is the one to run in a control loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from estimators.belief.drive_errors import GROUPS, DriveErrors, errors_of
from estimators.belief.drive_numbers import bounds_of_drive, plant_of_drive, prior_of_drive, steps_of_drive
from estimators.belief.drive_samples import COMPARED, DriveSamples, simulated_drive
from estimators.belief.drive_scatter import scatter_covariance
from offroad_env.errors import InvalidParameter, SolverFailure
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant
from offroad_env.world.natural_soil import SoilSpread

__all__ = ["DriveFit", "Surroundings", "drive_bound", "fit_drive"]

#: Evaluations of the search with the factors of the model's errors first taken, then with those found.
_EVALUATIONS = (5, 8)
#: Factors of the first search: the model is likely to be wrong where the numbers still are.
_FIRST_SCALES = 1.5
#: Relative reduction of the loss at which a search ends.
_ENOUGH = 1e-3
#: Share of the range by which a search starts inside of it.
_INSIDE = 1e-6
#: Residual that every mean counts with where the soil does not carry the vehicle, in standard deviations.
_STUCK = 30.0
#: Draws from the prior that are tried as starts beside its middle, and searches from the best of them.
_DRAWS, _SEED, _STARTS = 12, 0, 2


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What is unknown of the ground beside soil and vehicle."""

    grade: float = 0.0  #: standard deviation of its slope towards each of two axes [-]; 0: it is known
    scatter: SoilSpread | None = None  #: of the soil in space, up to a factor that each drive tells

    def __post_init__(self) -> None:
        if not 0.0 <= self.grade < 1.0:
            raise InvalidParameter(f"grade must be in [0, 1), got {self.grade}")


@dataclass(frozen=True, kw_only=True)
class DriveFit:
    """Normal approximation of the belief after a drive."""

    #: (P,) most probable, as `DRIVE_NUMBERS`; where the slope of the ground is unknown, its two follow.
    numbers: FloatArray
    covariance: FloatArray  #: (P, P)
    #: (G,) errors of the model over those of a typical drive, as `drive_errors.GROUPS`; where the soil
    #: scatters, the factor of its scatter follows.
    scales: FloatArray
    loss: float  #: negative log-posterior up to a constant
    plant: Plant  #: vehicle on soil with these numbers


class _Problem:
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
        for i, step in enumerate(steps_of_drive(len(numbers))):
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
        errors = errors_of(self.samples, self.counts, self.speed)
        spread = self.surroundings.scatter
        if spread is None or numbers is None:
            return errors
        scatter = scatter_covariance(self.raw_slopes(numbers), numbers, self.speed, spread)
        return replace(errors, groups=np.concatenate([errors.groups, scatter[None]]))

    def search(self, numbers: FloatArray, evaluations: int) -> Any:
        """What `least_squares` finds from there."""
        inner = _INSIDE * (self.high - self.low)
        return least_squares(
            self.residuals,
            np.clip(numbers, self.low + inner, self.high - inner),
            self.slopes,
            bounds=(self.low, self.high),
            x_scale=np.diag(self.prior_factor),
            ftol=_ENOUGH,
            xtol=None,
            gtol=None,
            max_nfev=evaluations,
        )

    def starts(self, earlier: FloatArray | None) -> list[FloatArray]:
        """Where searches start: ``earlier`` (P,), or the best of the prior's middle and draws from it.

        Raises
        ------
        SolverFailure
            Where the vehicle drives on none.
        """
        rng = np.random.default_rng(_SEED)
        drawn = self.prior + rng.standard_normal((_DRAWS, len(self.prior))) @ self.prior_factor.T
        if earlier is not None and self.errors(earlier) is not None:
            return [earlier]
        losses = []
        for row in (self.prior, *drawn):
            inside = np.clip(row, self.low, self.high)
            if self.errors(inside) is not None:
                losses.append((float((self.residuals(inside) ** 2).sum()), inside))
        if not losses:
            raise SolverFailure(f"the vehicle drives on none of {_DRAWS} soils of the population")
        return [row for _, row in sorted(losses, key=lambda pair: pair[0])[:_STARTS]]


def fit_drive(
    plant: Plant,
    samples: DriveSamples,
    earlier: DriveFit | None = None,
    surroundings: Surroundings | None = None,
) -> DriveFit:
    """The numbers of soil and vehicle that are most probable after a drive.

    Parameters
    ----------
    plant : Plant
        The vehicle's model of itself, its wheels (structure, tyre) and the ground. Of its soil only how the
        contact angles grow with slip is used.
    samples : DriveSamples
        Commands and sensors from the start until now.
    earlier : DriveFit, optional
        A fit to the first part of the same drive in the same surroundings, from which the search goes on.
    surroundings : Surroundings, optional
        What is unknown beside soil and vehicle; default: nothing.

    Raises
    ------
    InvalidParameter
        Where a sensor misses samples.
    SolverFailure
        Where the vehicle drives on no soil of the population.
    """
    problem = _Problem(plant, samples, surroundings)
    errors, scales = problem.model_errors(), np.full(len(GROUPS), _FIRST_SCALES)
    if earlier is not None and problem.errors(earlier.numbers) is not None:
        errors, scales = problem.model_errors(earlier.numbers), earlier.scales
    problem.whiten = errors.factor(scales)
    starts = problem.starts(None if earlier is None else earlier.numbers)
    first, second = _EVALUATIONS
    numbers = min((problem.search(start, first) for start in starts), key=lambda found: found.cost).x
    left = problem.errors(numbers)
    if left is not None:
        errors = problem.model_errors(numbers)
        scales = errors.scales(left, problem.raw_slopes(numbers), problem.information)
        problem.whiten = errors.factor(scales)
    found = problem.search(numbers, second)
    return DriveFit(
        numbers=found.x,
        covariance=np.linalg.inv(found.jac.T @ found.jac),
        scales=scales,
        loss=float(found.cost),
        plant=plant_of_drive(plant, found.x),
    )


def drive_bound(
    plant: Plant, samples: DriveSamples, numbers: FloatArray, scales: FloatArray, grade: float = 0.0
) -> FloatArray:
    """(10, 10) least covariance of an estimate from a drive, given the prior, at the true ``numbers`` (10,).

    The posterior Cramer-Rao bound (H. L. Van Trees, Detection, Estimation, and Modulation Theory I, 1968,
    section 2.4) with the information taken at the truth: noise, constant errors of the sensors and, with
    factors ``scales`` (3,) above zero, errors of the model are unknown. So is the slope of the ground towards
    each of two axes, which is that of ``plant``, where its standard deviation ``grade`` [-] is above zero.

    Raises
    ------
    SolverFailure
        Where the vehicle gets stuck.
    """
    problem = _Problem(plant, samples, Surroundings(grade=grade))
    there = np.append(numbers, np.zeros(len(problem.prior) - len(numbers)))
    if problem.errors(there) is None:
        raise SolverFailure("the vehicle gets stuck on this soil")
    problem.whiten = problem.model_errors().factor(scales)
    J = problem.slopes(there)
    found: FloatArray = np.linalg.inv(J.T @ J).astype(np.float64)
    return found[: len(numbers), : len(numbers)]
