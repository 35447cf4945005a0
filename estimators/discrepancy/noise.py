"""What the samples scatter by when nothing is wrong: coloured noise, and its whitening.

A channel's noise is an autoregressive process. Its coefficients come from the residuals of the fit
(autocovariances pooled over all stretches without a gap, Levinson's recursion, order by AIC), so an unknown
road, which colours every channel, is noise like any other. The first samples of a stretch are whitened by
the lower orders of the same recursion: no sample is lost, and a gap only begins a new stretch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimators.discrepancy.run_model import Channel

__all__ = ["ChannelNoise", "Whitener", "stretches"]

#: Longest memory of a channel's noise: in samples, and as a share of a stretch.
_ORDER, _ORDER_SHARE = 30, 0.05
#: The level of a stretch is believed to be usual as if so many samples had shown it.
_USUAL = 20.0
#: A step longer than this many usual ones is a gap. Usual is what nine in ten do not exceed: stamps that
#: come by turns after one period and after two are no gaps.
_GAP, _USUAL_STEP = 1.5, 0.9


def stretches(channel: Channel, offset: int = 0) -> list[slice]:
    """Rows of the data in pieces without a gap, within one window each."""
    within = np.diff(channel.t)[np.diff(channel.window) == 0]
    step = np.quantile(within, _USUAL_STEP) if len(within) else 1.0
    breaks = (np.diff(channel.t) > _GAP * step) | (np.diff(channel.window) != 0)
    edges = [0, *(np.flatnonzero(breaks) + 1), len(channel.t)]
    start = channel.rows.start + offset
    return [slice(start + a, start + b) for a, b in pairwise(edges)]


@dataclass(frozen=True, kw_only=True)
class ChannelNoise:
    """Predictors of all orders up to the channel's own, and the deviation of what they leave."""

    predictors: tuple[np.ndarray, ...]  #: order k -> coefficients (k,) of the last k samples
    deviation: np.ndarray  #: (order + 1,) standard deviation of the innovation, by order

    @property
    def order(self) -> int:
        """How many samples the noise remembers."""
        return len(self.predictors) - 1

    @classmethod
    def white(cls, deviation: float) -> ChannelNoise:
        """Noise without memory."""
        return cls(predictors=(np.empty(0),), deviation=np.array([deviation]))

    @classmethod
    def fitted(cls, pieces: Sequence[np.ndarray], freedom: float, order: int | None = None) -> ChannelNoise:
        """From residuals.

        Parameters
        ----------
        freedom
            How many parameters the fit has spent on these residuals.
        order
            Memory; None chooses it.
        """
        total = sum(len(piece) for piece in pieces)
        longest = max(len(piece) for piece in pieces)
        limit = min(_ORDER, int(_ORDER_SHARE * longest)) if order is None else order
        covariance = np.zeros(limit + 1)
        for lag in range(limit + 1):
            covariance[lag] = sum(float(p[lag:] @ p[: len(p) - lag]) for p in pieces if len(p) > lag) / total
        covariance[0] = max(covariance[0], 1e-300)
        predictors, variances = _levinson(covariance)
        if order is None:
            scores = total * np.log(variances) + 2.0 * np.arange(limit + 1)
            limit = int(np.argmin(scores))
        spent = total / max(total - freedom, 0.2 * total)
        return cls(
            predictors=tuple(predictors[: limit + 1]), deviation=np.sqrt(variances[: limit + 1] * spent)
        )

    def whiten(self, piece: np.ndarray) -> np.ndarray:
        """Innovations of a stretch (m,) or of the columns of (m, k), with deviation 1."""
        p = min(self.order, len(piece) - 1)
        out = piece.copy()
        for lag in range(1, p + 1):
            out[lag:] -= self.predictors[p][lag - 1] * piece[:-lag]
        out /= self.deviation[p]
        for i in range(p):
            out[i] = (piece[i] - self.predictors[i] @ piece[:i][::-1]) / self.deviation[i]
        return out

    def log_scale(self, length: int) -> float:
        """Sum of the logarithms of the deviations over a stretch."""
        p = min(self.order, length - 1)
        return float(np.log(self.deviation[:p]).sum() + (length - p) * np.log(self.deviation[p]))


def _levinson(covariance: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    predictors, variances = [np.empty(0)], [covariance[0]]
    for k in range(1, len(covariance)):
        before = predictors[-1]
        reflection = (covariance[k] - before @ covariance[k - 1 : 0 : -1]) / variances[-1]
        reflection = min(max(reflection, -0.9999), 0.9999)
        predictors.append(np.concatenate([before - reflection * before[::-1], [reflection]]))
        variances.append(variances[-1] * (1.0 - reflection * reflection))
    return predictors, np.array(variances)


class Whitener:
    """Noise of all channels, and where their stretches lie in the data of all runs.

    Parameters
    ----------
    channels
        For every run its channels, and the first row of its data.
    """

    def __init__(self, channels: Sequence[tuple[tuple[Channel, ...], int]]) -> None:
        self.pieces: dict[str, list[slice]] = {}
        for own, offset in channels:
            for channel in own:
                self.pieces.setdefault(channel.name, []).extend(stretches(channel, offset))
        self.noise: dict[str, ChannelNoise] = {}
        self.levels: dict[int, float] = {}  #: first row of a stretch -> what its noise is multiplied by

    def learn(self, residual: np.ndarray, freedom: dict[str, float], *, white: bool = False) -> None:
        """Set the noise of every channel from residuals (M,); ``white`` leaves out its colour."""
        for name, pieces in self.pieces.items():
            own = [residual[piece] for piece in pieces]
            self.noise[name] = ChannelNoise.fitted(own, freedom.get(name, 0.0), 0 if white else None)

    def learn_levels(self, residual: np.ndarray) -> None:
        """Give every stretch its own level, from residuals (M,), the noise as it is.

        What shakes a vehicle on hard ground grows with its speed, and a stretch that the model misses
        should not outweigh all others.
        """
        self.levels = {}
        for name, pieces in self.pieces.items():
            for piece in pieces:
                white = self.noise[name].whiten(residual[piece])
                square = (float(white @ white) + _USUAL) / (len(white) + _USUAL)
                self.levels[piece.start] = float(np.sqrt(square))

    def _level(self, piece: slice) -> float:
        return self.levels.get(piece.start, 1.0)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Whitened copy of (M,) or (M, k)."""
        out = np.empty_like(columns)
        for name, pieces in self.pieces.items():
            noise = self.noise[name]
            for piece in pieces:
                out[piece] = noise.whiten(columns[piece])
                if self.levels:
                    out[piece] /= self._level(piece)
        return out

    def log_scale(self) -> float:
        """What the deviations contribute to minus the log-likelihood."""
        return sum(
            self.noise[name].log_scale(piece.stop - piece.start)
            + (piece.stop - piece.start) * math.log(self._level(piece))
            for name, pieces in self.pieces.items()
            for piece in pieces
        )
