"""What an extended model gains on windows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.fit import Fit
from estimators.discrepancy.run_model import RunModel

__all__ = ["ChannelGain", "Held", "channel_gains", "held_out"]

#: Length of the blocks that are drawn together, and how often [s, -].
_BLOCK, _DRAWS = 1.0, 2000


@dataclass(frozen=True, kw_only=True)
class Held:
    """A fitted model on windows of its own: only their starts were fitted."""

    fit: Fit
    residual: np.ndarray  #: (M,)
    cost: float  #: minus the log-likelihood, up to a constant


@dataclass(frozen=True, kw_only=True)
class ChannelGain:
    """Root mean square residual of a channel."""

    channel: str
    nominal: float
    extended: float
    low: float  #: 95 % interval of 1 - extended / nominal
    high: float


def held_out(fit: Fit, runs: Sequence[RunModel]) -> Held:
    """The model of ``fit`` on other windows: parameters and noise as they are.

    Raises
    ------
    SolverFailure
        When the model breaks down there.
    """
    other = Fit(runs)
    other.candidates, other.sizes, other.nuisances = fit.candidates, fit.sizes.copy(), fit.nuisances.copy()
    other.begin()
    known = fit.whitener.noise
    other.whitener.noise = {name: known[name] for name in other.whitener.pieces if name in known}
    for name in other.whitener.pieces.keys() - known.keys():
        del other.whitener.pieces[name]
    other.descend(held=True)
    if other.hard:
        other.whitener.learn_levels(other.residual())
        other.descend(held=True)
    residual = other.residual()
    return Held(fit=other, residual=residual, cost=other.cost_of(residual) + other.whitener.log_scale())


def channel_gains(nominal: Held, extended: Held, seed: int = 0) -> tuple[ChannelGain, ...]:
    """Residuals of both models by channel, with intervals over blocks of one second."""
    rng = np.random.default_rng(seed)
    found = []
    for name, pieces in nominal.fit.whitener.pieces.items():
        blocks = [block for piece in pieces for block in _blocks(nominal.fit, name, piece)]
        before = np.array([np.sum(nominal.residual[block] ** 2) for block in blocks])
        after = np.array([np.sum(extended.residual[block] ** 2) for block in blocks])
        draws = rng.integers(len(blocks), size=(_DRAWS, len(blocks)))
        ratio = 1.0 - np.sqrt(after[draws].sum(axis=1) / np.maximum(before[draws].sum(axis=1), 1e-300))
        count = sum(piece.stop - piece.start for piece in pieces)
        low, high = np.quantile(ratio, (0.025, 0.975))
        found.append(
            ChannelGain(
                channel=name,
                nominal=float(np.sqrt(before.sum() / count)),
                extended=float(np.sqrt(after.sum() / count)),
                low=float(low),
                high=float(high),
            )
        )
    return tuple(found)


def _blocks(fit: Fit, name: str, piece: slice) -> list[slice]:
    for run, offset in zip(fit.runs, fit.offsets, strict=False):
        for channel in run.channels:
            if (
                channel.name == name
                and channel.rows.start + offset <= piece.start < channel.rows.stop + offset
            ):
                start = piece.start - channel.rows.start - offset
                steps = np.diff(channel.t[start : start + piece.stop - piece.start])
                # Lost samples may leave one alone.
                size = max(round(_BLOCK / float(np.median(steps))), 1) if len(steps) else 1
                return [slice(a, min(a + size, piece.stop)) for a in range(piece.start, piece.stop, size)]
    raise ValueError(f"no channel {name} at row {piece.start}")
