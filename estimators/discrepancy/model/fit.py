"""A drive fitted by multiple shooting: window states, nuisances and sizes of effects together.

Every window has its own start, which is eliminated window by window. What all windows share remains: n, the
imperfections of an unmodified vehicle's sensors, the timing of the inputs within half a sample, and the sizes
of effects. The result is a small normal matrix with a score, which is all that the search needs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.autoregressive_noise import AutoregressiveNoise, white_deviation
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.natural_world import null_simulations
from estimators.discrepancy.model.parameters import Candidate, Point
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.protocol import ForwardModel
from offroad_env.errors import OffroadError, SolverFailure

__all__ = [
    "HOPELESS",
    "autoregressive",
    "begun_afresh",
    "fit_runs",
    "settled",
    "stretches_of",
    "unfitted_cost",
    "with_null_simulations",
]

#: Steps towards starts that a ground about right leads to.
_ROUGHLY = 3
#: Passes of descending and learning the noise; the gain of a pass that ends them, in the log-likelihood.
_PASSES, _SETTLED = 12, 1.0
#: Where all derivatives are new at last, and the cost falls by more than this: once more, so often in all.
_UNSETTLED, _TIMES = 5.0, 2
#: A rough fit of so many times the cost of another is where the vehicle does not drive as logged: the descent
#: from there is long and ends nowhere. On 11 logs with large faults those that served cost up to 4 times.
HOPELESS = 10.0
#: A second fit is not gone on with that begins, each in its own noise, behind the first by so much
#: log-likelihood per sample. Chosen on two logs: one begun 0.74 behind went nowhere for minutes; of 79 others
#: with large faults or two, one asked for a second fit, which began 0.08 behind and came out no better.
_BEHIND = 0.5
#: Least standard deviation of a channel, in its unit: a channel that never changes must stay solvable.
_LEAST_DEVIATION = 1e-6


def fit_runs(
    runs: Sequence[ForwardModel], *, white: bool = False, null: bool = True, near: FitResult | None = None
) -> FitResult:
    """The nominal model fitted: starts, nuisances and the colour of the noise.

    Parameters
    ----------
    white
        Take all noise for white: only to show what that does.
    null
        Simulate what road and soil do to an unmodified vehicle, which all tests compare with.
    near
        Fit of the same windows by another step of the solver, from which this one begins.

    Raises
    ------
    SolverFailure
        When the model cannot be run at all.
    """
    problem = LeastSquaresProblem(runs)
    if near is not None:
        there = Linearisation.at(problem, near.point)
        fit = settled(FitResult(linearisation=there, jacobian=Jacobian(), noise=near.noise, white=white))
    else:
        fit = _fitted_anew(problem, white=white)
    return with_null_simulations(fit) if null else fit


def with_null_simulations(fit: FitResult) -> FitResult:
    """The fit with null simulations, unless it has them or takes all noise for white."""
    return fit if fit.white or fit.null is not None else replace(fit, null=null_simulations(fit))


def _fitted_anew(problem: LeastSquaresProblem, *, white: bool) -> FitResult:
    """The better of two fits from stated numbers, where two are of use.

    Far from the data, noise as small as the sensors' leads into the nearest valley, by many steps.
    """
    try:
        fit = settled(_begun(problem, problem.stated(), white=white, wide=True))
    except SolverFailure:
        return settled(_begun(problem, problem.stated(), white=white, wide=False))
    if not problem.hard and fit.converged:
        return fit
    # On hard ground that valley may hold: tyres at a limit of their stiffness turn the car late, too.
    begun = _begun(problem, problem.stated(), white=white, wide=False)
    behind = begun.with_learned_noise().minus_log_likelihood - fit.minus_log_likelihood
    if not problem.hard and behind > _BEHIND * problem.rows:
        return fit
    try:
        other = settled(begun)
    except SolverFailure:
        return fit
    return min(other, fit, key=lambda each: each.minus_log_likelihood)


def _begun(
    problem: LeastSquaresProblem,
    point: Point,
    *,
    white: bool = False,
    wide: bool,
    numbers: bool = True,
) -> FitResult:
    """About the parameters, and starts that these lead to, from a point without starts.

    Tolerated ``numbers`` move or stay.
    """
    first = Linearisation.at(problem, problem.begun(point))
    noise = _first_noise(first, wide=wide)
    fit = FitResult(linearisation=first, jacobian=Jacobian(), noise=noise, white=white)
    # Once more from the starts that a ground about right leads to: no sensor may have measured the speed.
    fit = GaussNewton(rounds=_ROUGHLY, numbers=numbers).descend(fit)
    return fit.moved(problem.begun(fit.point))


def begun_afresh(
    fit: FitResult,
    candidates: Sequence[Candidate],
    sizes: Sequence[float],
    *,
    n: float | None = None,
    numbers: bool = True,
) -> FitResult:
    """The model with these effects fitted roughly from stated numbers and these sizes, the noise as it is.

    For effects so large that the numbers of a model without them are far from any truth, and with them what
    the effects do there.

    Parameters
    ----------
    n
        The sinkage exponent to begin from; None: as stated.
    numbers
        The tolerated numbers move, too. Where the effect is about right they need not, and lead astray.

    Raises
    ------
    SolverFailure
        Where the model has no solution.
    """
    stated = fit.problem.stated(candidates, sizes, n)
    begun = _begun(fit.problem, stated, white=fit.white, wide=True, numbers=numbers)
    return replace(begun, noise=fit.noise, null=fit.null)


def unfitted_cost(
    fit: FitResult, candidates: Sequence[Candidate], sizes: Sequence[float], n: float | None
) -> float:
    """Cost in the noise of a fit of stated numbers and these sizes, from starts that the sensors give.

    One simulation, with the rough solver. Where a wrong model has left the data far behind, it is least about
    the right size and n by far: a friction angle too small by 0.12 rad on clay costs 10,800 there, 31,500 at
    half of it, and 158,000 at an n that is 0.15 off. Infinite where the model has no solution.
    """
    problem = fit.problem.rough
    try:
        return fit.cost_at(Linearisation.at(problem, problem.begun(problem.stated(candidates, sizes, n))))
    except OffroadError:
        return math.inf


def settled(fit: FitResult, *, fresh: bool = True) -> FitResult:
    """Descend and learn the noise in turn, until neither changes much.

    Parameters
    ----------
    fresh
        Take new derivatives at the beginning, too, and not only at the end: for a point that no descent has
        reached.

    Raises
    ------
    SolverFailure
        Where the model has no solution.
    """
    for _ in range(_TIMES):
        fit = _alternated(fit, fresh=fresh)
        # All derivatives at the point that is reached: scores project one kind from the other.
        fit = GaussNewton(whole=True).descend(fit.with_learned_noise())
        if fit.first_cost - fit.cost < _UNSETTLED:
            break
        fresh = False
    return fit.with_null(fit.null)


def _alternated(fit: FitResult, *, fresh: bool) -> FitResult:
    """Descend and learn the noise in turn; the last descent may still be missing."""
    fit, descent = replace(fit, converged=False), GaussNewton()
    for i in range(_PASSES):
        fit = descent.descend(fit, fresh=fresh and i == 0)
        if i > 0 and fit.first_cost - fit.cost < _SETTLED:
            return replace(fit, converged=not fit.stalled)
        fit = fit.with_learned_noise()
    return fit


def stretches_of(problem: LeastSquaresProblem) -> AutoregressiveNoise:
    """Autoregressive noise of a drive that is not yet known: only its stretches."""
    pairs = zip(problem.runs, problem.offsets, strict=False)
    return AutoregressiveNoise.of_rows([(run.channels, int(offset)) for run, offset in pairs])


def autoregressive(fit: FitResult) -> AutoregressiveNoise:
    """Noise of a fit to drives.

    Raises
    ------
    TypeError
        For a fit to trials of a rig.
    """
    if not isinstance(fit.noise, AutoregressiveNoise):
        raise TypeError(
            f"needs the fit of a drive, with autoregressive noise; got {type(fit.noise).__name__}"
        )
    return fit.noise


def _first_noise(first: Linearisation, *, wide: bool) -> AutoregressiveNoise:
    """White noise by the second differences of every channel; ``wide``: by the residuals at the start."""
    noise, deviations = stretches_of(first.problem), {}
    y = np.concatenate([run.y for run in first.problem.runs])
    for name, pieces in noise.pieces.items():
        if wide:
            own = np.concatenate([first.residual[piece] for piece in pieces])
            deviation = float(np.sqrt(np.mean(own**2)))
        else:
            deviation = white_deviation([y[piece] for piece in pieces])
        deviations[name] = max(deviation, _LEAST_DEVIATION)
    return noise.with_white(deviations)
