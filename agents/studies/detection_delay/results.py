"""Results of the study of the detection delay."""

from __future__ import annotations

from typing import NamedTuple

from agents.benchmark.statistics import Interval

__all__ = ["DrivenLine", "FilterLine"]


class DrivenLine(NamedTuple):
    """One way of knowing n, over all episodes."""

    name: str  #: of an arm of the benchmark, or of the way to drive with a delayed n
    delay: float  #: of the true n [s]; NaN for the arms of the benchmark
    score: Interval  #: mean time to the goal, a failure costs the time limit [s]
    failures: int
    episodes: int


class FilterLine(NamedTuple):
    """One filter on board, over all episodes."""

    name: str
    delay: float  #: median time from an edge below the front wheels to an estimate within `NEAR` [s]
    answered: float  #: share of the edges to which such an answer came before the next one
    edges: int
    rmse: float  #: of n after the first seconds [-]
    coverage: float  #: share of the time with the truth within two standard deviations
    valid: float  #: share of the time that the flag is up
