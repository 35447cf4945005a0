"""The model fitted to the trials of a rig, and tested on others."""

from __future__ import annotations

from dataclasses import replace

from estimators.discrepancy.checks.holdout_gain import Held
from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.rig.repeat_noise import RigNoise
from estimators.discrepancy.rig.trial_model import RigModel

__all__ = ["fit_rig", "held_out_trials"]


def fit_rig(run: RigModel, *, white: bool = False) -> FitResult:
    """The nominal model with n fitted, and the noise.

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
    first = Linearisation.at(problem, problem.begun(problem.stated()))
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
    problem = LeastSquaresProblem([run])
    there = Linearisation.at(problem, problem.begun(fit.point))
    own = RigNoise.of_trials(run)
    own = own.learned(there.residual, {}) if noise is None else replace(own, channels=noise.channels)
    other = FitResult(linearisation=there, jacobian=Jacobian(), noise=own)
    return Held(fit=other, residual=other.residual, cost=other.minus_log_likelihood)
