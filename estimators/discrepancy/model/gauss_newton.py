"""Gauss-Newton descent that takes new derivatives only where its steps reduce the cost too slowly.

Derivatives are most of the work of a fit. Those of an earlier point serve as long as the reduction of the
cost that the normal equations predict falls quickly from step to step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.normal_equations import NormalEquations, WindowSolution, reduced
from estimators.discrepancy.model.parameters import Point
from estimators.discrepancy.model.problem import LeastSquaresProblem
from offroad_env.errors import OffroadError

__all__ = ["GaussNewton", "bounded_step", "moved"]

#: Least reduction of the cost, in the log-likelihood: a twentieth of the penalty of one parameter in AIC.
_ENOUGH = 0.05
#: New derivatives are taken where the predicted reduction exceeds this share of that of the step before, and
#: this value.
_SLOW, _STAKE = 0.2, 1.0
#: Predicted reduction without an actual one, above which the point is no minimum.
_STALLED = 10.0
#: Most reduction of the cost, over the predicted one, by new derivatives and by old ones.
_HOPE, _OLD_HOPE = 2.0, 5.0
#: Shares of a step that are tried until one lowers the cost.
_SHARES = (1.0, 0.5, 0.2, 0.05)


class _White(NamedTuple):
    """Whitened derivatives."""

    states: np.ndarray  #: (M, S) by the free states of the windows
    shared: np.ndarray  #: (M, g) by the shared parameters that move


class _Step(NamedTuple):
    """A step of all parameters from the present point."""

    equations: NormalEquations
    change: np.ndarray  #: (g,) of the shared parameters
    predicted: float  #: reduction of the cost by the equations


@dataclass(frozen=True, kw_only=True)
class GaussNewton:
    """Descent of a fit to the nearest minimum of its cost; the noise stays as it is.

    Where derivatives cost little and effects are far from linear, as on a rig, every step takes new ones.
    """

    rounds: int = 8
    held: bool = False  #: only the starts of the windows move
    enough: float = np.inf  #: the descent ends where no cost below this can be expected
    #: All new derivatives are by the tolerated numbers, too. Else the first of a descent are not: on the way
    #: to a minimum earlier ones serve as well, unless that way is long.
    whole: bool = False
    #: New derivatives are taken on the way where steps reduce the cost too slowly.
    renewing: bool = True
    numbers: bool = True  #: the tolerated numbers move, and do not stay where they are

    def descend(self, fit: FitResult, *, fresh: bool = True) -> FitResult:
        """The fit at the minimum.

        Parameters
        ----------
        fresh
            Take new derivatives at the beginning.

        Raises
        ------
        SolverFailure
            Where the model has no solution about the present point.
        """
        renews = fit.problem.renews_derivatives
        fit = fit.carried_to(replace(fit, first_cost=fit.cost, stalled=False))
        new = fresh or renews or fit.jacobian.states is None
        fit, white = self._linearised(fit, tolerated=self.whole) if new else self._whitened(fit)
        before, whole = np.inf, self.whole
        for i in range(self.rounds):
            if renews and i > 0:
                # Errors of settings are small: what they change depends little on where the descent is.
                (fit, white), new = self._linearised(fit, states=False), True
            step = _step(fit, white)
            slow = step.predicted > max(_SLOW * before, _STAKE)
            if self.renewing and not new and slow:
                (fit, white), new, whole = self._linearised(fit, tolerated=whole), True, True
                step = _step(fit, white)
            # With new derivatives that are wrong by half, the reduction is at most twice the predicted one.
            hope = step.predicted * (_HOPE if new else _OLD_HOPE)
            if step.predicted < _ENOUGH or fit.cost - hope > self.enough:
                break
            trial = _tried(fit, step, _SHARES if step.predicted > _STAKE else _SHARES[:1])
            gain = 0.0 if trial is None else fit.cost - trial.cost
            fit = fit if trial is None else trial
            if gain < _ENOUGH:
                fit = fit.carried_to(replace(fit, stalled=step.predicted > _STALLED))
                if new or step.predicted < _STAKE:
                    break
            new, before = False, step.predicted if trial is not None else 0.0
        return fit.carried_to(replace(fit, equations=step.equations))

    def _linearised(
        self, fit: FitResult, *, states: bool = True, tolerated: bool = True
    ) -> tuple[FitResult, _White]:
        """With new derivatives at the present point; by states and tolerated numbers if wanted."""
        there = fit.linearisation
        if self.held:
            jacobian = fit.jacobian.renewed_states(there)
        elif not self.numbers:
            jacobian = fit.jacobian.without_numbers(there).renewed(there, states=states, tolerated=False)
        else:
            jacobian = fit.jacobian.renewed(there, states=states, tolerated=tolerated)
        return self._whitened(fit.carried_to(replace(fit, jacobian=jacobian)))

    def _whitened(self, fit: FitResult) -> tuple[FitResult, _White]:
        """The fit with all derivatives that a step takes, and these whitened."""
        fit = fit if self.held else fit.completed()
        shared = np.empty((fit.problem.rows, 0)) if self.held else fit.white_shared()
        return fit, _White(fit.white_states, shared)


def _step(fit: FitResult, white: _White) -> _Step:
    """The step from the present point."""
    residual = fit.noise.whiten(fit.residual)
    equations = reduced(fit.problem, fit.point, residual, white.states, white.shared)
    equations = equations.with_prior_of_sizes(fit.problem.size_information(fit.candidates))
    change = bounded_step(fit.problem, fit.point, equations)
    predicted = fit.cost - equations.cost + 0.5 * float(equations.score @ change)
    return _Step(equations, change, predicted)


def bounded_step(problem: LeastSquaresProblem, point: Point, equations: NormalEquations) -> np.ndarray:
    """Step (g,) of the shared parameters that leaves those at their limits where they are.

    In drives on soil without effects a step is only cut: the one limit there, of the timing, needs no more.
    """
    change = np.linalg.solve(equations.normal, equations.score)
    if not (problem.bounded or point.candidates) or not len(change):
        return change
    low, high = problem.limits(point.candidates)
    values, free = point.shared, np.ones(len(change), dtype=bool)
    while True:
        out = free & (((values >= high) & (change > 0.0)) | ((values <= low) & (change < 0.0)))
        if not out.any():
            return change
        free &= ~out
        change = np.zeros(len(change))
        change[free] = np.linalg.solve(equations.normal[np.ix_(free, free)], equations.score[free])


def moved(
    problem: LeastSquaresProblem,
    point: Point,
    change: np.ndarray,
    windows: Sequence[WindowSolution],
    share: float,
) -> Point:
    """The point after a share of a step ``change`` (g,) of the shared parameters, or none (0,)."""
    starts, w = [], 0
    for run, start in zip(problem.runs, point.starts, strict=True):
        ahead = start.copy()
        for i in range(len(start)):
            ahead[i, list(run.free)] += share * (windows[w].offset - windows[w].slope @ change)
            w += 1
        starts.append(ahead)
    if not len(change):
        return replace(point, starts=tuple(starts))
    values = np.clip(point.shared + share * change, *problem.limits(point.candidates))
    count = problem.nuisance_count
    return replace(point, nuisances=values[:count], sizes=values[count:], starts=tuple(starts))


def _tried(fit: FitResult, step: _Step, shares: Sequence[float]) -> FitResult | None:
    """The fit as far along the step as it lowers the cost; None where it does not."""
    for share in shares:
        try:
            there = fit.moved(moved(fit.problem, fit.point, step.change, step.equations.windows, share))
        except OffroadError:
            continue
        if there.cost < fit.cost:
            return there
    return None
