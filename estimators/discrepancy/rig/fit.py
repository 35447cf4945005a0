"""The model fitted to the trials of a rig, and tested on others."""

from __future__ import annotations

from dataclasses import replace

from estimators.discrepancy.checks.holdout_gain import Held
from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.parameters import Point
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.rig.repeat_noise import RigNoise
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from offroad_env.errors import SolverFailure

__all__ = ["fit_rig", "held_out_trials"]


#: Starts of n, beyond the stated one.
_STARTS = (0.0, -0.3, 0.4)


def fit_rig(run: RigModel, *, white: bool = False) -> FitResult:
    """The nominal model with n fitted, and the noise.

    From several starts: a wheel that the soil ceases to support sinks by a step, and holds a descent there.

    Parameters
    ----------
    white
        Take all scatter for that of repeats: only to show what that does.

    Raises
    ------
    SolverFailure
        When a contact has no solution.
    """
    problem = LeastSquaresProblem([run])
    found, failure = [], SolverFailure(f"{run.log.name}: the contact of a trial has no solution")
    for away in _STARTS:
        begun = problem.begun(problem.stated())
        try:
            found.append(_fitted(problem, replace(begun, nuisances=begun.nuisances + away), white=white))
        except SolverFailure as error:
            failure = error
    if not found:
        raise failure
    return min(found, key=lambda fit: fit.minus_log_likelihood)


def _fitted(problem: LeastSquaresProblem, start: Point, *, white: bool) -> FitResult:
    """From one start."""
    run = trials_of(problem.runs)
    first = Linearisation.at(problem, start)
    noise = RigNoise.of_trials(run)
    # Before the first descent one parameter is spent: n.
    freedom = {name: len(first.point.shared) * len(own) / problem.rows for name, own in noise.groups.items()}
    noise = noise.learned(first.residual, freedom, white=white)
    return settled(FitResult(linearisation=first, jacobian=Jacobian(), noise=noise, white=white))


def held_out_trials(fit: FitResult, run: RigModel, noise: RigNoise | None = None) -> Held:
    """The model of ``fit`` on other trials, nothing fitted.

    Parameters
    ----------
    noise
        Scatter of another fit; default: that of the residuals there.

    Raises
    ------
    SolverFailure
        When a contact has no solution there.
    """
    # The same wheel: under the laws that the fit gives it.
    run = run.with_structure(trials_of(fit.runs).structure)
    problem = LeastSquaresProblem([run])
    there = Linearisation.at(problem, problem.begun(fit.point))
    own = RigNoise.of_trials(run)
    own = own.learned(there.residual, {}) if noise is None else replace(own, channels=noise.channels)
    other = FitResult(linearisation=there, jacobian=Jacobian(), noise=own)
    return Held(fit=other, residual=other.residual, cost=other.minus_log_likelihood)
