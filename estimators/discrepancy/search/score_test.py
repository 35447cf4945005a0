"""Score tests: how strongly the residuals of a fit point to each effect, and the scores of noise alone.

Reference: C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948) 50; R. F. Engle, Handbook of Econometrics 2 (1984) 775.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimators.discrepancy.model.fit_result import FitResult
from estimators.discrepancy.model.normal_equations import projected
from estimators.discrepancy.model.null_simulations import variance_inflation
from estimators.discrepancy.model.parameters import Candidate
from estimators.discrepancy.model.protocol import ForwardModel
from offroad_env.effects import EFFECTS, Effect
from offroad_env.physics import state as at

__all__ = [
    "DETECTABLE",
    "ScoreTest",
    "candidates_for",
    "effects_for",
    "refined_places",
    "score_test",
    "score_threshold",
]

#: An effect whose largest plausible size would move its score by less than this is no candidate at all.
_NOTHING = 0.4
#: Distances of the places at which a large effect is sought, and then next to the best of them [m].
_CLOSE, _CLOSER = 0.5, 0.1
#: Draws of the largest score under the null.
_DRAWS = 20_000
#: Size that is found with 90 % power among about 36 effects at 5 % family-wise, in standard deviations.
DETECTABLE = 4.42


@dataclass(frozen=True, kw_only=True)
class ScoreTest:
    """Scores of candidates at one point of a fit."""

    fit: FitResult  #: with the derivatives by all candidates
    candidates: tuple[Candidate, ...]
    z: np.ndarray  #: (C,) score over its standard deviation; 0 where the log has no information
    information: np.ndarray  #: (C, C) Fisher information of the sizes, nuisances projected out
    size: np.ndarray  #: (C,) size that one step of the fit would give
    joint: np.ndarray  #: (E + C, E + C) the same with the E effects in the model, before the candidates
    white: np.ndarray  #: (M, g + C) whitened derivatives by what is in the model and by the candidates

    @property
    def deviation(self) -> np.ndarray:
        """(C,) standard deviation of each size if it were alone; infinite without information."""
        own = np.diag(self.information)
        with np.errstate(divide="ignore"):
            return np.where(own > 0.0, 1.0 / np.sqrt(np.maximum(own, 1e-300)), np.inf)

    def scores(self, fit: FitResult, residual: np.ndarray) -> np.ndarray:
        """Scores (C,) that residuals (M,) would have at a point of the fit."""
        # What the priors of nuisances and starts add to a score is no answer to residuals.
        answers = [
            fit.reduced(fit.noise.whiten(one), self.white) for one in (residual, np.zeros_like(residual))
        ]
        inside = len(self.white[0]) - len(self.candidates)
        _, score = projected(answers[0].normal, answers[0].score - answers[1].score, inside)
        return np.where(np.diag(self.information) > 0.0, score * np.minimum(self.deviation, 1e300), 0.0)

    def limits(self) -> dict[str, float]:
        """Detection limit of every effect, in the size's unit."""
        found: dict[str, float] = {}
        for candidate, deviation in zip(self.candidates, self.deviation, strict=True):
            found[candidate.effect] = min(found.get(candidate.effect, np.inf), DETECTABLE * deviation)
        return found

    def cosines(self) -> np.ndarray:
        """(C, C) cosines between the whitened traces of the effects, -1 ... 1."""
        own = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        return np.asarray(self.information / np.outer(own, own))

    def by_effect(self) -> tuple[list[str], np.ndarray]:
        """Effects of which the data have information, and their cosines (E, E), at the best place of each."""
        strength = np.diag(self.information)
        best: dict[str, int] = {}
        for i in np.argsort(strength):
            if strength[i] > 0.0:
                best[self.candidates[i].effect] = int(i)
        names = sorted(best)
        places = [best[name] for name in names]
        return names, self.cosines()[np.ix_(places, places)]


def route_of(fit: FitResult) -> np.ndarray:
    """Simulated positions of the vehicle, (T, 2) [m]."""
    return np.concatenate([records.states[::10, [at.X, at.Y]] for records in fit.records])


def effects_for(run: ForwardModel, library: Sequence[str]) -> list[str]:
    """Effects that mean something for a run; one that needs a channel which it lacks is left out."""
    return [name for name in library if _means_something(EFFECTS[name], run)]


def _means_something(effect: Effect, run: ForwardModel) -> bool:
    plant = run.setup.plant
    hard = plant.soil.rigid > 0.5
    if not effect.searched or run.setup.model not in effect.models:
        return False
    if (effect.soil_only and hard) or (effect.hard_only and not hard):
        return False
    if effect.tyres_only and (plant.structure is None or plant.structure.tyre is None):
        return False
    return all(any(channel in run.log.channels for channel in group) for group in effect.needs)


