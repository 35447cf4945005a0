"""Where fits begin that stated numbers do not lead to: effects by what they cost before anything is fitted.

One simulation with the rough solver costs a hundredth of a fit, and about the right effect, size and exponent
its cost is least by far, whatever the numbers of a model without the effect have done.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

from estimators.discrepancy.families import DRIVE_FAMILIES, families_of
from estimators.discrepancy.model.fit import unfitted_cost
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.search.lower_minimum import exponents
from offroad_env.effects import EFFECTS

__all__ = ["Begin", "begin_of", "begins_of_pairs", "looked_at"]

#: Sizes to begin from, as shares of a plausible one; about the best others so much larger and smaller.
_SHARES, _FINER = (-0.8, -0.4, 0.4, 0.8), 0.2
#: Likewise exponents n about the best.
_NEAR_N = 0.1
#: Effects without a score to speak of that are looked at closely.
_CLOSELY = 3
#: Of pairs: so many first effects, second ones beside each that are looked at closely, and pairs to fit.
_FIRSTS, _BESIDE, _PAIRS = 3, 2, 4


class Begin(NamedTuple):
    """Where the fit of a model with one or two effects begins."""

    cost: float  #: before anything is fitted
    candidates: tuple[Candidate, ...]
    sizes: tuple[float, ...]
    n: float


def begin_of(fit: FitResult, candidate: Candidate) -> Begin | None:
    """The size and the exponent that cost least before anything is fitted; None without a solution."""
    best = _coarse(fit, candidate, exponents(fit))
    return None if best is None else _closely(fit, best)


def looked_at(fit: FitResult, candidates: Iterable[Candidate], n: float) -> list[Begin]:
    """Other effects, those that act on the motion, about one exponent; the best of them closely."""
    moving = [one for one in candidates if EFFECTS[one.effect].hook != "sensor"]
    rough = sorted((begin for one in moving if (begin := _coarse(fit, one, [n])) is not None), key=_cost)
    return [*(_closely(fit, one) for one in rough[:_CLOSELY]), *rough[_CLOSELY:]]


def begins_of_pairs(fit: FitResult, begins: Sequence[Begin]) -> list[Begin]:
    """Two effects of different families at once, made of those of one; the least cost first.

    What two large effects do is seldom the sum of what each does, and numbers that stand for both are far
    from what scores can see.
    """
    order = sorted(begins, key=_cost)
    found: dict[frozenset[str], Begin] = {}
    for first in _of_different_families(order, _FIRSTS):
        beside = [second for second in order if not _related(first, second)]
        tried = [_coarse(fit, second.candidates[0], [first.n], first) for second in beside]
        less = sorted((one for one in tried if one is not None and one.cost < first.cost), key=_cost)
        for pair in _of_different_families(less, _BESIDE):
            names = frozenset(one.effect for one in pair.candidates)
            found[names] = min(pair, found.get(names, pair), key=_cost)
    return sorted((_closely(fit, one) for one in found.values()), key=_cost)[:_PAIRS]


def _of_different_families(begins: Iterable[Begin], most: int) -> list[Begin]:
    """The first of the begins, as long as their last effects are no variants of one thing."""
    found: list[Begin] = []
    for one in begins:
        if len(found) < most and not any(_related(one, other) for other in found):
            found.append(one)
    return found


def _cost(begin: Begin) -> float:
    return begin.cost


def _related(one: Begin, other: Begin) -> bool:
    """Whether the last effects of two are variants of one thing."""
    own, theirs = (families_of([begin.candidates[-1].effect], DRIVE_FAMILIES) for begin in (one, other))
    return one is other or bool(set(own) & set(theirs))


def _coarse(
    fit: FitResult, candidate: Candidate, ns: Iterable[float], first: Begin | None = None
) -> Begin | None:
    """The best of a few sizes of an effect, beside a first one."""
    candidates, sizes = ((), ()) if first is None else (first.candidates, first.sizes)
    reach = _reach(fit, candidate)
    proposals = [(*sizes, share * reach) for share in _SHARES]
    best = _best(fit, (*candidates, candidate), proposals, ns)
    return best if best is not None and math.isfinite(best.cost) else None


def _closely(fit: FitResult, begin: Begin) -> Begin:
    """The best about a place that is known."""
    steps = [[share * _reach(fit, one) for share in (-_FINER, 0.0, _FINER)] for one in begin.candidates]
    around = [tuple(a + b for a, b in zip(begin.sizes, step, strict=True)) for step in product(*steps)]
    ns = [begin.n] if fit.problem.hard else [begin.n - _NEAR_N, begin.n, begin.n + _NEAR_N]
    other = _best(fit, begin.candidates, around, ns)
    return begin if other is None or begin.cost <= other.cost else other


def _best(
    fit: FitResult,
    candidates: tuple[Candidate, ...],
    proposals: Iterable[tuple[float, ...]],
    ns: Iterable[float],
) -> Begin | None:
    """The proposed sizes within their physical ranges, and the exponent, that cost least."""
    limits = [fit.runs[0].size_limits(one.effect) for one in candidates]
    within = [p for p in proposals if all(low <= x <= high for x, (low, high) in zip(p, limits, strict=True))]
    tried = [Begin(unfitted_cost(fit, candidates, p, n), candidates, p, n) for p, n in product(within, ns)]
    return min(tried, key=_cost, default=None)


def _reach(fit: FitResult, candidate: Candidate) -> float:
    return EFFECTS[candidate.effect].plausible(fit.runs[0].setup.plant.vehicle)
