"""The extended model where a verdict names some of the causes that were found, and not all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.run_model import drives

__all__ = ["model_with"]


def model_with(fit: FitResult, kept: Sequence[int], sizes: Sequence[float] | np.ndarray) -> FitResult:
    """The model with some of its effects at given sizes; starts, nuisances and noise are fitted again.

    The sizes stay as they are: without the other effects a fit would let these take over what is left.

    Parameters
    ----------
    kept
        Places of the effects in the model.
    sizes
        Of these, in the order of ``kept``.

    Raises
    ------
    SolverFailure
        When the model breaks down.
    """
    candidates = [fit.candidates[k] for k in kept]
    held: Mapping[str, float] = {
        candidate.effect: float(size) for candidate, size in zip(candidates, sizes, strict=True)
    }
    problem = LeastSquaresProblem([run.with_sizes(held) for run in drives(fit.runs)])
    point = replace(fit.point, candidates=tuple(candidates), sizes=np.array([*held.values()]))
    there = Linearisation.at(problem, point)
    return settled(replace(fit, linearisation=there, jacobian=Jacobian(), equations=None))