def candidates_for(fit: FitResult, library: Sequence[str]) -> list[Candidate]:
    """Candidates of the effects that mean something for these runs, at every place of the route."""
    route = None
    found: list[Candidate] = []
    for name in effects_for(fit.runs[0], library):
        effect = EFFECTS[name]
        if effect.places is None:
            found.append(Candidate(effect=name))
            continue
        route = route_of(fit) if route is None else route
        found.extend(Candidate(effect=name, place=place) for place in effect.places(route))
    return found


def score_test(fit: FitResult, candidates: Sequence[Candidate]) -> ScoreTest:
    """Scores of ``candidates``, none of which is in the model, at the point of ``fit``.

    Derivatives change little from one model to the next, and what has a large score is refitted anyway: the
    derivatives that the fit has already serve again.
    """
    fit = fit.completed(candidates)
    inside, nuisances = len(fit.point.shared), len(fit.nuisances)
    white = fit.noise.whiten(fit.jacobian.shared([*fit.candidates, *candidates]))
    equations = fit.reduced(fit.noise.whiten(fit.residual), white)
    joint, joint_score = projected(equations.normal, equations.score, nuisances)
    information, score = projected(joint, joint_score, inside - nuisances)
    vehicle = fit.runs[0].setup.plant.vehicle
    plausible = np.array([EFFECTS[c.effect].plausible(vehicle) for c in candidates])
    seen = np.diag(information) * plausible**2 > _NOTHING**2
    information = np.where(np.outer(seen, seen), 0.5 * (information + information.T), 0.0)
    deviation = 1.0 / np.sqrt(np.where(seen, np.diag(information), 1.0))
    if fit.null is not None:
        columns, prior = fit.without_states(white), fit.problem.nuisance_information
        wider = variance_inflation(columns, fit.null.white, inside, prior)
        inner = np.concatenate([fit.size_inflation if fit.candidates else np.empty(0), wider])
        information = information / np.sqrt(np.outer(wider, wider))
        joint = joint / np.sqrt(np.outer(inner, inner))
        score = score / wider
        deviation = deviation * np.sqrt(wider)
    z = np.where(seen, score * deviation, 0.0)
    size = np.where(seen, score * deviation**2, 0.0)
    share = _possible_share(fit, candidates, size)
    return ScoreTest(
        fit=fit,
        candidates=tuple(candidates),
        z=z * np.sqrt(share * (2.0 - share)),
        information=information,
        size=size,
        joint=joint,
        white=white,
    )


def _possible_share(fit: FitResult, candidates: Sequence[Candidate], size: np.ndarray) -> np.ndarray:
    """(C,) share of the steps to these sizes that stays within the physical ranges.

    A share s of the step explains s (2 - s) of what the whole one does, the square of the score. Less than
    nothing is no evidence: soil never pulls.
    """
    low, high = (ends[len(fit.nuisances) :] for ends in fit.problem.limits(candidates))
    off = np.array([EFFECTS[candidate.effect].size.off for candidate in candidates])
    reach = np.where(size < 0.0, off - low, high - off)
    return np.asarray(np.clip(reach / np.maximum(np.abs(size), 1e-300), 0.0, 1.0))


def refined_places(result: ScoreTest, bar: float, near: float) -> ScoreTest:
    """The same with places between those of effects with very large scores.

    The place of a large effect is determined to less than a metre, and a metre away the effect is another.

    Parameters
    ----------
    bar
        Score above which an effect is sought closely.
    near
        First next to places with this share of its largest score; then next to the best.
    """
    for distance, share in ((_CLOSE, near), (_CLOSER, 1.0)):
        candidates = _with_places_between(result, bar, share, distance)
        if len(candidates) == len(result.candidates):
            break
        result = score_test(result.fit, candidates)
    return result


def _with_places_between(result: ScoreTest, bar: float, share: float, distance: float) -> list[Candidate]:
    strength = np.abs(result.z)
    largest: dict[str, float] = {}
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


def score_threshold(result: ScoreTest, rate: float) -> float:
    """Quantile of the largest score under the null: exceeded in a share ``rate`` of logs.

    Drawn with the correlations of this log's own scores, always from the same numbers. Where the variance of
    scores is that of K null simulations, its own error makes their law that of Student's t with K degrees.
    """
    seen = np.diag(result.information) > 0.0
    if not seen.any():
        return np.inf
    cosines = result.cosines()[np.ix_(seen, seen)]
    values, vectors = np.linalg.eigh(cosines)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(2004)
    draws = rng.standard_normal((_DRAWS, len(root))) @ root.T
    if result.fit.null is not None:
        count = result.fit.null.white.shape[1]
        draws /= np.sqrt(rng.chisquare(count, (_DRAWS, 1)) / count)
    return float(np.quantile(np.abs(draws).max(axis=1), 1.0 - rate))
