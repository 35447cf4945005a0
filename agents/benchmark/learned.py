"""What trained policies score: the training seed is the unit, not the episode.

Two runs of one trainer differ in nothing but the seed, and often more than two arms do. What an arm is
worth is therefore the mean over training seeds, with Student's interval over those few numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from agents.benchmark.statistics import Interval

__all__ = ["LearnedArm", "learned_verdict", "seed_interval", "summarise_learned"]


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
    """Whether the arm that is told the estimate beats the one that is not, by their intervals."""
    by_name = {arm.arm: arm for arm in arms}
    if not {"ppo_aware", "ppo_oblivious"} <= set(by_name):
        return f"{arms[0].task}: no pair of a policy that is told the estimate and one that is not."
    aware, blind = by_name["ppo_aware"].score, by_name["ppo_oblivious"].score
    figures = f"{aware:.3g} {unit} against {blind:.3g} {unit}"
    if "ppo_memory" in by_name:
        figures += f", with memory instead {by_name['ppo_memory'].score:.3g} {unit}"
    if aware.high < blind.low:
        return f"On {arms[0].task}, a trained policy does better with the estimate: {figures}."
    if blind.high < aware.low:
        return f"On {arms[0].task}, a trained policy does worse with the estimate: {figures}."
    return f"On {arms[0].task}, trained policies do not show that the estimate pays: {figures}."
