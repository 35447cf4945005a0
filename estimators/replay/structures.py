"""The structures and vehicle models that a replay can set side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from estimators.logs.log import Log
from offroad_env.errors import InvalidParameter
from offroad_env.physics.axle import Plant
from offroad_env.simulation.simulator import make_plant
from offroad_env.world.structures import LADDER, STRUCTURES, read_structure

__all__ = ["GROUPS", "Case", "cases_of", "plant_for", "title_of"]

#: The grid with one law put back to that of "full", and with it what needs it.
_LEAVE_ONE_OUT = (
    "grid",
    "grid,pressure_direction=rim_normal",
    "grid,pressure_from=wong_reece,ruts=none",
    "grid,shear=wheel_frame,ruts=pressure",
    "grid,strength=independent",
    "grid,ruts=pressure",
    "grid,ruts=none",
    "grid,width=rim",
    "grid,shaft_torque=reacted",
)
#: Names that stand for several structures.
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "all": tuple(dict.fromkeys((*LADDER, *STRUCTURES))),
        "ladder": LADDER,
        "leave_one_out": _LEAVE_ONE_OUT,
    }
)
#: Short titles; a "+" is added to the row of the ladder above.
_TITLES: Mapping[str, str] = MappingProxyType(
    {
        "full,pressure_direction=ground_normal": "+ along ground normal",
        "full,pressure_direction=ground_normal,pressure_from=own_sinkage": "+ own sinkage",
        "grid,shaft_torque=reacted,ruts=none,width=rim": "+ shear as soil path",
        "grid,shaft_torque=reacted,ruts=none": "+ hull width",
        "grid,shaft_torque=reacted,ruts=pressure": "+ ruts",
        "grid,shaft_torque=reacted": "+ kept shear",
        "grid": "grid (shafts driven from outside)",
        "grid,pressure_direction=rim_normal": "grid, rim normal",
        "grid,pressure_from=wong_reece,ruts=none": "grid, Wong-Reece",
        "grid,shear=wheel_frame,ruts=pressure": "grid, shear along rim",
        "grid,strength=independent": "grid, indep. strength",
        "grid,width=rim": "grid, rim width",
    }
)


class Case(NamedTuple):
    """A model of the vehicle and its soil."""

    structure: str  #: laws of wheel and soil, as `world.structures.read_structure` knows them
    vehicle_model: str  #: "half_car", "bicycle", ...


def title_of(structure: str) -> str:
    """What a structure is, for tables and figures."""
    return _TITLES.get(structure, structure)


def cases_of(structures: Sequence[str], vehicle_models: Sequence[str]) -> tuple[Case, ...]:
    """Every structure with every vehicle model, each once; a structure may be a group of `GROUPS`.

    Raises
    ------
    InvalidParameter
        For an empty choice, or an unknown structure.
    """
    if not structures or not vehicle_models:
        raise InvalidParameter("name at least one structure and one vehicle model")
    names = list(_named(structures))
    for name in names:
        read_structure(name)
    return tuple(dict.fromkeys(Case(name, model) for model in vehicle_models for name in names))


def _named(structures: Iterable[str]) -> Iterable[str]:
    for name in structures:
        yield from GROUPS.get(name, (name,))


def plant_for(log: Log, case: Case) -> Plant:
    """The vehicle and the soil that a log states, with the laws of ``case``; unknown ground is level.

    Raises
    ------
    DataError
        For a wheel-rig log.
    InvalidParameter
        For an unknown structure or vehicle model.
    """
    config = log.config
    return make_plant(
        log.vehicle,
        config.soil,
        config.terrain.ground(),
        vehicle_model=case.vehicle_model,
        structure=case.structure,
        four_wheel=config.four_wheel if case.vehicle_model == "four_wheel" else None,
    )
