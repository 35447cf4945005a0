"""Posterior of the unknowns under one structure: robust least squares over windows.

Gauss-Newton with Student's t as the law of the errors (Lange, Little & Taylor, J. Am. Stat. Assoc. 84
(1989), 881-896), so that a few windows that a model cannot predict do not decide. The covariance at the
optimum is the sandwich of Huber and White with the windows as clusters (Liang & Zeger, Biometrika 73 (1986),
13-22): errors within a window may be correlated in any way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.belief.unknowns import PHI, N, Unknowns
from estimators.belief.windows import LogWindows
from offroad_env.physics.records import FloatArray
from offroad_env.simulation.simulator import Plant

__all__ = ["FAILED", "Fit", "fit_unknowns", "losses_of", "searched"]

#: Degrees of freedom of Student's t.
_NU = 6.0
#: Residual [scales] that a window in which the soil gives way is counted with.
FAILED = 20.0
#: Values of n and phi [-, rad] from which the best is the start; every third window is enough to find it.
_START_N, _START_PHI = np.arange(0.15, 1.4, 0.2), (0.33, 0.55)
_SPARSE = 3
#: Iterations of a fit and of the search, and the gain in loss below which they end.
_ITERATIONS, _SEARCHING, _ENOUGH = 8, 3, 0.1
#: Levenberg-Marquardt damping: first, factor, largest.
_DAMPING, _DAMPING_FACTOR, _DAMPING_TRIES = 1e-3, 10.0, 5


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Normal approximation of the posterior under one structure."""

    values: FloatArray  #: (9,) most probable values, as `UNKNOWN_NAMES`
    covariance: FloatArray  #: (9, 9)
    loss: float  #: negative log-posterior up to a constant
    alone: FloatArray  #: (W, B, 6) residuals of windows predicted without themselves [scales]; NaN: gave way
    noise: FloatArray  #: (W,) root mean square residual that the sensors' noise explains [scales]

    @property
    def misfit(self) -> FloatArray:
        """(W,) root mean square residual of each window, predicted without itself [scales]."""
        measured = (self.alone != 0.0).any(axis=(0, 1))
        squares = np.nan_to_num(self.alone, nan=FAILED)[..., measured] ** 2
        found: FloatArray = np.sqrt(squares.mean(axis=(1, 2)))
        return found

    @property
    def unexplained(self) -> FloatArray:
        """(W,) the same beyond the noise of the sensors: what the model has wrong [scales]."""
        found: FloatArray = np.sqrt(np.maximum(self.misfit**2 - self.noise**2, 0.0))
        return found


def losses_of(residuals: FloatArray) -> FloatArray:
    """(W,) negative log-likelihoods of residuals (W, B, 6) under Student's t, up to a constant."""
    squares = np.nan_to_num(residuals, nan=FAILED) ** 2
    total: FloatArray = 0.5 * (_NU + 1.0) * np.log1p(squares / _NU).sum(axis=(1, 2))
    return total


def searched(windows: LogWindows, plant: Plant, unknowns: Unknowns) -> Fit:
    """A first fit to every third window, from the best point of a coarse grid of n and phi."""
    sparse = windows.every(_SPARSE)
    best, lowest = unknowns.mean, math.inf
    for n in _START_N:
        for phi in _START_PHI:
            values = unknowns.mean.copy()
            values[[N, PHI]] = n, phi
            loss = float(losses_of(sparse.residuals(plant, values)).sum()) + unknowns.loss(values)
            if loss < lowest:
                best, lowest = values, loss
    return fit_unknowns(sparse, plant, unknowns, best, iterations=_SEARCHING)


def _slopes(
    evaluate: Callable[[FloatArray], FloatArray],
    values: FloatArray,
    base: FloatArray,
    steps: FloatArray,
    known: FloatArray | None,
) -> FloatArray:
    """(W, B, 6, 9) derivatives of the residuals; those by nuisances as ``known``, where given.

    Residuals are nearly linear in the nuisances over their tolerances, but not in n and phi.
    """
    J = np.empty((*base.shape, len(values))) if known is None else known.copy()
    for i in range(len(values)) if known is None else (N, PHI):
        moved = values.copy()
        moved[i] += steps[i]
        J[..., i] = (evaluate(moved) - base) / steps[i]
    return J


