"""A wider search where the first one leaves something.

Scores about a nominal model lead to the right effects in most drives, in seconds. Where its numbers have
taken the place of an effect they may lead elsewhere, and what they lead to leaves a rest, or numbers that no
tolerance explains. Then effects are also fitted from stated numbers, one by one and in pairs, which takes a
minute. The explanation that is better as a whole counts, each in its own noise: a first effect that is best
alone need not belong to the best model of several. On a hard floor a late steering alone does what a slow one
and a wrong steering ratio do together, and no exchange of one effect leads from the one to the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.discrepancy.model.protocol import ForwardModel
from estimators.discrepancy.search.holdout import HoldOutTest
from estimators.discrepancy.search.lower_minimum import LEFT, astray, strayed
from estimators.discrepancy.search.result import SearchResult, scatter_between
from estimators.discrepancy.search.score_test import score_threshold
from estimators.discrepancy.search.stepwise import search

__all__ = ["incomplete", "looked_again"]

#: Share of models with the right effects beside which noise alone gives a score that counts as a rest.
_RARE = 0.005


def looked_again(
    found: SearchResult, library: Sequence[str], rate: float, apart: Sequence[ForwardModel] = ()
) -> SearchResult:
    """What a wider search finds, or what is ``found`` already: the better explanation.

    Parameters
    ----------
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
    other = search(found.nominal, library, rate, apart, wide=True)
    return other if _better(other, found, apart) else found


def incomplete(found: SearchResult) -> bool:
    """Whether a wider search may find what this one leaves: numbers far off, or a rest beside causes.

    What noise does in some logs is not worth the time. Where the nominal model has numbers about as stated
    there is no wider search.
    """
    if not astray(found.nominal):
        return False
    if strayed(found.extended, LEFT):
        return True
    left = float(np.abs(found.last.z).max(initial=0.0))
    return bool(found.causes) and (found.refused or left > score_threshold(found.last, _RARE))


def _better(other: SearchResult, found: SearchResult, apart: Sequence[ForwardModel]) -> bool:
    """Whether another explanation gains as much as an effect must, and as each that it has more.

    With fewer effects it may gain less by as much. On natural ground road and soil scatter along the
    difference of the models, and by so much less counts what it gains. The windows apart must not contradict.
    """
    if not other.causes or not found.causes:
        return bool(other.causes)
    more = len(other.extended.sizes) - len(found.extended.sizes)
    gain = found.extended.minus_log_likelihood - other.extended.minus_log_likelihood
    must = 0.5 * found.threshold**2 * (1 + more)
    if gain / scatter_between(other.extended, found.extended) <= must:
        return False
    result = HoldOutTest(found.extended, apart).result(other.extended)
    return result is None or not result.contradicts
