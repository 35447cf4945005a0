"""Structures with flexible tyres, tried where no structure with rigid rims predicts a run."""

from __future__ import annotations

from estimators.discrepancy.structure_trials import StructureTrial, Trials
from estimators.logs.log import Log
from estimators.replay.structures import Case

__all__ = ["has_tyre", "near_on_tyres", "on_rigid_rims", "on_tyres"]

#: Structures whose wheels may have tyres.
_PRESETS = ("grid", "field")
#: Pressures that are tried first [Pa], and the step to those beside the best.
_PRESSURES, _STEP = (50e3, 100e3, 200e3, 400e3), 2.0**0.5
#: The pressure by which they are tried first.
_USUAL = 150e3
_KEY = "tyre"


def has_tyre(structure: str) -> bool:
    """Whether the wheels of a structure, as text, have tyres."""
    return on_rigid_rims(structure) != structure


def on_rigid_rims(structure: str) -> str:
    """The same structure without its tyres."""
    return ",".join(part for part in structure.split(",") if not part.startswith(_KEY))


def near_on_tyres(trials: Trials, log: Log, most: float) -> bool:
    """Whether a preset on tyres costs less than ``most``, with a usual pressure and any n.

    Never where the log states tyres.
    """
    stated = has_tyre(log.config.structure)
    return not stated and any(trials.reaches(_case(log, name, _USUAL), most) for name in _PRESETS)


def on_tyres(trials: Trials, log: Log) -> list[StructureTrial]:
    """The presets on tyres of the pressure that suits each, best first, the best one with four wheels, too.

    Size is that of the wheels, stiffness the usual one of such a tyre: a softer tyre is one of less pressure.
    """
    found = sorted((_with_pressure(trials, log, name) for name in _PRESETS), key=trials.cost)
    best = found[0]
    found.append(trials.best(Case(best.case.structure, "four_wheel"), start=best.change))
    return sorted(found, key=trials.cost)


def _with_pressure(trials: Trials, log: Log, preset: str) -> StructureTrial:
    first = {pressure: trials.best(_case(log, preset, pressure)) for pressure in _PRESSURES}
    pressure = min(first, key=lambda one: trials.cost(first[one]))
    beside = (_case(log, preset, near) for near in (pressure / _STEP, pressure * _STEP))
    change = first[pressure].change
    return min([first[pressure], *(trials.best(case, start=change) for case in beside)], key=trials.cost)


def _case(log: Log, preset: str, pressure: float) -> Case:
    size = f"{_KEY}_r={log.vehicle.r!r},{_KEY}_b={log.vehicle.b!r}"
    return Case(f"{preset},{size},{_KEY}_inflation={pressure:.0f}", "half_car")
