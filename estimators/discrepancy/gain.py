"""What an extended model gains on windows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.fit import Fit
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.run_model import RunModel
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at

__all__ = ["ChannelGain", "Held", "channel_gains", "held_beside", "held_out"]

#: Length of the blocks that are drawn together, and how often [s, -].
_BLOCK, _DRAWS = 1.0, 2000
#: A window whose whitened residuals have this mean square begins again, so far beside its start [-, m].
_BAD, _BESIDE = 1.5, 0.25
#: Ground on which it is simulated as on a plane, where every start leads to the one minimum.
_LEVEL = ("flat", "unknown")


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


def held_out(fit: Fit, runs: Sequence[RunModel], near: Held | None = None) -> Held:
    """The model of ``fit`` on other windows: parameters and noise as they are.

    Parameters
    ----------
    near
        Another model on these windows: they begin where its do.

    Raises
    ------
    SolverFailure
        When the model breaks down there.
    """
    other = Fit(runs) if near is None else near.fit.branch()
    other.candidates, other.sizes, other.nuisances = fit.candidates, fit.sizes.copy(), fit.nuisances.copy()
    if near is None:
        other.begin()
    other.forget_shared()
    other.whitener.levels = {}
    known = fit.whitener.noise
    other.whitener.noise = {name: known[name] for name in other.whitener.pieces if name in known}
    for name in other.whitener.pieces.keys() - known.keys():
        del other.whitener.pieces[name]
    other.descend(fresh=near is None, held=True)
    if other.hard:
        other.whitener.learn_levels(other.residual())
        other.descend(held=True)
    if any(run.log.config.terrain.kind not in _LEVEL for run in runs):
        _begin_again(other, _beside(other.starts))
    return _held(other)


def held_beside(held: Held, near: Held) -> Held:
    """The same model, whose windows that fit badly begin where those of another model do."""
    fit = held.fit.branch()
    return _held(fit) if _begin_again(fit, [near.fit.starts]) else held


def _held(fit: Fit) -> Held:
    residual = fit.residual()
    # What is believed of the nuisances has counted where they were fitted.
    spread = np.array([nuisance.spread for nuisance in NUISANCES])
    beliefs = 0.5 * float(np.sum((fit.nuisances / spread) ** 2))
    return Held(fit=fit, residual=residual, cost=fit.cost_of(residual) - beliefs + fit.whitener.log_scale())


def _begin_again(fit: Fit, elsewhere: Sequence[list[np.ndarray]]) -> bool:
    """Start windows that fit badly elsewhere too; whether that was better. Bumps make many valleys."""
    cost, better = _by_window(fit), False
    usual = 0.5 * np.bincount(fit.window, minlength=len(cost))
    for starts in elsewhere:
        bad = cost > _BAD * usual
        if not bad.any():
            break
        trial = fit.branch()
        trial.starts = _chosen(bad, starts, fit.starts)
        try:
            trial.descend(held=True)
        except OffroadError:
            continue
        reached = _by_window(trial)
        gains = bad & (reached < cost)
        fit.starts, cost = _chosen(gains, trial.starts, fit.starts), np.where(gains, reached, cost)
        better |= bool(gains.any())
    if better:
        fit.residual()
        fit.linearise(shared=False)
    return better


def _beside(starts: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """The starts of all windows before, behind, and on either side."""
    moved = []
    for place, step in ((at.X, _BESIDE), (at.X, -_BESIDE), (at.Y, _BESIDE), (at.Y, -_BESIDE)):
        moved.append([start.copy() for start in starts])
        for start in moved[-1]:
            start[:, place] += step
    return moved


def _by_window(fit: Fit) -> np.ndarray:
    """Half the squared whitened residual of every window."""
    count = sum(len(start) for start in fit.starts)
    return 0.5 * np.bincount(fit.window, fit.whitener(fit.residual()) ** 2, minlength=count)


def _chosen(these: np.ndarray, first: Sequence[np.ndarray], second: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Starts of the ``first`` kind for these windows (W,), of the ``second`` for the others."""
    parts = np.split(these, np.cumsum([len(start) for start in first])[:-1])
    return [np.where(part[:, None], a, b) for part, a, b in zip(parts, first, second, strict=True)]


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
