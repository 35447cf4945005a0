"""Whiteness of the innovations of a fitted model, and the gain in log-likelihood by the second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from estimators.discrepancy.checks.holdout_gain import Held
from estimators.discrepancy.model.fit import autoregressive
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.run_model import drives

__all__ = ["LikelihoodGain", "Whiteness", "likelihood_gains", "whiteness_of"]

#: Lags at which innovations must not be correlated.
_LAGS = 25
_BLOCK, _DRAWS = 1.0, 2000


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Innovations of one channel."""

    channel: str
    count: int
    memory: int  #: order of the noise model
    spread: float  #: standard deviation of the innovations; 1 if the noise model is right
    correlation: float  #: largest autocorrelation at 1 ... 25 samples, with its sign
    lag: int  #: where
    bound: float  #: which white noise exceeds in 5 % of logs

    @property
    def white(self) -> bool:
        """Whether the correlation is within the bound of white noise."""
        return abs(self.correlation) <= self.bound


def whiteness_of(fit: FitResult) -> tuple[Whiteness, ...]:
    """Innovations by channel; no correlation is taken across a gap."""
    white, orders = fit.noise.whiten(fit.residual), fit.noise.orders
    found = []
    for name, pieces in fit.noise.pieces.items():
        parts = [white[piece] for piece in pieces]
        count = sum(len(part) for part in parts)
        power = max(sum(float(part @ part) for part in parts), 1e-300)
        lags = range(1, min(_LAGS, max(len(part) for part in parts) - 1) + 1)
        own = [sum(float(p[k:] @ p[:-k]) for p in parts if len(p) > k) / power for k in lags]
        worst = int(np.argmax(np.abs(own))) if own else 0
        found.append(
            Whiteness(
                channel=name,
                count=count,
                memory=orders[name],
                spread=float(np.sqrt(power / count)),
                correlation=float(own[worst]) if own else 0.0,
                lag=worst + 1,
                bound=float(norm.ppf(1.0 - 0.025 / max(len(own), 1)) / np.sqrt(count)),
            )
        )
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class LikelihoodGain:
    """Gain of the extended model on windows that no fit has seen [1/s]."""

    channel: str
    gain: float  #: log-likelihood by the second, extended less nominal
    low: float  #: 95 % interval
    high: float


def likelihood_gains(nominal: Held, extended: Held, *, seed: int = 0) -> tuple[LikelihoodGain, ...]:
    """Whitened log-likelihood by channel, with intervals over blocks of one second."""
    rng, found = np.random.default_rng(seed), []
    change = _likelihoods(extended) - _likelihoods(nominal)
    for name in nominal.fit.noise.pieces:
        blocks, values = [], []
        for k, run in enumerate(drives(nominal.fit.runs)):
            for channel in run.channels:
                if channel.name == name:
                    rows = slice(channel.rows.start + nominal.fit.problem.offsets[k], None)
                    values.append(change[rows][: len(channel.t)])
                    blocks.append(k * 1_000_000 + ((channel.t - run.t_0) / _BLOCK).astype(int))
        _, cell = np.unique(np.concatenate(blocks), return_inverse=True)
        sums = np.bincount(cell, np.concatenate(values))
        drawn = sums[rng.integers(len(sums), size=(_DRAWS, len(sums)))].mean(axis=1) / _BLOCK
        low, high = np.quantile(drawn, (0.025, 0.975))
        found.append(
            LikelihoodGain(channel=name, gain=float(sums.mean() / _BLOCK), low=float(low), high=float(high))
        )
    return tuple(found)


def _likelihoods(held: Held) -> np.ndarray:
    """Log-likelihood of every sample given those before it, up to a constant, (M,)."""
    noise = autoregressive(held.fit)
    white = noise.whiten(held.residual)
    return np.asarray(-0.5 * white**2 - noise.log_deviations(len(white)))
