"""Gain of an extended model on windows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.discrepancy.model.fit import autoregressive, stretches_of
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.linearisation import Jacobian, Linearisation
from estimators.discrepancy.model.problem import LeastSquaresProblem
from estimators.discrepancy.model.protocol import ForwardModel
from offroad_env.errors import OffroadError
from offroad_env.physics import state as at

__all__ = ["ChannelGain", "Held", "channel_gain", "channel_gains", "held_beside", "held_out"]

#: Length of the blocks that are drawn together, and how often [s, -].
_BLOCK, _DRAWS = 1.0, 2000
#: A window whose whitened residuals have this mean square is fitted again, from starts this far away [-, m].
_BAD, _BESIDE = 1.5, 0.25
#: Terrain that is simulated as a plane, where every start leads to the same minimum.
_LEVEL = ("flat", "unknown")


@dataclass(frozen=True, kw_only=True)
class Held:
    """A fitted model on held-out windows: only their starts were fitted."""

    fit: FitResult
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


def held_out(fit: FitResult, runs: Sequence[ForwardModel], near: Held | None = None) -> Held:
    """The model of ``fit`` on other windows: only their starts are fitted.

    Parameters
    ----------
    near
        Another model on these windows, whose starts are taken first.

    Raises
    ------
    SolverFailure
        When the model breaks down there.
    """
    problem = LeastSquaresProblem(runs) if near is None else near.fit.problem
    if near is None:
        point, jacobian = problem.begun(fit.point), Jacobian()
    else:
        own, starts = fit.point, near.fit.point
        point = replace(starts, nuisances=own.nuisances, candidates=own.candidates, sizes=own.sizes)
        jacobian = Jacobian(states=near.fit.jacobian.states)
    noise = autoregressive(fit).on(stretches_of(problem) if near is None else autoregressive(near.fit))
    other = FitResult(linearisation=Linearisation.at(problem, point), jacobian=jacobian, noise=noise)
    descent = GaussNewton(held=True)
    other = descent.descend(other, fresh=near is None)
    if problem.hard:
        other = replace(other, noise=noise.with_levels(other.residual))
        other = descent.descend(other)
    if any(run.log.config.terrain.kind not in _LEVEL for run in runs):
        other = _restarted(other, _beside(other.point.starts))
    return _held(other)


def held_beside(held: Held, near: Held) -> Held:
    """The same model with its badly fitted windows started where those of another model start."""
    fit = _restarted(held.fit, [near.fit.point.starts])
    return held if fit is held.fit else _held(fit)


def _held(fit: FitResult) -> Held:
    # The prior of the nuisances has counted where they were fitted.
    prior = fit.problem.nuisance_prior_cost(fit.point)
    return Held(fit=fit, residual=fit.residual, cost=fit.cost - prior + fit.noise.log_scale())


def _restarted(fit: FitResult, elsewhere: Sequence[Sequence[np.ndarray]]) -> FitResult:
    """The fit with windows that fit badly started elsewhere where that is better, else itself.

    Bumps make many local minima.
    """
    cost, starts, better = _by_window(fit), fit.point.starts, False
    usual = 0.5 * np.bincount(fit.problem.window, minlength=len(cost))
    for others in elsewhere:
        bad = cost > _BAD * usual
        if not bad.any():
            break
        try:
            trial = fit.moved(replace(fit.point, starts=_chosen(bad, others, starts)))
            trial = GaussNewton(held=True).descend(trial)
        except OffroadError:
            continue
        reached = _by_window(trial)
        gains = bad & (reached < cost)
        starts, cost = _chosen(gains, trial.point.starts, starts), np.where(gains, reached, cost)
        better |= bool(gains.any())
    if not better:
        return fit
    there = fit.moved(replace(fit.point, starts=starts))
    return replace(there, jacobian=there.jacobian.renewed_states(there.linearisation))


def _beside(starts: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
    """The starts of all windows before, behind, and on either side."""
    moved = []
    for place, step in ((at.X, _BESIDE), (at.X, -_BESIDE), (at.Y, _BESIDE), (at.Y, -_BESIDE)):
        moved.append([start.copy() for start in starts])
        for start in moved[-1]:
            start[:, place] += step
    return moved


def _by_window(fit: FitResult) -> np.ndarray:
    """Half the squared whitened residual of every window."""
    squares = fit.noise.whiten(fit.residual) ** 2
    return 0.5 * np.bincount(fit.problem.window, squares, minlength=len(fit.problem.window_rows))


def _chosen(
    these: np.ndarray, first: Sequence[np.ndarray], second: Sequence[np.ndarray]
) -> tuple[np.ndarray, ...]:
    """Starts of the ``first`` kind for these windows (W,), of the ``second`` for the others."""
    parts = np.split(these, np.cumsum([len(start) for start in first])[:-1])
    return tuple(np.where(part[:, None], a, b) for part, a, b in zip(parts, first, second, strict=True))


def channel_gains(nominal: Held, extended: Held, seed: int = 0) -> tuple[ChannelGain, ...]:
    """Residuals of both models by channel, with intervals over blocks of one second."""
    rng = np.random.default_rng(seed)
    found = []
    for name, pieces in nominal.fit.noise.pieces.items():
        blocks = [block for piece in pieces for block in _blocks(nominal.fit, name, piece)]
        before = np.array([np.sum(nominal.residual[block] ** 2) for block in blocks])
        after = np.array([np.sum(extended.residual[block] ** 2) for block in blocks])
        count = sum(piece.stop - piece.start for piece in pieces)
        found.append(channel_gain(name, before, after, count, rng))
    return tuple(found)


def channel_gain(
    channel: str, before: np.ndarray, after: np.ndarray, count: int, rng: np.random.Generator
) -> ChannelGain:
    """Gain of one channel, with a bootstrap interval over blocks of its samples.

    Parameters
    ----------
    before, after
        Squared residuals of the nominal and the extended model, summed by block, (B,).
    count
        Number of samples.
    rng
        Draws blocks with replacement.
    """
    draws = rng.integers(len(before), size=(_DRAWS, len(before)))
    ratio = 1.0 - np.sqrt(after[draws].sum(axis=1) / np.maximum(before[draws].sum(axis=1), 1e-300))
    low, high = np.quantile(ratio, (0.025, 0.975))
    return ChannelGain(
        channel=channel,
        nominal=float(np.sqrt(before.sum() / count)),
        extended=float(np.sqrt(after.sum() / count)),
        low=float(low),
        high=float(high),
    )


def _blocks(fit: FitResult, name: str, piece: slice) -> list[slice]:
    """A stretch of a channel in blocks of one second."""
    for run, offset in zip(fit.runs, fit.problem.offsets, strict=False):
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
