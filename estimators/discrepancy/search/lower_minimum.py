"""Better minima of models that are fitted.

A fit may stand in a poor minimum, and an effect that is added lead out of it while its size comes to nothing:
what was gained is then the smaller model's own, and no evidence for the effect. So it is where windows apart
reject the effect. And what a large effect has done to the numbers of a model without it need not come undone
once the model has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.discrepancy.model.fit import HOPELESS, begun_afresh, settled, unfitted_cost
from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from offroad_env.errors import OffroadError

__all__ = [
    "LEFT",
    "astray",
    "begun_again",
    "beside_rejected",
    "deviations_off",
    "exponents",
    "lower_minimum",
    "strayed",
]

#: Standard deviations from a stated number from which it is suspected. In 60 natural logs of unmodified
#: vehicles, which nothing was chosen on before, none was further off than 4.1.
LEFT = 4.5
#: A model is fitted again from what is stated where a number is so many standard deviations off, or the
#: sinkage exponent so far: that costs time and decides nothing.
_ASTRAY, _ASTRAY_N = 3.5, 0.25
#: Sinkage exponents to begin from, besides the stated one: of soft clay, of sand and between, see
#: J. Y. Wong, Theory of Ground Vehicles (2008), table 2.3.
_EXPONENTS = (0.3, 0.5, 0.7, 0.9, 1.1)


def deviations_off(fit: FitResult) -> np.ndarray:
    """(N,) distance of every number from what is stated [its standard deviations]."""
    return np.asarray(np.abs(fit.nuisances) / fit.problem.nuisance_spread)


def astray(fit: FitResult) -> bool:
    """Whether a fit has left what is stated so far that there may be a better one near it."""
    problem, away = fit.problem, bool(np.any(deviations_off(fit) > _ASTRAY))
    return away or (
        not problem.hard and abs(problem.exponent(fit.point) - problem.exponent(problem.stated())) > _ASTRAY_N
    )


def strayed(fit: FitResult, deviations: float) -> list[str]:
    """Stated numbers of vehicle and soil that a fit has moved by more than so many standard deviations."""
    away = deviations_off(fit) > deviations
    pairs = zip(fit.problem.nuisances, away, strict=True)
    return [nuisance.name for nuisance, far in pairs if far and nuisance.tolerated]


def lower_minimum(fit: FitResult, larger: FitResult, bar: float) -> FitResult | None:
    """A model with effects of ``fit`` alone at a minimum beside that of a ``larger`` one; None if not lower.

    Parameters
    ----------
    larger
        Has other effects, besides or in their place. Where all of these are significant nothing is tried.
    bar
        Least size of a significant effect in standard deviations; the cost must fall by as much as for one.
    """
    inside = _inside(fit, larger)
    strength = np.abs(larger.sizes) / larger.size_deviations()
    return None if np.min(strength[~inside], initial=np.inf) > bar else _beside(fit, larger, bar)


def beside_rejected(fit: FitResult, rejected: Sequence[FitResult], bar: float) -> FitResult | None:
    """The best minimum of a model beside larger ones that were rejected, if it is lower; else None.

    Where numbers are far from what is stated the noise learned there is large: it holds the model in place,
    and hides from windows apart what is right. A larger model in a smaller noise of its own may lead out.

    Parameters
    ----------
    rejected
        Larger models, each in a noise of its own.
    bar
        As that of `lower_minimum`, but for significant effects, which are no evidence once they are rejected.
    """
    if not astray(fit):
        return None
    found = [lower for larger in rejected if (lower := _beside(fit, larger, bar)) is not None]
    return min(found, key=lambda one: one.minus_log_likelihood, default=None)


def _inside(fit: FitResult, larger: FitResult) -> np.ndarray:
    """Mask (E,) of the effects of a larger model that the smaller one has, too."""
    names = {candidate.effect for candidate in fit.candidates}
    return np.array([candidate.effect in names for candidate in larger.candidates], dtype=bool)


def _beside(fit: FitResult, larger: FitResult, bar: float) -> FitResult | None:
    """The smaller model at a minimum beside that of the larger one; None if it is not lower."""
    inside = _inside(fit, larger)
    kept = [candidate for candidate, own in zip(larger.candidates, inside, strict=True) if own]
    try:
        begun = replace(larger.with_effects(kept, larger.sizes[inside]), noise=fit.noise)
        lower = GaussNewton().descend(begun, fresh=False)
        if fit.cost - lower.cost <= 0.5 * bar**2:
            return None
        return settled(lower, fresh=False)
    except OffroadError:
        return None


def begun_again(fit: FitResult) -> FitResult:
    """The model fitted from stated numbers, if the fit has left these and that is better; else as it is.

    From several exponents: one that is far from the stated n may lie behind a ridge.
    """
    if not astray(fit):
        return fit
    model = fit.candidates, fit.sizes.tolist()
    n = min(exponents(fit), key=lambda n: unfitted_cost(fit, *model, n))
    try:
        begun = begun_afresh(fit, *model, n=n)
        if begun.cost > HOPELESS * fit.cost:
            return fit
        other = settled(GaussNewton().descend(begun), fresh=False)
    except OffroadError:
        return fit
    return min(fit, other, key=lambda one: one.minus_log_likelihood)


def exponents(fit: FitResult) -> list[float]:
    """Sinkage exponents that a fit may begin from: the stated one first; on hard ground no other."""
    stated = fit.problem.exponent(fit.problem.stated())
    return [stated] if fit.problem.hard else [stated, *_EXPONENTS]
