"""Whitened normal equations of a fit with the states of every window eliminated (Schur complement)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.model.parameters import Point
from estimators.discrepancy.model.problem import LeastSquaresProblem

__all__ = ["NormalEquations", "WindowSolution", "projected", "reduced", "spent_parameters", "without_states"]


@dataclass(frozen=True, kw_only=True)
class WindowSolution:
    """Step of the states of one window, given that of the shared parameters: offset - slope @ step."""

    offset: np.ndarray  #: (S,)
    slope: np.ndarray  #: (S, g)


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Normal equations of the g parameters that all windows share, about one point."""

    normal: np.ndarray  #: (g, g) Fisher information of nuisances, then sizes of effects
    score: np.ndarray  #: (g,) gradient of the log-likelihood
    cost: float  #: half the squared whitened residual that window states cannot take away
    windows: tuple[WindowSolution, ...]

    @property
    def covariance(self) -> np.ndarray:
        """(g, g)."""
        covariance: np.ndarray = np.linalg.inv(self.normal)
        return covariance

    def correlations(self, count: int) -> np.ndarray:
        """Absolute correlations (count, count) of the last ``count`` parameters; 0 on the diagonal."""
        first = len(self.normal) - count
        spread = self.covariance[first:, first:]
        deviation = np.sqrt(np.diag(spread))
        return np.asarray(np.abs(spread / np.outer(deviation, deviation) - np.eye(count)))

    def with_prior_of_sizes(self, information: np.ndarray) -> NormalEquations:
        """With prior information (E,) about the last E parameters added; held parameters stay out."""
        if not len(self.score):
            return self
        normal, first = self.normal.copy(), len(self.score) - len(information)
        for i, own in enumerate(information, first):
            normal[i, i] += own
        return replace(self, normal=normal)


def reduced(
    problem: LeastSquaresProblem,
    point: Point,
    residual: np.ndarray,
    states: np.ndarray,
    shared: np.ndarray,
) -> NormalEquations:
    """Normal equations of the shared parameters about a point.

    Parameters
    ----------
    residual, states, shared
        Whitened: (M,), (M, S) and (M, g). Columns of ``states`` beyond those of the free states are further
        parameters that every window has for itself, with a standard normal prior.
    """
    g = shared.shape[1]
    prior, value = np.zeros(g), np.zeros(g)
    if g:
        prior[: problem.nuisance_count] = problem.nuisance_information
        value[: problem.nuisance_count] = point.nuisances
    normal, score = np.diag(prior), -prior * value
    cost = problem.nuisance_prior_cost(point)
    starts, centre = problem.free_states(point.starts), problem.free_states(point.centre)
    more = states.shape[1] - starts.shape[1]
    weights = np.column_stack([problem.state_information, np.ones((len(starts), more))])
    away_from = np.column_stack([centre - starts, np.zeros((len(starts), more))])
    windows = []
    for rows, away, weight in zip(problem.window_rows, away_from, weights, strict=True):
        A, G, r = states[rows], shared[rows], residual[rows]
        inner = A.T @ A + np.diag(weight)
        cross, gradient = A.T @ G, A.T @ r + weight * away
        solved = np.linalg.solve(inner, np.column_stack([gradient, cross]))
        normal += G.T @ G - cross.T @ solved[:, 1:]
        score += G.T @ r - cross.T @ solved[:, 0]
        cost += 0.5 * float(r @ r + away @ (weight * away) - gradient @ solved[:, 0])
        windows.append(WindowSolution(offset=solved[:, 0], slope=solved[:, 1:]))
    return NormalEquations(normal=normal, score=score, cost=cost, windows=tuple(windows))


def projected(normal: np.ndarray, score: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with the first ``count`` parameters eliminated.

    A parameter that the data do not show, such as one that its limit holds, has nothing to take away.
    """
    inner = normal[:count, :count] + np.diag(np.where(np.diag(normal)[:count] > 0.0, 0.0, 1.0))
    solved = np.linalg.solve(inner, np.column_stack([normal[:count, count:], score[:count]]))
    cross = normal[count:, :count]
    return normal[count:, count:] - cross @ solved[:, :-1], score[count:] - cross @ solved[:, -1]


def without_states(problem: LeastSquaresProblem, states: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Whitened columns (M, k) less what the whitened ``states`` (M, S) of the windows can take away."""
    out = table.copy()
    for rows, weight in zip(problem.window_rows, problem.state_information, strict=True):
        A = states[rows]
        out[rows] -= A @ np.linalg.solve(A.T @ A + np.diag(weight), A.T @ table[rows])
    return out


def spent_parameters(
    problem: LeastSquaresProblem,
    point: Point,
    states: np.ndarray,
    pieces: Mapping[str, Sequence[slice]],
) -> dict[str, float]:
    """Channel -> number of parameters that its residuals have paid for.

    These are the free states of the windows: the trace of their hat matrix, from whitened derivatives
    ``states`` (M, S). The few shared parameters are neglected beside the samples of a drive; in trials every
    sample pays the same share of them.
    """
    freedom = len(point.shared) / problem.rows if problem.renews_derivatives else 0.0
    leverage = np.zeros(problem.rows)
    for rows, weight in zip(problem.window_rows, problem.state_information, strict=True):
        A = states[rows]
        leverage[rows] = np.einsum("ij,ji->i", A, np.linalg.solve(A.T @ A + np.diag(weight), A.T))
    leverage += freedom
    return {name: float(sum(leverage[piece].sum() for piece in own)) for name, own in pieces.items()}
