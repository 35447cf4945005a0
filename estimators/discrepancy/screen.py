"""Which effects the residuals ask for: their scores, and how large chance alone makes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimators.discrepancy.fit import Candidate, Fit
from estimators.discrepancy.nuisances import NUISANCES
from estimators.discrepancy.road import widening
from offroad_env.effects import EFFECTS
from offroad_env.physics import state as at

__all__ = ["Screen", "candidates_for", "chance_threshold", "closely", "screen"]

#: An effect whose largest plausible size would move its score by less than this is no candidate at all.
_NOTHING = 0.4
#: Distances of the places at which a large effect is sought, and then beside the best of them [m].
_CLOSE, _CLOSER = 0.5, 0.1
#: Draws of the largest score under chance.
_DRAWS = 20_000
#: Size that is found with 90 % power among about 36 effects at 5 % family-wise, in standard deviations.
DETECTABLE = 4.42


@dataclass(frozen=True, kw_only=True)
class Screen:
    """Scores of candidates at one point of the fit."""

    candidates: tuple[Candidate, ...]
    z: np.ndarray  #: (C,) score over its standard deviation; 0 where the log says nothing
    information: np.ndarray  #: (C, C) Fisher information of the sizes, nuisances projected out
    size: np.ndarray  #: (C,) size that one step of the fit would give
    columns: np.ndarray  #: (M, C) derivatives of the data by the sizes, not whitened
    joint: np.ndarray  #: (E + C, E + C) the same with the E effects in the model, before the candidates
    white: np.ndarray  #: (M, g + C) whitened derivatives by what is in the model and by the candidates

    @property
    def deviation(self) -> np.ndarray:
        """(C,) standard deviation of each size if it were alone; infinite where the log says nothing."""
        own = np.diag(self.information)
        with np.errstate(divide="ignore"):
            return np.where(own > 0.0, 1.0 / np.sqrt(np.maximum(own, 1e-300)), np.inf)

    def scores(self, fit: Fit, residual: np.ndarray) -> np.ndarray:
        """Scores (C,) that residuals (M,) would have at this point of the fit."""
        shares, _ = fit.reduce(fit.whitener(residual), fit.whitener(fit._states), self.white)
        prior = _prior_score(fit, self.white.shape[1])
        inside = len(shares.score) - len(self.candidates)
        _, score = projected(shares.normal, shares.score - prior, inside)
        return np.where(np.diag(self.information) > 0.0, score * np.minimum(self.deviation, 1e300), 0.0)

    def limits(self) -> dict[str, float]:
        """Smallest size of every effect that would have been seen, in the size's unit."""
        found: dict[str, float] = {}
        for candidate, deviation in zip(self.candidates, self.deviation, strict=True):
            found[candidate.effect] = min(found.get(candidate.effect, np.inf), DETECTABLE * deviation)
        return found

    def cosines(self) -> np.ndarray:
        """(C, C) how alike two effects look to this log, -1 ... 1."""
        own = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        return self.information / np.outer(own, own)

    def by_effect(self) -> tuple[list[str], np.ndarray]:
        """Effects that the data see, and how alike each two look (E, E), where each shows most."""
        strength, best = np.diag(self.information), {}
        for i in np.argsort(strength):
            if strength[i] > 0.0:
                best[self.candidates[i].effect] = int(i)
        names = sorted(best)
        places = [best[name] for name in names]
        return names, self.cosines()[np.ix_(places, places)]


def route_of(fit: Fit) -> np.ndarray:
    """Where the vehicle went, by the model at the present point, (T, 2) [m]."""
    fit.residual()
    return np.concatenate([records.states[::10, [at.X, at.Y]] for records in fit._records])


def candidates_for(fit: Fit, library: Sequence[str]) -> list[Candidate]:
    """Candidates of the effects that mean something for these runs.

    An effect that needs a channel which no run has is left out: see `missing`.
    """
    run, route, found = fit.runs[0], None, []
    for name in library:
        effect = EFFECTS[name]
        if not effect.searched or run.setup.model not in effect.models:
            continue
        hard = run.setup.plant.soil.rigid > 0.5
        if (effect.soil_only and hard) or (effect.hard_only and not hard):
            continue
        if not all(any(channel in run.log.channels for channel in group) for group in effect.needs):
            continue
        if effect.places is None:
            found.append(Candidate(effect=name))
            continue
        route = route_of(fit) if route is None else route
        found.extend(Candidate(effect=name, place=place) for place in effect.places(route))
    return found


def screen(fit: Fit, candidates: Sequence[Candidate]) -> Screen:
    """Scores of ``candidates``, none of which is in the model, at the present point of ``fit``.

    Derivatives change little from one model to the next, and what stands out is refitted anyway: those
    that are known already serve again.
    """
    residual = fit.residual()
    none = np.empty((len(residual), 0))
    columns = np.column_stack([none, *(fit.column(c) for c in candidates)])
    return screened(fit, candidates, residual, columns)


