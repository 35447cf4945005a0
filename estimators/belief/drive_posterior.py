"""Samples of the belief fitted to a drive, by adaptive importance sampling.

The posterior of a drive is a bent ridge, more cohesion with less friction, on which its most probable point
is not its middle: the ridge is wider where there is little cohesion. Soil and mass are therefore sampled,
with weights by simulations of the whole drive. Lag, drag and the slope of the ground, on which the drive
depends nearly linearly, are integrated out around the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from estimators.belief.drive_errors import DriveErrors
from estimators.belief.drive_fit import DriveFit, search_drive
from estimators.belief.drive_problem import DriveProblem, Surroundings
from estimators.belief.drive_samples import DriveSamples
from estimators.filters.soil_belief_points import LOG_C, SAMPLED
from estimators.numerics.importance_sampling import WeightedSamples, importance_samples
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant

__all__ = ["PosteriorSettings", "sample_drive"]


@dataclass(frozen=True, kw_only=True)
class PosteriorSettings:
    """Chosen on tuning drives over whole soils with all nuisances."""

    #: Factor of the standard deviations of the errors of the model. They are not quite as the likelihood has
    #: them, and a drive that seems to tell very much tells of them, too. Where the slope of the ground is
    #: unknown, of the sensors, too: constant errors of theirs, which are not either, pass for a slope.
    tempered: float = 1.5

    def __post_init__(self) -> None:
        if not self.tempered > 0.0:
            raise InvalidParameter(f"tempered must be > 0, got {self.tempered}")


#: Cohesion that is held to find the ends of the ridge, in standard deviations of the prior off its middle,
#: and evaluations of each search.
_ASIDE, _EVALUATIONS = 1.5, 8


class _Target:
    """Logarithm of the posterior of soil and mass, up to a constant."""

    def __init__(self, problem: DriveProblem, fit: DriveFit, errors: DriveErrors, tempered: float) -> None:
        self.problem, self.rest = problem, fit.numbers[SAMPLED:]
        own, others = problem.prior[:SAMPLED], problem.prior[SAMPLED:]
        prior = problem.prior_factor @ problem.prior_factor.T
        slopes = problem.raw_slopes(fit.numbers)[:, SAMPLED:]
        self.linear: FloatArray = slopes @ (others - self.rest)
        known = errors.sensors + slopes @ prior[SAMPLED:, SAMPLED:] @ slopes.T
        factor = 1.0 if problem.surroundings.grade == 0.0 else tempered
        covariance = factor**2 * known + tempered**2 * np.tensordot(fit.scales**2, errors.groups, 1)
        self.factor = np.linalg.cholesky(covariance)
        self.prior, self.prior_factor = own, np.linalg.cholesky(prior[:SAMPLED, :SAMPLED])

    def __call__(self, numbers: FloatArray) -> float:
        low, high = self.problem.low[:SAMPLED], self.problem.high[:SAMPLED]
        if (numbers < low).any() or (numbers > high).any():
            return -np.inf
        errors = self.problem.errors(np.concatenate([numbers, self.rest]))
        if errors is None:
            return -np.inf
        white = solve_triangular(self.factor, errors + self.linear, lower=True)
        own = solve_triangular(self.prior_factor, numbers - self.prior, lower=True)
        return -0.5 * float(white @ white + own @ own)


def sample_drive(
    plant: Plant,
    samples: DriveSamples,
    fit: DriveFit,
    surroundings: Surroundings | None = None,
    settings: PosteriorSettings | None = None,
) -> WeightedSamples:
    """Samples of soil and mass after a drive, around a fit to it; the same for the same arguments.

    Values are (N, 8): the first of `drive_numbers.DRIVE_NUMBERS`. Takes 400 to 1,600 simulations of the
    drive, two to six seconds of one core for ten seconds of driving.

    Parameters
    ----------
    plant, samples, surroundings
        As those of `fit_drive`, which found ``fit``.
    fit
        Where the search starts.
    settings
        See there.
    """
    settings = settings or PosteriorSettings()
    problem = DriveProblem(plant, samples, surroundings)
    errors = problem.model_errors(fit.numbers)
    problem.whiten = errors.factor(fit.scales)
    found = [(fit.numbers, fit.covariance), *_along_the_ridge(problem, fit)]
    starts = []
    for numbers, covariance in found:
        information = (np.linalg.inv(covariance) - problem.information) / settings.tempered**2
        near: FloatArray = np.linalg.inv(information + problem.information).astype(np.float64)
        starts.append((numbers[:SAMPLED], near[:SAMPLED, :SAMPLED]))
    return importance_samples(_Target(problem, fit, errors, settings.tempered), starts)


def _along_the_ridge(problem: DriveProblem, fit: DriveFit) -> list[tuple[FloatArray, FloatArray]]:
    """Most probable numbers (P,) with less and with more cohesion, and covariances, which leave that free."""
    found = []
    middle, sd = problem.prior[LOG_C], float(np.linalg.norm(problem.prior_factor[LOG_C]))
    for side in (-_ASIDE, _ASIDE):
        held = min(max(middle + side * sd, problem.low[LOG_C] + 0.1), problem.high[LOG_C] - 0.1)
        place = search_drive(problem, fit.numbers, _EVALUATIONS, {LOG_C: held})
        found.append((place.x, np.linalg.inv(place.jac.T @ place.jac)))
    return found
