"""Noise of trials on a rig, from the scatter of repeats and of conditions.

A residual is what all repeats of a condition share, plus what they do not. The second part is certainly
noise; the first is noise only as far as no effect explains it, as with an unknown road. Leaving it out would
turn every imperfection of a model into a discovery.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.rig.trial_model import RigModel

__all__ = ["RepeatNoise", "RigNoise", "rig_noise"]

#: Least variance of a channel, and least deviation: identical repeats must stay solvable.
_LEAST_VARIANCE, _LEAST_DEVIATION = 1e-24, 1e-12
#: Scatter that the repeats of a condition share goes unquestioned up to so many times that between them.
_UNQUESTIONED = 2.0
#: Slip angles within this are of one level, for neighbours in slip [rad].
_LEVEL = 0.02
#: Least share of the samples, or conditions, that counts as freedom left by the fit.
_LEAST_FREEDOM = 0.2


@dataclass(frozen=True, kw_only=True)
class RepeatNoise:
    """Scatter of one channel."""

    repeat: float  #: standard deviation between repeats of a condition
    between: float  #: standard deviation of what the repeats of a condition share

    def of_mean(self, count: np.ndarray) -> np.ndarray:
        """Standard deviation of sqrt(count) times the mean of ``count`` repeats."""
        return np.asarray(np.sqrt(self.repeat**2 + count * self.between**2))

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
        left = max(len(count) - freedom, _LEAST_FREEDOM * len(count))
        if white or spare < 1:
            all_left = max(len(residual) - freedom, _LEAST_FREEDOM * len(residual))
            total = float(np.sum(residual**2)) / all_left
            return cls(repeat=max(np.sqrt(total), _LEAST_DEVIATION), between=0.0)
        repeat = max(float(np.sum((residual - mean[group]) ** 2)) / spare, _LEAST_VARIANCE)

        def excess(between: float) -> float:
            """Paule & Mandel, J. Res. NBS 87 (1982) 377: the weighted squares of the means are as many."""
            return float(np.sum(count * mean**2 / (repeat + count * between))) - left

        if excess(0.0) <= 0.0:
            return cls(repeat=np.sqrt(repeat), between=0.0)
        # Twice the bound: where repeats all but agree, rounding leaves no change of sign at the bound itself.
        between = brentq(excess, 0.0, 2.0 * (float(np.sum(mean**2)) / left + repeat))
        return cls(repeat=np.sqrt(repeat), between=np.sqrt(between))


@dataclass(frozen=True, kw_only=True)
class RigNoise:
    """Noise of all channels of a rig; a `NoiseModel`.

    Whitening divides means of conditions, and departures from them, by the standard deviation of each.
    """

    pieces: Mapping[str, tuple[slice, ...]]  #: channel -> its rows of the data, in one piece
    groups: Mapping[str, np.ndarray]  #: channel -> (M,) number of the condition of every sample
    channels: Mapping[str, RepeatNoise] = field(default_factory=dict)
    slips: Mapping[str, np.ndarray] = field(default_factory=dict)  #: channel -> (C,) mean slip by condition
    angles: Mapping[str, np.ndarray] = field(default_factory=dict)  #: channel -> (C,) mean slip angle

    @classmethod
    def of_trials(cls, run: RigModel) -> RigNoise:
        """Conditions of trials, their noise not yet known."""
        groups = {
            channel.name: np.unique(run.condition_of(channel), return_inverse=True)[1]
            for channel in run.channels
        }
        pieces = {channel.name: (channel.rows,) for channel in run.channels}
        slips, angles = (
            {
                channel.name: np.bincount(groups[channel.name], values[channel.record])
                / np.bincount(groups[channel.name])
                for channel in run.channels
            }
            for values in (run.trials.slip, run.trials.slip_angle)
        )
        return cls(pieces=pieces, groups=groups, slips=slips, angles=angles)

    @property
    def orders(self) -> dict[str, int]:
        """0 for every channel: trials are independent of earlier ones."""
        return dict.fromkeys(self.channels, 0)

    def learned(self, residual: np.ndarray, freedom: Mapping[str, float], *, white: bool = False) -> RigNoise:
        """Noise of every channel estimated from residuals (M,), see `NoiseModel`."""
        channels = {
            name: RepeatNoise.fitted(residual[rows], self.groups[name], freedom.get(name, 0.0), white=white)
            for name, (rows,) in self.pieces.items()
        }
        return replace(self, channels=channels)

    def for_detection(self, residual: np.ndarray) -> RigNoise:
        """The same, without what follows the slip from condition to condition in the residuals (M,).

        A model error that is smooth in slip is no scatter of prepared soil: counted as noise it would make
        trials at few slip angles untestable. What repeats share counts as noise beyond twice what they
        differ by only as far as conditions depart from their neighbours in slip.
        """
        channels = {}
        for name, (rows,) in self.pieces.items():
            own, group = self.channels[name], self.groups[name]
            count = np.bincount(group)
            mean = np.bincount(group, residual[rows]) / count
            rough = _roughness(mean, self.slips[name], self.angles[name])
            rough = max(rough - own.repeat**2 * float(np.mean(1.0 / count)), 0.0)
            most = max(_UNQUESTIONED * own.repeat, np.sqrt(rough))
            channels[name] = replace(own, between=min(own.between, most))
        return replace(self, channels=channels)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Whitened copy of (M,) or (M, k)."""
        table = columns.reshape(len(columns), -1)
        out = np.empty_like(table)
        for name, (rows,) in self.pieces.items():
            group, noise = self.groups[name], self.channels[name]
            count = np.bincount(group)
            mean = np.zeros((len(count), table.shape[1]))
            np.add.at(mean, group, table[rows])
            mean /= count[:, None]
            apart = (table[rows] - mean[group]) / noise.repeat
            out[rows] = apart + (mean / noise.of_mean(count)[:, None])[group]
        return out.reshape(columns.shape)

    def log_scale(self) -> float:
        """Sum of the logarithms of all standard deviations: part of -log L."""
        total = 0.0
        for name, group in self.groups.items():
            count, noise = np.bincount(group), self.channels[name]
            total += float((count - 1).sum() * np.log(noise.repeat) + np.log(noise.of_mean(count)).sum())
        return total


def _roughness(mean: np.ndarray, slip: np.ndarray, angle: np.ndarray) -> float:
    """Variance of means (C,) about the line between their neighbours in slip, at one slip angle each.

    Gasser, Sroka & Jennen-Steinmetz, Biometrika 73 (1986) 625. Infinite without neighbours.
    """
    squares: list[float] = []
    order = np.lexsort([slip, np.round(angle / _LEVEL)])
    for a, i, b in zip(order[:-2], order[1:-1], order[2:], strict=True):
        if abs(angle[a] - angle[b]) > _LEVEL or slip[b] - slip[a] <= 0.0:
            continue
        share = (slip[i] - slip[a]) / (slip[b] - slip[a])
        away = mean[i] - (1.0 - share) * mean[a] - share * mean[b]
        squares.append(float(away**2 / (1.0 + (1.0 - share) ** 2 + share**2)))
    return float(np.mean(squares)) if squares else np.inf


def rig_noise(fit: FitResult) -> RigNoise:
    """Noise of a fit to trials.

    Raises
    ------
    TypeError
        For a fit to drives.
    """
    if not isinstance(fit.noise, RigNoise):
        raise TypeError(f"needs the fit of trials, with repeats; got {type(fit.noise).__name__}")
    return fit.noise
