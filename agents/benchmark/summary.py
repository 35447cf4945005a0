"""What the paired episodes of several agents say: means, intervals, and what knowing the soil is worth."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agents.benchmark.statistics import (
    Interval,
    effect_size,
    headroom,
    interquartile_mean,
    mean_interval,
    paired_difference,
    probability_of_improvement,
    recovered_share,
    wilson_interval,
)
from agents.controllers.arms import ARMS
from agents.controllers.protocol import ArmResult
from offroad_env.environment.scenario_descriptions import find_scenario
from offroad_env.environment.scenarios import MEASURES
from offroad_env.errors import InvalidParameter

__all__ = ["ArmSummary", "Benchmark", "Difference", "summarise"]


@dataclass(frozen=True, kw_only=True)
class ArmSummary:
    """What the episodes of one arm say."""

    name: str
    score: Interval  #: mean score, in the unit of the task
    score_iqm: float  #: interquartile mean of the same
    success: Interval  #: share of episodes that do not fail (Wilson)
    failures: dict[str, int]  #: failed episodes by cause
    paired_time: Interval | None  #: mean time over the episodes that every arm finished [s]
    step_time: float  #: mean wall time of the agent per control step [s]; not repeatable
    env_time: float  #: the same of the environment with what runs on board [s]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One arm against another on the same episodes; below 0 it is better."""

    name: str
    against: str
    score: Interval  #: difference of the mean scores
    effect: float  #: the same over the standard deviation of the paired differences [-]
    wins: Interval  #: share of the episodes in which it scores better; a tie counts half


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Results of all arms on the same episodes, with the comparisons that the project asks for."""

    scenario: str
    form: str  #: "matched", or "mismatch" where the vehicle differs from the controllers' model
    seed: int
    measure: str  #: what the score is, in words
    unit: str  #: of the score
    arms: tuple[ArmResult, ...]
    summaries: tuple[ArmSummary, ...]
    finished_by_all: int  #: episodes that every arm finished
    headroom: Interval | None  #: better of the uninformed arms minus oracle, mean score
    better_uninformed: str  #: which one that is
    against: tuple[Difference, ...]  #: every other arm against that one
    recovered: Interval | None  #: share of the headroom that aware recovers; None where there may be none [-]

    @property
    def oracle_minus_uninformed(self) -> Interval | None:
        """Oracle minus the better uninformed arm, mean score; below 0: knowing pays."""
        return next((d.score for d in self.against if d.name == "oracle"), None)

    @property
    def episodes(self) -> int:
        """Number of paired episodes."""
        return len(self.arms[0].episodes)

    def arm(self, name: str) -> ArmResult:
        """Result of an arm by name."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise InvalidParameter(f"arm must be one of {', '.join(a.name for a in self.arms)}, got {name!r}")

    def summary(self, name: str) -> ArmSummary:
        """Summary of an arm by name."""
        return self.summaries[[arm.name for arm in self.arms].index(self.arm(name).name)]

    def to_dict(self) -> dict[str, Any]:
        """Plain dict for JSON; numbers that are not finite become None."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain

    def save(self, path: str | Path) -> Path:
        """Write the JSON file."""
        path = Path(path)
        path.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def summarise(scenario: str, seed: int, arms: tuple[ArmResult, ...], *, form: str = "matched") -> Benchmark:
    """The comparisons of a set of agents that drove the same episodes.

    Arms of `agents.controllers.arms` that know nothing of the soil compete for being the better uninformed
    one; other agents are compared with it, but do not take its place: they were not tuned with its budget.
    """
    measure, unit = MEASURES[find_scenario(scenario).measure]
    finished = np.logical_and.reduce([arm.success for arm in arms])
    by_name = {arm.name: arm for arm in arms}
    blind = [arm for arm in arms if arm.name in ARMS and not ARMS[arm.name][1]]
    better = min(blind, key=lambda arm: float(arm.scores.mean())) if blind else None
    room = recovered = None
    if "oracle" in by_name and better is not None:
        oracle = by_name["oracle"].scores
        others = tuple(arm.scores for arm in blind)
        room = headroom(oracle, others)
        if "aware" in by_name and room.low > 0.0:
            recovered = recovered_share(by_name["aware"].scores, oracle, others)
    return Benchmark(
        scenario=scenario,
        form=form,
        seed=seed,
        measure=measure,
        unit=unit,
        arms=arms,
        summaries=tuple(_summary(arm, finished) for arm in arms),
        finished_by_all=int(finished.sum()),
        headroom=room,
        better_uninformed=better.name if better is not None else "",
        against=() if better is None else tuple(_difference(a, better) for a in arms if a is not better),
        recovered=recovered,
    )


def _difference(arm: ArmResult, other: ArmResult) -> Difference:
    return Difference(
        name=arm.name,
        against=other.name,
        score=paired_difference(arm.scores, other.scores),
        effect=effect_size(arm.scores, other.scores),
        wins=probability_of_improvement(arm.scores, other.scores),
    )


def _summary(arm: ArmResult, finished: np.ndarray) -> ArmSummary:
    scores = arm.scores
    return ArmSummary(
        name=arm.name,
        score=mean_interval(scores),
        score_iqm=interquartile_mean(scores),
        success=wilson_interval(int(arm.success.sum()), len(arm.episodes)),
        failures=arm.failures,
        paired_time=mean_interval(arm.time[finished]) if finished.sum() >= 2 else None,
        step_time=float(np.mean([episode.step_time for episode in arm.episodes])),
        env_time=float(np.mean([episode.env_time for episode in arm.episodes])),
    )
