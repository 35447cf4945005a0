"""The structures and vehicle models that a replay can set side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from estimators.logs.log import Log
from offroad_env.errors import InvalidParameter
from offroad_env.physics.axle import Plant
from offroad_env.simulation.simulator import make_plant

__all__ = ["ALL", "STRUCTURES", "Case", "cases_of", "plant_for"]

#: Names of structures, simplest first.
STRUCTURES = ("paper", "full")
#: Stands for all of them.
ALL = "all"


class Case(NamedTuple):
    """A model of the vehicle and its soil."""

    structure: str  #: laws of wheel and soil
    vehicle_model: str  #: "half_car", ...

    @property
    def title(self) -> str:
        """For tables and figures."""
        return f"{self.structure}, {self.vehicle_model}"


def cases_of(structures: Sequence[str], vehicle_models: Sequence[str]) -> tuple[Case, ...]:
    """Every structure with every vehicle model, each once.

    Raises
    ------
    InvalidParameter
        For an empty choice, or an unknown structure.
    """
    if not structures or not vehicle_models:
        raise InvalidParameter("name at least one structure and one vehicle model")
    names = list(_named(structures))
    return tuple(dict.fromkeys(Case(name, model) for model in vehicle_models for name in names))


def _named(structures: Iterable[str]) -> Iterable[str]:
    for name in structures:
        if name == ALL:
            yield from STRUCTURES
        else:
            yield _known(name)


def _known(name: str) -> str:
    if name not in STRUCTURES:
        raise InvalidParameter(f"structure must be one of {', '.join((*STRUCTURES, ALL))}, got {name!r}")
    return name


def plant_for(log: Log, case: Case) -> Plant:
    """The vehicle and the soil that a log states, with the laws of ``case``; unknown ground is level.

    Raises
    ------
    DataError
        For a wheel-rig log.
    InvalidParameter
        For an unknown structure or vehicle model.
    """
    _known(case.structure)
    config = log.config
    plant = make_plant(log.vehicle, config.soil, config.terrain.ground(), vehicle_model=case.vehicle_model)
    return plant._replace(resultant=0.0) if case.structure == "paper" else plant
