"""A belief fitted to a whole drive at once: soil and vehicle that explain all samples together.

The drive is simulated open loop from its start under the commands (`drive_samples`), and the numbers
(`drive_numbers`) that are most probable given all samples are found by the trust-region method of
`scipy.optimize.least_squares`. Errors of the sensors and of the model that do not depend on them are
integrated out (`drive_errors`). A fit to ten seconds takes about two seconds of one core: it is a method to
analyse a drive, or to run beside one, where `online_soil_belief` is the one to run in a control loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from estimators.belief.drive_errors import GROUPS
from estimators.belief.drive_numbers import plant_of_drive
from estimators.belief.drive_problem import DriveProblem, Surroundings
from estimators.belief.drive_samples import DriveSamples
from offroad_env.errors import SolverFailure
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant

__all__ = ["LEAST_SCATTER", "DriveFit", "drive_bound", "fit_drive", "search_drive"]

#: Evaluations of the search with the factors of the model's errors first taken, then with those found.
_EVALUATIONS = (6, 16)
#: Factors of the first search: the model is likely to be wrong where the numbers still are.
_FIRST_SCALES = 1.5
#: Relative reduction of the loss at which a search ends.
_ENOUGH = 1e-3
#: Share of the range by which a search starts inside of it.
_INSIDE = 1e-6
#: Half of the range in which a number is held.
_HELD = 1e-3
#: Draws from the prior that are tried as starts beside its middle, and searches from the best of them.
_DRAWS, _SEED, _STARTS = 12, 0, 2


#: Least factor of the scatter of the soil. A drive tells how much soil scatters from metre to metre; what
#: scatters over the whole drive looks like another soil, and is not less certain to be there.
LEAST_SCATTER = 0.8


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


def search_drive(
    problem: DriveProblem, numbers: FloatArray, evaluations: int, held: Mapping[int, float] | None = None
) -> Any:
    """What `scipy.optimize.least_squares` finds from there; ``held``: numbers that keep a value, by index."""
    low, high = problem.low.copy(), problem.high.copy()
    for i, value in (held or {}).items():
        low[i], high[i] = value - _HELD, value + _HELD
    inner = _INSIDE * (high - low)
    return least_squares(
        problem.residuals,
        np.clip(numbers, low + inner, high - inner),
        problem.slopes,
        bounds=(low, high),
        x_scale=np.diag(problem.prior_factor),
        ftol=_ENOUGH,
        xtol=None,
        gtol=None,
        max_nfev=evaluations,
    )


def _starts(problem: DriveProblem, earlier: FloatArray | None) -> list[FloatArray]:
    """Where searches start: ``earlier`` (P,), or the best of the prior's middle and draws from it.

    Raises
    ------
    SolverFailure
        Where the vehicle drives on none.
    """
    rng, prior = np.random.default_rng(_SEED), problem.prior
    drawn = prior + rng.standard_normal((_DRAWS, len(prior))) @ problem.prior_factor.T
    if earlier is not None and problem.errors(earlier) is not None:
        return [earlier]
    losses = []
    for row in (prior, *drawn):
        inside = np.clip(row, problem.low, problem.high)
        if problem.errors(inside) is not None:
            losses.append((float((problem.residuals(inside) ** 2).sum()), inside))
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
    problem = DriveProblem(plant, samples, surroundings)
    errors, scales = problem.model_errors(), np.full(len(GROUPS), _FIRST_SCALES)
    if earlier is not None and problem.errors(earlier.numbers) is not None:
        errors, scales = problem.model_errors(earlier.numbers), earlier.scales
    problem.whiten = errors.factor(scales)
    starts = _starts(problem, None if earlier is None else earlier.numbers)
    first, second = _EVALUATIONS
    numbers = min((search_drive(problem, start, first) for start in starts), key=lambda found: found.cost).x
    left = problem.errors(numbers)
    if left is not None:
        errors = problem.model_errors(numbers)
        scales = errors.scales(left, problem.raw_slopes(numbers), problem.information)
        if problem.surroundings.scatter is not None:
            scales[-1] = max(scales[-1], LEAST_SCATTER)
        problem.whiten = errors.factor(scales)
    found = search_drive(problem, numbers, second)
    return DriveFit(
        numbers=found.x,
        covariance=np.linalg.inv(found.jac.T @ found.jac),
        scales=scales,
        loss=float(found.cost),
        plant=plant_of_drive(plant, found.x),
    )


def drive_bound(
    plant: Plant, samples: DriveSamples, numbers: FloatArray, surroundings: Surroundings
) -> FloatArray:
    """(10, 10) least covariance of an estimate from a drive, given the prior, at the true ``numbers`` (10,).

    The posterior Cramer-Rao bound (H. L. Van Trees, Detection, Estimation, and Modulation Theory I, 1968,
    section 2.4) with the information taken at the truth: noise and constant errors of the sensors are
    unknown. So is the slope of the ground towards each of two axes, which is that of ``plant``, where
    ``surroundings.grade`` is above zero, and so are road and scatter of the soil, of the usual size, where
    ``surroundings.scatter`` is given.

    Raises
    ------
    SolverFailure
        Where the vehicle gets stuck.
    """
    problem = DriveProblem(plant, samples, surroundings)
    there = np.append(numbers, np.zeros(len(problem.prior) - len(numbers)))
    if problem.errors(there) is None:
        raise SolverFailure("the vehicle gets stuck on this soil")
    errors = problem.model_errors(there)
    unknown = 0.0 if surroundings.scatter is None else 1.0
    problem.whiten = errors.factor(np.full(len(errors.groups), unknown))
    J = problem.slopes(there)
    found: FloatArray = np.linalg.inv(J.T @ J).astype(np.float64)
    return found[: len(numbers), : len(numbers)]
