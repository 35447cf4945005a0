"""Core-seconds of a verdict on drives of a minute in a natural world."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from estimators.discrepancy.diagnosis import diagnose
from estimators.discrepancy.faults.drive import draw_case, simulated_log
from estimators.discrepancy.faults.library import FAULTS
from estimators.logs.log import Log
from offroad_env.simulation.drive import Faults
from offroad_env.simulation.simulator import Plant, make_plant

__all__ = ["VERDICT_BARS", "VerdictTime", "verdict_times"]

#: Most core-seconds of a verdict, by what is wrong with the vehicle [s].
VERDICT_BARS: Mapping[str, float] = MappingProxyType(
    {"no fault": 15.0, "one effect": 15.0, "another structure": 90.0}
)
#: First seed of the drives, and drives without a fault and with another structure.
_SEED, _DRIVES = 9500, 3
#: Effects and sizes, of a drive each.
_EFFECTS = (("steer_gain", 0.2), ("payload", 0.25), ("rolling_resistance", 0.1))


@dataclass(frozen=True, kw_only=True)
class VerdictTime:
    """CPU time of verdicts of one kind."""

    what: str  #: of `VERDICT_BARS`
    seconds: float  #: median CPU time of `diagnose` [s]
    most: float  #: largest [s]
    bar: float  #: most that is promised of the median [s]

    @property
    def met(self) -> bool:
        """Whether the promise is kept."""
        return self.seconds <= self.bar


def verdict_times() -> tuple[VerdictTime, ...]:
    """CPU times of verdicts, everything compiled before."""
    seeds = range(_SEED, _SEED + _DRIVES)
    logs = {
        "no fault": [_drive(seed, None) for seed in seeds],
        "one effect": [
            _drive(seed, FAULTS[name](size)) for seed, (name, size) in zip(seeds, _EFFECTS, strict=True)
        ],
        "another structure": [_drive(seed, Faults(plant=_on_a_grid)) for seed in seeds],
    }
    diagnose(logs["another structure"][:1])  # compiled now
    return tuple(_time(what, own) for what, own in logs.items())


def _drive(seed: int, faults: Faults | None) -> Log:
    return simulated_log(draw_case(seed, road="unknown", natural=True), faults)


def _on_a_grid(plant: Plant) -> Plant:
    """The same with the laws of a soil grid, which no effect of the library has."""
    other = make_plant(plant.vehicle, plant.soil, plant.ground, structure="grid")
    return plant._replace(structure=other.structure)


def _time(what: str, logs: Sequence[Log]) -> VerdictTime:
    seconds = []
    for log in logs:
        start = time.process_time()
        diagnose([log])
        seconds.append(time.process_time() - start)
    return VerdictTime(
        what=what, seconds=float(np.median(seconds)), most=max(seconds), bar=VERDICT_BARS[what]
    )
