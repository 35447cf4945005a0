"""The model fitted to the trials of a rig, with the noise that repeats and conditions show.

A residual is what all repeats of a condition share, plus what they do not. The second part is noise beyond
doubt; the first is noise only as far as no effect explains it, as with an unknown road. Leaving it out would
call every imperfection of a model a discovery.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from estimators.discrepancy.fit import Fit, settle
from estimators.discrepancy.gain import Held
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.rig_model import RigModel

__all__ = ["RepeatNoise", "RigFit", "RigWhitener", "fit_rig", "held_out_trials"]

#: Finite difference of the ground's parameter: trials know it to some hundredths, and have no bumps.
_GROUND_STEP = 0.005
#: Steps of a descent, and the gain of a step that ends it, in the log-likelihood.
_ROUNDS, _ENOUGH = 8, 0.05


@dataclass(frozen=True, kw_only=True)
class RepeatNoise:
    """Scatter of one channel."""

    repeat: float  #: standard deviation between repeats of a condition
    between: float  #: standard deviation of what the repeats of a condition share
    order: int = 0  #: trials remember nothing

    def of_mean(self, count: np.ndarray) -> np.ndarray:
        """Standard deviation of sqrt(count) times the mean of ``count`` repeats."""
        return np.sqrt(self.repeat**2 + count * self.between**2)

    @classmethod
    def fitted(cls, residual: np.ndarray, group: np.ndarray, freedom: float, *, white: bool) -> RepeatNoise:
        """From residuals (M,) and the number (M,) of the condition of each.

        Parameters
        ----------
        freedom
            Parameters that the fit has spent on them.
        white
            Take all scatter for that of repeats.
        """
        count = np.bincount(group)
        mean = np.bincount(group, residual) / count
        spare = len(residual) - len(count)
        left = max(len(count) - freedom, 0.2 * len(count))
        if white or spare < 1:
            total = float(np.sum(residual**2)) / max(len(residual) - freedom, 0.2 * len(residual))
            return cls(repeat=max(np.sqrt(total), 1e-12), between=0.0)
        repeat = max(float(np.sum((residual - mean[group]) ** 2)) / spare, 1e-24)

        def excess(between: float) -> float:
            """Paule & Mandel, J. Res. NBS 87 (1982) 377: the weighted squares of the means are as many."""
            return float(np.sum(count * mean**2 / (repeat + count * between))) - left

        if excess(0.0) <= 0.0:
            return cls(repeat=np.sqrt(repeat), between=0.0)
        between = brentq(excess, 0.0, float(np.sum(mean**2)) / left + repeat)
        return cls(repeat=np.sqrt(repeat), between=np.sqrt(between))


class RigWhitener:
    """Whitening by channel: means of conditions and departures from them, each over its own scatter."""

    def __init__(self, run: RigModel) -> None:
        self.pieces = {channel.name: [channel.rows] for channel in run.channels}
        self.groups = {
            channel.name: np.unique(run.condition_of(channel), return_inverse=True)[1]
            for channel in run.channels
        }
        self.noise: dict[str, RepeatNoise] = {}

    def learn(self, residual: np.ndarray, freedom: float, *, white: bool = False) -> None:
        """Set the noise of every channel from residuals (M,) of a fit that spent ``freedom`` parameters."""
        for name, (rows,) in self.pieces.items():
            share = freedom * (rows.stop - rows.start) / len(residual)
            self.noise[name] = RepeatNoise.fitted(residual[rows], self.groups[name], share, white=white)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Whitened copy of (M,) or (M, k)."""
        table = columns.reshape(len(columns), -1)
        out = np.empty_like(table)
        for name, (rows,) in self.pieces.items():
            group, noise = self.groups[name], self.noise[name]
            count = np.bincount(group)
            mean = np.zeros((len(count), table.shape[1]))
            np.add.at(mean, group, table[rows])
            mean /= count[:, None]
            apart = (table[rows] - mean[group]) / noise.repeat
            out[rows] = apart + (mean / noise.of_mean(count)[:, None])[group]
        return out.reshape(columns.shape)

    def log_scale(self) -> float:
        """What the deviations contribute to minus the log-likelihood."""
        total = 0.0
        for name, group in self.groups.items():
            count, noise = np.bincount(group), self.noise[name]
            total += float((count - 1).sum() * np.log(noise.repeat) + np.log(noise.of_mean(count)).sum())
        return total


class RigFit(Fit):
    """A point (n, sizes) and how the trials hang on it; trials have no starts.

    ``white`` takes all scatter for that of repeats.
    """

    def __init__(self, runs: Sequence[RigModel], *, white: bool = False) -> None:
        super().__init__(runs)
        self.whitener = RigWhitener(self.runs[0])
        self.white = white

    def branch(self) -> RigFit:
        """A copy that may go elsewhere, with derivatives of its own: a rig's effects bend."""
        other = super().branch()
        other._by_sizes, other._by_nuisances = {}, None
        return other

    def descend(self, rounds: int = _ROUNDS, *, fresh: bool = True, held: bool = False) -> float:
        """Gauss-Newton with new derivatives for every step, which cost nothing here; returns the cost."""
        reached = super().descend(1, held=held)
        first_cost = self.first_cost
        for _ in range(rounds - 1):
            before, reached = reached, super().descend(1, held=held)
            if before - reached < _ENOUGH:
                break
        self.first_cost = first_cost
        return reached

    def state_columns(self) -> np.ndarray:
        """No free state, (M, 0)."""
        return np.empty((len(self.runs[0].y), 0))

    def nuisance_columns(self) -> np.ndarray:
        """Derivatives of the data by the nuisances: by n; a rig has none of the others."""
        columns = np.zeros((len(self.runs[0].y), len(NUISANCES)))
        point, ground = self.nuisances.copy(), [nuisance.name for nuisance in NUISANCES].index("ground")
        point[ground] += _GROUND_STEP
        columns[:, ground] = self._derivative(self._setups(point), self.starts, _GROUND_STEP)
        return columns

    def learn_noise(self, *, white: bool = False) -> None:
        """Set the noise from the residuals at the present point."""
        self.whitener.learn(self.residual(), 1.0 + len(self.sizes), white=white)


def fit_rig(run: RigModel, *, white: bool = False) -> RigFit:
    """The nominal model with n fitted, and the noise."""
    fit = RigFit([run], white=white)
    fit.begin()
    fit.learn_noise(white=white)
    settle(fit, white=white)
    return fit


def held_out_trials(fit: RigFit, run: RigModel, noise: dict[str, RepeatNoise] | None = None) -> Held:
    """The model of ``fit`` on other trials, nothing fitted.

    Parameters
    ----------
    noise
        What counts as scatter there; default: what the model leaves there.

    Raises
    ------
    SolverFailure
        When a contact has no solution there.
    """
    other = RigFit([run])
    other.candidates, other.sizes, other.nuisances = fit.candidates, fit.sizes.copy(), fit.nuisances.copy()
    other.begin()
    residual = other.residual()
    if noise is None:
        other.whitener.learn(residual, 0.0)
    else:
        other.whitener.noise = noise
    return Held(fit=other, residual=residual, cost=other.cost_of(residual) + other.whitener.log_scale())
