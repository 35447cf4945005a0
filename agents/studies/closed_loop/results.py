"""Results of the study of the closed loop."""

from __future__ import annotations

from dataclasses import dataclass

from agents.benchmark.statistics import Interval

__all__ = ["CauseLine"]


@dataclass(frozen=True, kw_only=True)
class CauseLine:
    """One hidden cause over all soils."""

    cause: str
    named: int  #: units whose extended model holds it
    units: int
    nominal: Interval  #: mean score of the plan for the nominal model [s]
    extended: Interval
    true: Interval
    loss: Interval  #: of the nominal plan against the true one [s]
    gain: Interval  #: of the extended plan against the nominal one [s]
    recovered: Interval | None  #: share of the loss; None where the loss is not above zero