def screened(fit: Fit, candidates: Sequence[Candidate], residual: np.ndarray, columns: np.ndarray) -> Screen:
    """Scores from residuals (M,) and derivatives (M, C)."""
    held = fit.columns()
    if fit._states is None:
        fit._states = fit.state_columns()
    white = fit.whitener(np.column_stack([held, columns]))
    shares, _ = fit.reduce(fit.whitener(residual), fit.whitener(fit._states), white)
    own = held.shape[1]
    joint, joint_score = projected(shares.normal, shares.score, len(NUISANCES))
    information, score = projected(joint, joint_score, own - len(NUISANCES))
    vehicle = fit.runs[0].setup.plant.vehicle
    plausible = np.array([EFFECTS[c.effect].plausible(vehicle) for c in candidates])
    seen = np.diag(information) * plausible**2 > _NOTHING**2
    information = np.where(np.outer(seen, seen), 0.5 * (information + information.T), 0.0)
    deviation = 1.0 / np.sqrt(np.where(seen, np.diag(information), 1.0))
    if fit.drawn is not None:
        wider = widening(fit, white, own, fit.beliefs)
        inside = fit.widenings()[len(NUISANCES) :] if fit.candidates else np.empty(0)
        inner = np.concatenate([inside, wider])
        information = information / np.sqrt(np.outer(wider, wider))
        joint = joint / np.sqrt(np.outer(inner, inner))
        score = score / wider
        deviation = deviation * np.sqrt(wider)
    return Screen(
        candidates=tuple(candidates),
        z=np.where(seen, score * deviation, 0.0),
        information=information,
        size=np.where(seen, score * deviation**2, 0.0),
        columns=columns,
        joint=joint,
        white=white,
    )


def closely(fit: Fit, result: Screen, bar: float, near: float) -> Screen:
    """The same with places between those of effects that are far beyond chance.

    A large effect shows where it begins to less than a metre, and is another at the places beside.

    Parameters
    ----------
    bar
        Score above which an effect is sought closely.
    near
        First beside places with this share of its largest score; then beside the best.
    """
    for distance, share in ((_CLOSE, near), (_CLOSER, 1.0)):
        candidates = _with_places_between(result, bar, share, distance)
        if len(candidates) == len(result.candidates):
            break
        result = screen(fit, candidates)
    return result


def _with_places_between(result: Screen, bar: float, share: float, distance: float) -> list[Candidate]:
    strength, largest = np.abs(result.z), {}
    for candidate, own in zip(result.candidates, strength, strict=True):
        largest[candidate.effect] = max(largest.get(candidate.effect, 0.0), own)
    found = list(result.candidates[:1])
    for (one, a), (other, b) in pairwise(zip(result.candidates, strength, strict=True)):
        top = largest[one.effect]
        if one.effect == other.effect and top > bar and max(a, b) >= share * top:
            found.extend(_between(one, other, distance))
        found.append(other)
    return found


def _between(one: Candidate, other: Candidate, distance: float) -> list[Candidate]:
    """The same effect at the places between two, no further apart than ``distance``."""
    count = math.ceil(abs(other.place["place"] - one.place["place"]) / distance)
    shares = np.arange(1, count) / count
    places = [
        {key: float(value + share * (other.place[key] - value)) for key, value in one.place.items()}
        for share in shares
    ]
    return [Candidate(effect=one.effect, place=place) for place in places]


def _prior_score(fit: Fit, size: int) -> np.ndarray:
    """What the beliefs add to a score: not part of an answer to residuals alone."""
    prior = np.zeros(size)
    spread = np.array([nuisance.spread for nuisance in NUISANCES])
    prior[: len(spread)] = -fit.nuisances / spread**2
    return prior


def projected(normal: np.ndarray, score: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with the first ``count`` parameters eliminated."""
    solved = np.linalg.solve(normal[:count, :count], np.column_stack([normal[:count, count:], score[:count]]))
    cross = normal[count:, :count]
    return normal[count:, count:] - cross @ solved[:, :-1], score[count:] - cross @ solved[:, -1]


def chance_threshold(result: Screen, rate: float) -> float:
    """Largest score that chance exceeds in a share ``rate`` of logs with nothing wrong.

    Drawn with the correlations of this log's own scores, always from the same numbers.
    """
    seen = np.diag(result.information) > 0.0
    if not seen.any():
        return np.inf
    cosines = result.cosines()[np.ix_(seen, seen)]
    values, vectors = np.linalg.eigh(cosines)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(2004).standard_normal((_DRAWS, len(root))) @ root.T
    return float(np.quantile(np.abs(draws).max(axis=1), 1.0 - rate))
