"""Delays too long for a score: those of commands that change faster than they are late.

A score is the derivative of the likelihood by the delay, at none. Under a steering that is corrected many
times per second it does not reach as far as a tenth of a second, where the motion is another one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.run_model import RunModel, drives
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["delayed"]

#: Effects that delay commands.
_DELAYS = ("steer_delay", "clock_offset")
#: Delays that are tried, in plausible ones.
_SHARES = (-1.0, -0.66, -0.33, 0.33, 0.66, 1.0)
#: Correlation of the changes of the steering with themselves, the least delay later, from which a score sees
#: the delay.
_SMOOTH = 0.5


def delayed(fit: FitResult, candidates: Sequence[Candidate], threshold: float) -> list[FitResult]:
    """Models with a delay more that explain as much as an effect must, where no score could tell.

    Parameters
    ----------
    candidates
        Effects that may be added.
    threshold
        Least size of an effect in standard deviations.
    """
    asked = [one for one in candidates if one.effect in _DELAYS]
    if not asked:
        return []
    runs, vehicle = drives(fit.runs), fit.runs[0].setup.plant.vehicle
    least = min(map(abs, _SHARES)) * EFFECTS[asked[0].effect].plausible(vehicle)
    if all(_smooth(run, least) for run in runs):
        return []
    base = fit.completed()
    known = np.linalg.qr(base.without_states(base.white_shared()))[0]
    found = []
    for one in asked:
        reach = EFFECTS[one.effect].plausible(vehicle)
        trials = [(_gain(base, known, one, share * reach), share * reach) for share in _SHARES]
        gain, size = max(trials)
        # A first look; what is fitted must gain as much.
        if gain > 0.5 * threshold**2:
            try:
                begun = fit.with_effects([*fit.candidates, one], [*fit.sizes, size])
                found.append(GaussNewton().descend(begun, fresh=False))
            except OffroadError:
                continue
    return [trial for trial in found if fit.cost - trial.cost > 0.5 * threshold**2]


def _smooth(run: RunModel, delay: float) -> bool:
    """Whether the steering changes as it did a delay [s] before."""
    t, values = run.log.samples("steer")
    even = np.arange(t[0], t[-1], run.step)
    change, late = np.diff(np.interp(even, t, values)), round(delay / run.step)
    power = float(change @ change)
    return power == 0.0 or float(change[late:] @ change[:-late]) >= _SMOOTH * power


def _gain(base: FitResult, known: np.ndarray, candidate: Candidate, size: float) -> float:
    """Gain in the log-likelihood of an effect of this size, where all else may follow in a linear way.

    Parameters
    ----------
    known : (M, g)
        Orthonormal columns of what all windows share.
    """
    try:
        other = base.with_effects([*base.candidates, candidate], [*base.sizes, size])
    except OffroadError:
        return -np.inf
    left = [_rest(base, known, residual) for residual in (base.residual, other.residual)]
    return 0.5 * (left[0] - left[1])


def _rest(base: FitResult, known: np.ndarray, residual: np.ndarray) -> float:
    """Square of the whitened residual that neither starts nor shared parameters can take away."""
    white = base.without_states(base.noise.whiten(residual)[:, None])[:, 0]
    return float(white @ white - np.sum((known.T @ white) ** 2))
