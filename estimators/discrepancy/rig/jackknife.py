"""How far n depends on which slip angles were measured: the model refitted without each of them.

The interval of a fit takes what conditions share and no effect explains for independent scatter. Where the
laws are wrong, whole slip angles err together, and n takes up what each of them lacks.
"""

from __future__ import annotations

import numpy as np

from estimators.discrepancy.model.fit import settled
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.rig.repeat_noise import RigNoise
from estimators.discrepancy.rig.trial_model import RigModel, trials_of
from offroad_env.errors import OffroadError

__all__ = ["ground_by_blocks", "jackknife_deviation"]

#: Fewer blocks than this give no deviation; so many where conditions are the blocks.
_FEWEST, _BLOCKS = 3, 5


def ground_by_blocks(fit: FitResult) -> tuple[float, ...]:
    """Fitted change of n without each slip angle in turn, or where there are few, without each fifth of them.

    Parameters
    ----------
    fit
        Of trials; laws and effects stay, their sizes are fitted again.
    """
    run = trials_of(fit.runs)
    block = run.trials.levels()
    if block.max() + 1 < _FEWEST:
        block = run.window % _BLOCKS
    found = []
    for one in range(int(block.max()) + 1):
        try:
            found.append(_refitted(fit, run, block != one))
        except OffroadError:
            continue
    return tuple(found)


def _refitted(fit: FitResult, run: RigModel, kept: np.ndarray) -> float:
    """The change of n with the trials that are ``kept``."""
    part = RigModel(run.log, run.trials.only(kept)).with_structure(run.structure)
    problem = LeastSquaresProblem([part])
    there = Linearisation.at(problem, problem.begun(fit.point))
    noise = RigNoise.of_trials(part).learned(there.residual, {})
    return float(settled(FitResult(linearisation=there, jacobian=Jacobian(), noise=noise)).nuisances[0])


def jackknife_deviation(values: tuple[float, ...]) -> float:
    """Standard deviation from estimates without each block (Tukey, Ann. Math. Stat. 29 (1958) 614).

    NaN for fewer than three blocks.
    """
    count = len(values)
    if count < _FEWEST:
        return float("nan")
    away = np.asarray(values) - np.mean(values)
    return float(np.sqrt((count - 1) / count * np.sum(away**2)))
