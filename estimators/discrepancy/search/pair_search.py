"""Pairs of effects that explain a log together, by its linearised scores: all pairs at once.

Where two effects are correlated, a third that is confounded with both may be the best at every step that adds
one effect at a time. With the information of all candidates at hand, the best pair costs no simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.normal_equations import projected
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.score_test import ScoreTest

__all__ = ["Proposal", "linearised_gain", "proposed_pairs"]

#: Least 1 - cos^2 of a pair: closer ones differ by less than the derivatives are worth.
_APART = 0.05


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """Effects that may explain a log, by the scores."""

    candidates: tuple[Candidate, ...]
    sizes: tuple[float, ...]
    gain: float  #: twice the log-likelihood beyond the model without any effect


def _scores(fit: FitResult, last: ScoreTest) -> np.ndarray:
    """Scores (E + C,) of all effects, in the model or not, if none were in the model."""
    inside = len(fit.sizes)
    scores: np.ndarray = last.joint[:, :inside] @ fit.sizes
    # In full: beside others an effect may stay within the range that it exceeds alone.
    scores[inside:] += np.where(last.z != 0.0, last.size * np.diag(last.information), 0.0)
    return scores


def linearised_gain(fit: FitResult, last: ScoreTest) -> float:
    """Gain of the effects of the model together, in twice the log-likelihood, by the scores."""
    inside = len(fit.sizes)
    return float(fit.sizes @ last.joint[:inside, :inside] @ fit.sizes)


def proposed_pairs(fit: FitResult, last: ScoreTest, kept: Sequence[int], count: int) -> list[Proposal]:
    """The best pairs added to the effects of the model that are ``kept``, best first, each set of names once.

    Parameters
    ----------
    kept
        Places in the model of effects that every proposal holds.
    count
        So many pairs at most.
    """
    inside, base = len(fit.sizes), len(kept)
    scores = _scores(fit, last)
    names = [*fit.candidates, *last.candidates]
    seen = np.concatenate([np.ones(inside, dtype=bool), np.diag(last.information) > 0.0])
    used = {names[i].effect for i in kept}
    free = [i for i in range(len(names)) if seen[i] and i not in kept and names[i].effect not in used]
    order = [*kept, *free]
    joint, score = projected(last.joint[np.ix_(order, order)], scores[order], base)
    held = last.joint[np.ix_(kept, kept)]
    fixed = float(scores[list(kept)] @ np.linalg.solve(held, scores[list(kept)])) if base else 0.0
    gain = _pair_gains(joint, score, [names[i].effect for i in free])
    found: dict[frozenset[str], Proposal] = {}
    for place in np.argsort(-gain, axis=None):
        i, j = np.unravel_index(place, gain.shape)
        if len(found) == count or not np.isfinite(gain[i, j]):
            break
        members = (*kept, free[i], free[j])
        key = frozenset(names[m].effect for m in members)
        if key in found:
            continue
        sizes = np.linalg.solve(last.joint[np.ix_(members, members)], scores[list(members)])
        found[key] = Proposal(
            candidates=tuple(names[m] for m in members),
            sizes=tuple(float(size) for size in sizes),
            gain=fixed + float(gain[i, j]),
        )
    return list(found.values())


def _pair_gains(joint: np.ndarray, score: np.ndarray, effects: Sequence[str]) -> np.ndarray:
    """(n, n) gain of each pair; -inf below the diagonal and for pairs of one effect or nearly one trace."""
    own = np.sqrt(np.maximum(np.diag(joint), 1e-300))
    z, cosines = score / own, joint / np.outer(own, own)
    apart = 1.0 - cosines**2
    both = z[:, None] ** 2 + z[None, :] ** 2 - 2.0 * cosines * z[:, None] * z[None, :]
    labels = np.array(effects)
    wrong = (apart < _APART) | (labels[:, None] == labels[None, :]) | np.tri(len(z), dtype=bool)
    return np.where(wrong, -np.inf, both / np.maximum(apart, _APART))
