"""Coloured noise of the samples of a drive, and its whitening.

A channel's noise is an autoregressive process. Its coefficients come from the residuals of the fit
(autocovariances pooled over all stretches without a gap, Levinson's recursion, order by AIC). An unknown
road, which colours every channel, is noise like any other. The first samples of a stretch are whitened by
the lower orders of the same recursion: no sample is lost, and a gap only begins a new stretch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from estimators.discrepancy.model.protocol import Channel

__all__ = ["AutoregressiveNoise", "ChannelNoise", "stretches", "white_deviation"]

#: Longest memory of a channel's noise: in samples, and as a share of a stretch.
_ORDER, _ORDER_SHARE = 30, 0.05
#: Prior of the level of a stretch: 1, with the weight of so many samples.
_USUAL = 20.0
#: A step longer than this many usual ones is a gap. The usual step is the quantile of 90 %: stamps that
#: follow by turns after one period and after two are no gaps.
_GAP, _USUAL_STEP = 1.5, 0.9
#: Standard deviation of a normal variable over its median absolute value; variance of the second differences
#: of white noise over that of the noise.
_NORMAL, _SECOND_DIFFERENCE = 1.4826, 6.0


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
        """Number of earlier samples that the noise of one depends on."""
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
            None chooses it by AIC.
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


def white_deviation(pieces: Sequence[np.ndarray]) -> float:
    """Standard deviation of white noise under a smooth signal, from its second differences; 0 without any.

    The median of their absolute values is not moved by a few jumps.
    """
    bends = [np.diff(piece, 2) for piece in pieces if len(piece) > 2]
    bent = np.concatenate(bends) if bends else np.zeros(1)
    return _NORMAL * float(np.median(np.abs(bent))) / math.sqrt(_SECOND_DIFFERENCE)


def _levinson(covariance: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Predictors of all orders, and the variances of their errors."""
    predictors, variances = [np.empty(0)], [covariance[0]]
    for k in range(1, len(covariance)):
        before = predictors[-1]
        reflection = (covariance[k] - before @ covariance[k - 1 : 0 : -1]) / variances[-1]
        reflection = min(max(reflection, -0.9999), 0.9999)
        predictors.append(np.concatenate([before - reflection * before[::-1], [reflection]]))
        variances.append(variances[-1] * (1.0 - reflection * reflection))
    return predictors, np.array(variances)


@dataclass(frozen=True, kw_only=True)
class AutoregressiveNoise:
    """Noise of all channels of a drive; a `NoiseModel`."""

    pieces: Mapping[str, tuple[slice, ...]]  #: channel -> its stretches in the data of all runs
    channels: Mapping[str, ChannelNoise] = field(default_factory=dict)
    #: First row of a stretch -> factor of its noise; 1 where it is not named.
    levels: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def of_rows(cls, channels: Sequence[tuple[tuple[Channel, ...], int]]) -> AutoregressiveNoise:
        """Stretches of runs, their noise not yet known.

        Parameters
        ----------
        channels
            For every run its channels, and the first row of its data.
        """
        pieces: dict[str, list[slice]] = {}
        for own, offset in channels:
            for channel in own:
                pieces.setdefault(channel.name, []).extend(stretches(channel, offset))
        return cls(pieces={name: tuple(found) for name, found in pieces.items()})

    @property
    def orders(self) -> dict[str, int]:
        """Channel -> number of earlier samples that the noise of one depends on."""
        return {name: noise.order for name, noise in self.channels.items()}

    def with_white(self, deviations: Mapping[str, float]) -> AutoregressiveNoise:
        """White noise of these standard deviations, by channel."""
        channels = {name: ChannelNoise.white(deviation) for name, deviation in deviations.items()}
        return replace(self, channels=channels, levels={})

    def learned(
        self, residual: np.ndarray, freedom: Mapping[str, float], *, white: bool = False
    ) -> AutoregressiveNoise:
        """Noise of every channel estimated from residuals (M,), see `NoiseModel`."""
        order = 0 if white else None
        channels = {
            name: ChannelNoise.fitted([residual[piece] for piece in pieces], freedom.get(name, 0.0), order)
            for name, pieces in self.pieces.items()
        }
        return replace(self, channels=channels)

    def with_levels(self, residual: np.ndarray) -> AutoregressiveNoise:
        """The same with a level for every stretch, from residuals (M,).

        What shakes a vehicle on hard ground grows with its speed, and a stretch that the model misses
        should not outweigh all others.
        """
        levels = {}
        for name, pieces in self.pieces.items():
            for piece in pieces:
                white = self.channels[name].whiten(residual[piece])
                square = (float(white @ white) + _USUAL) / (len(white) + _USUAL)
                levels[piece.start] = float(np.sqrt(square))
        return replace(self, levels=levels)

    def on(self, other: AutoregressiveNoise) -> AutoregressiveNoise:
        """This noise in the stretches of other runs; channels of unknown noise are left out there."""
        pieces = {name: own for name, own in other.pieces.items() if name in self.channels}
        return AutoregressiveNoise(pieces=pieces, channels={name: self.channels[name] for name in pieces})

    def _level(self, piece: slice) -> float:
        return self.levels.get(piece.start, 1.0)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Whitened copy of (M,) or (M, k); rows of channels that are left out count nothing: 0."""
        out = np.zeros_like(columns)
        for name, pieces in self.pieces.items():
            noise = self.channels[name]
            for piece in pieces:
                out[piece] = noise.whiten(columns[piece])
                if self.levels:
                    out[piece] /= self._level(piece)
        return out

    def log_deviations(self, rows: int) -> np.ndarray:
        """Logarithm of the standard deviation of every sample's innovation, (rows,), without levels."""
        out = np.zeros(rows)
        for name, pieces in self.pieces.items():
            deviation = self.channels[name].deviation
            for piece in pieces:
                # As `ChannelNoise.whiten`: the first samples of a stretch by the lower orders.
                length = piece.stop - piece.start
                order = np.minimum(np.arange(length), len(deviation) - 1)
                out[piece] = np.log(deviation[np.minimum(order, length - 1)])
        return out

    def log_scale(self) -> float:
        """Sum of the logarithms of all standard deviations: part of -log L."""
        total = 0.0
        for name, pieces in self.pieces.items():
            for piece in pieces:
                length = piece.stop - piece.start
                total += self.channels[name].log_scale(length) + length * math.log(self._level(piece))
        return total
