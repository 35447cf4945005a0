"""A search again without the first name, where its causes leave a rest.

The first effect is the one that explains most alone, and a late steering alone does what a slow one and a
wrong steering ratio do together. What is added afterwards repairs what that choice has made worse, and no
exchange of one effect leads back, since the noise of the model has been fitted with it. So the search is made
without it, and the explanation that is better as a whole, each in its own noise, counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.null_simulations import inflation_along
from estimators.discrepancy.model.protocol import ForwardModel
from estimators.discrepancy.search.holdout import HoldOutTest
from estimators.discrepancy.search.result import SearchResult
from estimators.discrepancy.search.score_test import score_threshold
from estimators.discrepancy.search.stepwise import search

__all__ = ["better_without_first", "leaves_a_rest"]


def better_without_first(
    found: SearchResult, library: Sequence[str], rate: float, apart: Sequence[ForwardModel] = ()
) -> SearchResult | None:
    """What a search finds without the first name of another; None unless it explains more.

    Parameters
    ----------
    found
        The other search.
    library
        Effects among which causes are sought.
    rate
        Share of null logs in which the first scores may find something.
    apart
        Windows of the hold-out tests.

    Raises
    ------
    OffroadError
        When the search breaks down.
    """
    first = found.extended.candidates[0].effect
    other = search(found.nominal, [name for name in library if name != first], rate, apart)
    return other if _better(other, found, apart) else None


def leaves_a_rest(found: SearchResult, rate: float) -> bool:
    """Whether causes are found, and scores of others are significant beside them."""
    if not found.causes:
        return False
    left = float(np.abs(found.last.z).max(initial=0.0))
    return found.refused or left > score_threshold(found.last, rate)


def _better(other: SearchResult, found: SearchResult, apart: Sequence[ForwardModel]) -> bool:
    """Whether the other search explains more by as much as an effect must, and as each that it has more.

    On natural ground road and soil scatter along the difference of the models, and by so much less counts
    what it gains. The windows apart must not contradict.
    """
    if not other.causes:
        return False
    more = len(other.extended.sizes) - len(found.extended.sizes)
    gain = found.extended.minus_log_likelihood - other.extended.minus_log_likelihood
    if gain / _scatter(other.extended, found.extended) <= 0.5 * found.threshold**2 * (1 + max(more, 0)):
        return False
    result = HoldOutTest(found.extended, apart).result(other.extended)
    return result is None or not result.contradicts


def _scatter(better: FitResult, less: FitResult) -> float:
    """Variance of null simulations along the difference of two models, over that of white noise."""
    if better.null is None:
        return 1.0
    difference = better.noise.whiten((less.residual - better.residual)[:, None])
    return inflation_along(better.without_states(difference)[:, 0], better.null.white)
