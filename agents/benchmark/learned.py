"""What trained policies score: the training seed is the unit, not the episode.

Two runs of one trainer differ in nothing but the seed, and often more than two arms do. What an arm is
worth is therefore the mean over training seeds, with Student's interval over those few numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from agents.benchmark.statistics import Interval, interquartile_mean

__all__ = [
    "LearnedArm",
    "improvement_interval",
    "improvement_verdict",
    "interquartile_interval",
    "learned_verdict",
    "ratio_interval",
    "seed_interval",
    "summarise_learned",
]

#: Names before ``_aware`` and ``_oblivious`` -> whose the comparison is.
_PAIRS = {"ppo": "trained policies", "ppo_tracker": "policies that say the speed themselves"}


@dataclass(frozen=True, kw_only=True)
class LearnedArm:
    """A trained arm on one task: every training seed drives the same episodes."""

    task: str
    arm: str
    seeds: tuple[int, ...]  #: of the training
    means: tuple[float, ...]  #: mean score of each
    failures: tuple[float, ...]  #: share of failed episodes of each [-]
    score: Interval  #: mean over the seeds

    @property
    def failed(self) -> float:
        """Share of failed episodes [-]."""
        return float(np.mean(self.failures))


def seed_interval(means: Sequence[float], *, level: float = 0.95) -> Interval:
    """Mean over training seeds with Student's interval; infinite for a single seed."""
    values = np.asarray(means, dtype=np.float64)
    value = float(values.mean())
    if values.size < 2:
        return Interval(value, -math.inf, math.inf, level)
    half = float(
        student.ppf(0.5 + 0.5 * level, values.size - 1) * values.std(ddof=1) / math.sqrt(values.size)
    )
    return Interval(value, value - half, value + half, level)


def summarise_learned(
    task: str, arm: str, episodes: Mapping[int, tuple[Sequence[float], Sequence[bool]]]
) -> LearnedArm:
    """Summary of an arm from training seed -> (scores, successes) of its episodes."""
    seeds = tuple(sorted(episodes))
    means = tuple(float(np.mean(episodes[seed][0])) for seed in seeds)
    failures = tuple(float(1.0 - np.mean(episodes[seed][1])) for seed in seeds)
    return LearnedArm(
        task=task, arm=arm, seeds=seeds, means=means, failures=failures, score=seed_interval(means)
    )


def learned_verdict(arms: Sequence[LearnedArm], unit: str) -> str:
    """Whether arms with the terrain estimate beat those without, by their intervals."""
    by_name = {arm.arm: arm.score for arm in arms}
    verdicts = [
        _pair_verdict(f"On {arms[0].task}, {policies}", by_name, kind, unit)
        for kind, policies in _PAIRS.items()
        if {f"{kind}_aware", f"{kind}_oblivious"} <= set(by_name)
    ]
    if not verdicts:
        return f"{arms[0].task}: no pair of a policy with the terrain estimate and one without."
    return " ".join(verdicts)


def _pair_verdict(policies: str, scores: Mapping[str, Interval], kind: str, unit: str) -> str:
    aware, blind = scores[f"{kind}_aware"], scores[f"{kind}_oblivious"]
    figures = f"{aware:.3g} {unit} against {blind:.3g} {unit}"
    if f"{kind}_memory" in scores:
        figures += f", with memory instead {scores[f'{kind}_memory']:.3g} {unit}"
    if aware.high < blind.low:
        return f"{policies} do better with the estimate: {figures}."
    if blind.high < aware.low:
        return f"{policies} do worse with the estimate: {figures}."
    return f"{policies} do not show that the estimate pays: {figures}."


#: Resamples of the nested bootstrap.
_RESAMPLES = 2000


def _crossed(
    statistic: Callable[[np.ndarray, np.ndarray], float],
    scores: np.ndarray,
    beside: np.ndarray,
    level: float,
    seed: int,
) -> Interval:
    """Percentile interval; in every resample the trainings of both agents are drawn, and the episodes.

    All trainings drive the same episodes, so that the episodes that are drawn are the same for all: drawn for
    each training anew, the scatter of soils and courses would seem to average out over trainings. With one
    training the interval is one over episodes alone.

    Parameters
    ----------
    statistic
        Of scores (S, E) and scores beside them (T, E).
    scores, beside : (S, E), (T, E)
        A row for each training.
    level, seed
    """
    rng = np.random.default_rng(seed)
    found = np.empty(_RESAMPLES)
    for i in range(_RESAMPLES):
        rows, others = (rng.integers(0, len(table), (len(table), 1)) for table in (scores, beside))
        columns = rng.integers(0, scores.shape[1], scores.shape[1])
        found[i] = statistic(scores[rows, columns], beside[others, columns])
    low, high = np.quantile(found, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return Interval(statistic(scores, beside), float(low), float(high), level)


def _rows(scores: np.ndarray) -> np.ndarray:
    """(S, E) scores; those of an agent that is not trained are one row."""
    return np.atleast_2d(np.asarray(scores, dtype=np.float64))


def interquartile_interval(scores: np.ndarray, *, level: float = 0.95, seed: int = 0) -> Interval:
    """Interquartile mean of all trainings and episodes, with its interval by bootstrap.

    Parameters
    ----------
    scores : (S, E)
        A row for each training seed, the same test episodes in all.
    level, seed
        Of the interval, of the resampling.
    """
    scores = _rows(scores)
    return _crossed(lambda own, _: interquartile_mean(own.ravel()), scores, scores, level, seed)


def improvement_interval(
    scores: np.ndarray, other: np.ndarray, *, level: float = 0.95, seed: int = 0
) -> Interval:
    """Share of the episodes in which an agent (S, E) is better than another, (T, E) or (E,); ties count half.

    Every training of the one is compared with every training of the other (R. Agarwal et al., Deep
    reinforcement learning at the edge of the statistical precipice, NeurIPS 2021), episode by episode.
    """

    def share(own: np.ndarray, beside: np.ndarray) -> float:
        first, second = own[:, None], beside[None]
        return float(np.mean((first < second) + 0.5 * (first == second)))

    return _crossed(share, _rows(scores), _rows(other), level, seed)


def ratio_interval(scores: np.ndarray, other: np.ndarray, *, level: float = 0.95, seed: int = 0) -> Interval:
    """Mean score (S, E) over the mean score of another agent, (T, E) or (E,), in the same episodes."""

    def ratio(own: np.ndarray, beside: np.ndarray) -> float:
        return float(own.mean() / beside.mean())

    return _crossed(ratio, _rows(scores), _rows(other), level, seed)


def improvement_verdict(arm: str, other: str, better: Interval) -> str:
    """Whether the policies of an arm are better than another agent, by the interval."""
    figure = f"better in {better:.2f} of the episodes"
    if better.low > 0.5:
        return f"{arm} beats {other}: {figure}."
    if better.high < 0.5:
        return f"{arm} is beaten by {other}: {figure}."
    return f"{arm} and {other} do not differ: {figure}."