@dataclass(frozen=True)
class _Local:
    """The problem linearised at a point, windows in which the soil gives way left out."""

    J: FloatArray  #: (W, M, 9)
    r: FloatArray  #: (W, M)
    weight: FloatArray  #: (W, M) of Student's t
    kept: np.ndarray  #: (W,) bool

    @classmethod
    def at(cls, J: FloatArray, r: FloatArray) -> _Local:
        W, size = len(r), J.shape[-1]
        rows, slopes = r.reshape(W, -1), J.reshape(W, -1, size)
        finite = np.isfinite(slopes).all(axis=2) & np.isfinite(rows)
        kept: np.ndarray = np.all(finite, axis=1)
        rows, slopes = np.where(kept[:, None], rows, 0.0), np.where(kept[:, None, None], slopes, 0.0)
        return cls(slopes, rows, np.where(kept[:, None], (_NU + 1.0) / (_NU + rows**2), 0.0), kept)

    @property
    def scores(self) -> FloatArray:
        """(W, 9) gradient of every window's loss."""
        found: FloatArray = np.einsum("wmi,wm->wi", self.J, self.weight * self.r)
        return found

    @property
    def information(self) -> FloatArray:
        """(9, 9) Gauss-Newton matrix of the data."""
        found: FloatArray = np.einsum("wmi,wm,wmj->ij", self.J, self.weight, self.J)
        return found


def fit_unknowns(
    windows: LogWindows,
    plant: Plant,
    unknowns: Unknowns,
    start: FloatArray,
    *,
    iterations: int = _ITERATIONS,
    report: Callable[[float], None] = lambda share: None,
) -> Fit:
    """Most probable values and their covariance, from ``start`` (9,); ``report`` gets the share done."""
    low, high = unknowns.bounds
    precision = 1.0 / unknowns.sd**2

    def evaluate(values: FloatArray) -> FloatArray:
        return windows.residuals(plant, values)

    values = np.clip(start, low, high)
    r = evaluate(values)
    loss, damping = float(losses_of(r).sum()) + unknowns.loss(values), _DAMPING
    J, begun = _slopes(evaluate, values, r, unknowns.steps, None), np.isfinite(r)
    local = _Local.at(J, r)
    for done in range(1, iterations + 1):
        report(done / (iterations + 1))
        H = local.information + np.diag(precision)
        gradient = local.scores.sum(axis=0) + precision * (values - unknowns.mean)
        before, better = loss, False
        for _ in range(_DAMPING_TRIES):  # until the loss falls
            step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -gradient)
            moved = np.clip(values + step, low, high)
            r_moved = evaluate(moved)
            loss_moved = float(losses_of(r_moved).sum()) + unknowns.loss(moved)
            better = loss_moved < loss
            if better:
                break
            damping = max(_DAMPING_FACTOR * damping, 1e-2)
        if not better:
            break
        values, r, loss, damping = moved, r_moved, loss_moved, max(damping / _DAMPING_FACTOR, 1e-5)
        # A window in which the soil gave way at first has no slopes by nuisances yet.
        fresh = bool((np.isfinite(r) & ~begun).any())
        if before - loss < _ENOUGH and not fresh:
            local = _Local.at(J, r)  # the slopes of a point so near
            break
        J = _slopes(evaluate, values, r, unknowns.steps, None if fresh else J)
        begun |= np.isfinite(r)
        local = _Local.at(J, r)
    covariance, alone = _finished(local, unknowns)
    return Fit(
        values=values, covariance=covariance, loss=loss, alone=alone.reshape(r.shape), noise=windows.noise
    )


def _finished(local: _Local, unknowns: Unknowns) -> tuple[FloatArray, FloatArray]:
    """Covariance (9, 9), and residuals (W, M) of every window predicted without itself."""
    precision = np.diag(1.0 / unknowns.sd**2)
    inverse = np.linalg.inv(local.information + precision)
    scores, count = local.scores, max(int(local.kept.sum()), 1)
    # Few clusters: the usual correction of the scatter for the two parameters that the data decide.
    scatter = scores.T @ scores * count / max(count - 2, 1)
    sandwich = inverse @ (scatter + precision) @ inverse
    # Without a window the optimum moves by the inverse times that window's score, to first order.
    alone = local.r + np.einsum("wmi,wi->wm", local.J, scores @ inverse)
    return sandwich, np.where(local.kept[:, None], alone, np.nan)
