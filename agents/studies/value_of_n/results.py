"""Results of the study of the value of n."""

from __future__ import annotations

from dataclasses import dataclass

from agents.benchmark.statistics import Interval

__all__ = ["Cell"]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One task on one soil under one width of the prior."""

    task: str
    soil: str
    width: float  #: of the prior [-]
    room: Interval  #: better of nominal and conservative minus oracle, mean score
    base: float  #: mean score of that better arm
    oracle: float  #: mean score
    place: float  #: of the nominal arm's n in the prior
    unit: str

    @property
    def share(self) -> float:
        """Headroom over the score of the better uninformed arm [-]."""
        return self.room.value / self.base if self.base > 0.0 else 0.0
