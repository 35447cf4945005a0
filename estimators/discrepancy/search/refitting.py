"""A model with other effects fitted from one that is fitted: where the descent begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.gauss_newton import GaussNewton
from estimators.discrepancy.model.parameters import Candidate
from offroad_env.effects import EFFECTS
from offroad_env.errors import OffroadError

__all__ = ["refit"]

#: Sizes to descend from where several minima are known, in plausible sizes.
_TIMING_STARTS = (0.2, 0.4, 0.7, 1.0)


def _starts(
    fit: FitResult, candidates: Sequence[Candidate], sizes: Sequence[float] | np.ndarray, new: int
) -> list[np.ndarray]:
    """Sizes (E,) to descend from: timing has several minima, and a step by the scores may lead too far.

    It moves the effect, while the numbers that have taken its place so far stay: both together may stop the
    vehicle, and no descent leads back. So the model that is fitted is a start, too, with what is new off.
    """
    effect = EFFECTS[candidates[new].effect]
    reach = effect.plausible(fit.runs[0].setup.plant.vehicle)
    point = np.array(sizes, dtype=np.float64)
    point[new] = np.clip(point[new], -2.0 * reach, 2.0 * reach)
    if effect.family != "timing":
        known = {one.effect: float(size) for one, size in zip(fit.candidates, fit.sizes, strict=True)}
        off = [known.get(one.effect, EFFECTS[one.effect].size.off) for one in candidates]
        return [point, np.array(off)]
    starts = [point]
    for share in _TIMING_STARTS:
        starts.append(point.copy())
        starts[-1][new] = share * reach
    return starts


def refit(
    fit: FitResult,
    candidates: Sequence[Candidate],
    sizes: Sequence[float] | np.ndarray,
    new: int = -1,
    enough: float = np.inf,
) -> FitResult | None:
    """The model with these effects fitted, the noise as it is; None if it breaks down.

    Parameters
    ----------
    new
        Place of the effect whose size is least known.
    enough
        What cannot cost less is not fitted to the end.
    """
    best: FitResult | None = None
    for point in _starts(fit, candidates, sizes, new):
        try:
            trial = fit.with_effects(candidates, point)
        except OffroadError:
            continue
        if best is None or trial.cost < best.cost:
            best = trial
    if best is None:
        return None
    try:
        return GaussNewton(enough=enough).descend(best, fresh=False)
    except OffroadError:
        return None
