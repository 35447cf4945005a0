"""Soils, vehicles, tyres and structures by name, as objects, as mappings and as YAML: all the same thing.

`read_soil`, `read_vehicle`, ... take any of these; `soil_mapping`, ... give the mapping from which the same
record is made to the last bit. The schemas state the keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar, cast

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import FourWheel, Soil, Structure, Tyre, Vehicle
from offroad_env.world.catalogue import Catalogue, Entry, Quantity
from offroad_env.world.documents import is_name, open_document, recalled, remember
from offroad_env.world.four_wheel import FOUR_WHEEL_FIELDS, FourWheelFields, make_four_wheel, stated_fields
from offroad_env.world.four_wheel_vehicles import FOUR_WHEEL_VEHICLES, FourWheelVehicle
from offroad_env.world.schema import SectionSchema
from offroad_env.world.soil_fields import SOIL_DEFAULTS, SOIL_RANGES
from offroad_env.world.soils import SOILS, make_soil
from offroad_env.world.structures import (
    LAWS,
    STRUCTURE_NUMBERS,
    STRUCTURES,
    make_structure,
    read_structure,
    structure_laws,
)
from offroad_env.world.tyres import TYRE_RANGES, TYRES, make_tyre
from offroad_env.world.vehicles import VEHICLE_RANGES, VEHICLES, make_vehicle
from offroad_env.world.yaml_text import shown

__all__ = [
    "SOIL",
    "STRUCTURE",
    "TYRE",
    "VEHICLE",
    "Description",
    "NamedSoil",
    "NamedVehicle",
    "choose_structure",
    "choose_tyre",
    "is_registered",
    "read_soil",
    "read_vehicle",
    "register_soil",
    "register_vehicle",
    "soil_mapping",
    "structure_mapping",
    "tyre_mapping",
    "vehicle_mapping",
]

#: A name, a file, inline YAML, or a mapping.
Description = str | PathLike[str] | Mapping[str, Any]
R = TypeVar("R")

#: Name of what is in no catalogue.
_OWN = "own"

SOIL = SectionSchema(
    name="soil",
    about="Soil or hard ground, as `make_soil` makes it.",
    records=(Soil,),
    choices={"kind": ("deformable", "rigid")},
    ranges=SOIL_RANGES,
    defaults={**SOIL_DEFAULTS, "kind": "deformable", "k_y": "k_x", "C_kappa": "C_alpha"},
    meanings={"kind": "rigid: hard ground, of which only mu, C_alpha and C_kappa count"},
    bases=lambda: SOILS,
)

_FOUR_WHEEL_DEFAULTS: Mapping[str, object] = MappingProxyType(
    {
        **dict.fromkeys(FOUR_WHEEL_FIELDS, 0.0),
        "I_x": "m track^2/6",
        **dict.fromkeys(("track_f", "track_r"), "track"),
        **dict.fromkeys(("roll_stiffness_f", "roll_stiffness_r"), "k track^2/4"),
        **dict.fromkeys(("bump_f", "bump_r", "droop_f", "droop_r"), 1e3),
        "ackermann": 1.0,
    }
)
VEHICLE = SectionSchema(
    name="vehicle",
    about='A vehicle, as `make_vehicle` makes it; from `I_x` on what only `vehicle_model="four_wheel"` uses.',
    records=(Vehicle, FourWheel),
    ranges={**VEHICLE_RANGES, **FOUR_WHEEL_FIELDS},
    defaults=_FOUR_WHEEL_DEFAULTS,
    meanings={
        "roll_centre_r": "height of the rear roll centre above the contact points [m]",
        "bump_r": "travel of a rear wheel up to its bump stop [m]",
        "droop_r": "travel of a rear wheel down to its rebound stop [m]",
        "toe_r": "toe-in of each rear wheel [rad]",
        "lock_r": "1.0 = the rear differential is locked, 0.0 = open",
        "lock_c": "1.0 = the differential between the axles is locked, 0.0 = open",
    }
    | {
        f"{name}_{axle}": f"{words} [N m/rad]"
        for axle, end in (("f", "front"), ("r", "rear"))
        for name, words in (
            ("roll_stiffness", f"roll stiffness of the {end} springs"),
            ("anti_roll", f"roll stiffness of the {end} anti-roll bar"),
        )
    },
    bases=lambda: (*VEHICLES, *(name for name in FOUR_WHEEL_VEHICLES if name not in VEHICLES)),
)

TYRE = SectionSchema(
    name="tyre",
    about='A flexible tyre, as `make_tyre` makes it; needs the structure "grid" or "field".',
    records=(Tyre,),
    ranges=TYRE_RANGES,
    defaults={
        "k_carcass": "by size",
        "k_per_pressure": "by size",
        "stiffening": 0.11,
        "mu": 0.8,
        "cornering": 8.0,
        "rolling": "1/3",
    },
    bases=lambda: TYRES,
)

STRUCTURE = SectionSchema(
    name="structure",
    about="Laws of the wheels on soil: a preset (`base`) and departures from it.",
    records=(Structure,),
    choices=LAWS,
    ranges={
        name: Quantity(f"in [{low:g}, {high:g}]", low, high)
        for name, (low, high, _) in STRUCTURE_NUMBERS.items()
    },
    defaults={
        **{name: options[0] for name, options in LAWS.items()},
        **{name: default for name, (_, _, default) in STRUCTURE_NUMBERS.items()},
    },
    meanings={
        "pressure_direction": "normal to the rim, or to the undeformed ground",
        "pressure_from": "Wong-Reece contact angles, or each point's own sinkage",
        "shear": "shear displacement along the rim, or the path in the soil",
        "strength": "one shear strength for both directions, or one each",
        "ruts": "what a following wheel meets",
        "width": "by which k_c is divided: the wheel's, or the contact hull's",
        "slip_sinkage": "growth of sinkage with slip",
        "shaft_torque": "whether the body bears the reaction to shaft torques",
    },
    bases=lambda: STRUCTURES,
)


class NamedSoil(NamedTuple):
    """A soil and its name."""

    name: str  #: in `SOILS`, or "own"
    record: Soil


class NamedVehicle(NamedTuple):
    """A vehicle and its name."""

    name: str  #: in `VEHICLES`, or "own"
    record: Vehicle
    four_wheel: FourWheel | None = None  #: what is stated of four wheels; None: the rules hold


class _Book(Generic[R]):
    """A catalogue with what is registered in it."""

    def __init__(self, kind: str, catalogue: Catalogue[R]) -> None:
        self.kind, self.catalogue = kind, catalogue
        self.own: set[str] = set()

    def find(self, name: str) -> Mapping[str, Any] | None:
        """What another process has registered under a name that this catalogue has not."""
        return None if name in self.catalogue else recalled(self.kind, name)


_SOIL_BOOK = _Book("soil", SOILS)
_VEHICLE_BOOK = _Book("vehicle", VEHICLES)


def is_registered(kind: str, name: object) -> bool:
    """Whether a name is one's own: registered here, or by the process that has started this one."""
    return isinstance(name, str) and recalled(kind, name) is not None


def read_soil(given: Soil | Description) -> NamedSoil:
    """A soil from its name in `SOILS`, a record, a mapping or YAML.

    Raises
    ------
    UnknownNameError, InvalidParameter, DataError
        With what is wrong, and where.
    """
    if isinstance(given, Soil):
        return NamedSoil(_soil_name(given), given)
    if isinstance(given, str) and is_name(given):
        content = _SOIL_BOOK.find(given)
        return NamedSoil(given, SOILS[given] if content is None else read_soil(content).record)
    document = open_document(given, "soil")
    fields = document.check(SOIL)
    base, kind = document.beside(fields.pop("base", None)), fields.pop("kind", None)
    start = None if base is None else read_soil(base)
    with document.refusing():
        record = make_soil(None if start is None else start.record, kind=kind, **fields)
    return NamedSoil(_soil_name(record) if start is None else start.name, record)


def _soil_name(soil: Soil) -> str:
    """The catalogue's name for a soil, whatever its n."""
    return next((name for name, known in SOILS.items() if known._replace(n=soil.n) == soil), _OWN)


def soil_mapping(soil: Soil) -> dict[str, Any]:
    """The mapping from which `read_soil` makes this soil."""
    values = soil._asdict()
    return {"kind": "rigid" if values.pop("rigid") > 0.5 else "deformable", **values}


def read_vehicle(given: Vehicle | FourWheelVehicle | Description) -> NamedVehicle:
    """A vehicle from its name in `VEHICLES` or `FOUR_WHEEL_VEHICLES`, a record, a mapping or YAML."""
    if isinstance(given, Vehicle):
        return NamedVehicle(_vehicle_name(given), given)
    if isinstance(given, FourWheelVehicle):
        return NamedVehicle(_vehicle_name(given.vehicle), given.vehicle, given.four_wheel)
    if isinstance(given, str) and is_name(given):
        return _vehicle_of_name(given)
    document = open_document(given, "vehicle")
    fields = document.check(VEHICLE)
    base = document.beside(fields.pop("base", None))
    start = None if base is None else read_vehicle(base)
    stated = {name: fields.pop(name) for name in FOUR_WHEEL_FIELDS if name in fields}
    with document.refusing():
        vehicle = make_vehicle(None if start is None else start.record, **fields)
        if start is not None and start.four_wheel is not None:
            rules = make_four_wheel(start.record)
            stated = {**stated_fields(start.four_wheel, start.record, rules), **stated}
        four_wheel = make_four_wheel(vehicle, **cast("FourWheelFields", stated)) if stated else None
    return NamedVehicle(_vehicle_name(vehicle), vehicle, four_wheel)


def _vehicle_of_name(name: str) -> NamedVehicle:
    content = _VEHICLE_BOOK.find(name)
    if content is not None:
        return read_vehicle(content)._replace(name=name)
    if name not in VEHICLES and name in FOUR_WHEEL_VEHICLES:
        found = FOUR_WHEEL_VEHICLES[name]
        return NamedVehicle(name, found.vehicle, found.four_wheel)
    return NamedVehicle(name, VEHICLES[name])


def _vehicle_name(vehicle: Vehicle) -> str:
    return next((name for name, known in VEHICLES.items() if known == vehicle), _OWN)


def vehicle_mapping(vehicle: Vehicle, four_wheel: FourWheel | None = None) -> dict[str, Any]:
    """The mapping from which `read_vehicle` makes this vehicle."""
    stated: Mapping[str, Any] = {}
    if four_wheel is not None:
        stated = cast("Mapping[str, Any]", stated_fields(four_wheel, vehicle, make_four_wheel(vehicle)))
    return {**vehicle._asdict(), **stated}


def choose_tyre(given: Tyre | Description | None) -> Tyre | None:
    """A tyre from its name in `TYRES`, a record, a mapping or YAML; None stays None: rigid rims."""
    if given is None or isinstance(given, Tyre):
        return given
    if isinstance(given, str) and is_name(given):
        return TYRES[given]
    document = open_document(given, "tyre")
    fields = document.check(TYRE)
    base = document.beside(fields.pop("base", None))
    with document.refusing():
        return make_tyre(choose_tyre(base), **fields)


def tyre_mapping(tyre: Tyre) -> dict[str, Any]:
    """The mapping from which `choose_tyre` makes this tyre."""
    return dict(tyre._asdict())


def choose_structure(given: Structure | Description | None) -> Structure | str | None:
    """The laws of the wheels from text (``"grid,ruts=none"``), a record, a mapping or YAML.

    A preset by name stays a name: "paper" and "full" are those of the models.
    """
    if given is None or isinstance(given, Structure) or (isinstance(given, str) and is_name(given)):
        return given
    document = open_document(given, "structure")
    fields = document.check(STRUCTURE)
    base = document.beside(fields.pop("base", "full"))
    with document.refusing():
        if base in STRUCTURES:
            return make_structure(str(base), **fields)
        start = choose_structure(base)
        if isinstance(start, str):
            start = read_structure(start)
        return make_structure("full", **{**_structure_fields(cast("Structure", start)), **fields})


def _structure_fields(structure: Structure) -> dict[str, Any]:
    numbers = {name: getattr(structure, name) for name in STRUCTURE_NUMBERS}
    return {**structure_laws(structure), **numbers}


def structure_mapping(structure: Structure) -> dict[str, Any]:
    """The mapping from which `choose_structure` makes this structure, without its tyre."""
    return {"base": "full", **_structure_fields(structure)}


def register_soil(
    name: str, soil: Soil | Description, *, title: str = "", source: str = "", remark: str = ""
) -> Soil:
    """Put a soil of one's own into `SOILS`, for this process and those that it starts.

    Parameters
    ----------
    name
        A new one, of letters, digits and underscores.
    soil
        A record of `make_soil`, a mapping or YAML, or another name.
    title, source, remark
        For readers of the catalogue.

    Returns
    -------
    Soil

    Raises
    ------
    InvalidParameter
        For a name that is taken by another soil, or that could be mistaken for a file.
    """
    record = read_soil(soil).record
    _enter(_SOIL_BOOK, Entry(name=name, record=record, title=title, source=source, remark=remark))
    remember("soil", name, soil_mapping(record))
    return record


def register_vehicle(
    name: str,
    vehicle: Vehicle | FourWheelVehicle | Description,
    *,
    title: str = "",
    source: str = "",
    remark: str = "",
) -> Vehicle:
    """Put a vehicle of one's own into `VEHICLES`; parameters as those of `register_soil`."""
    found = read_vehicle(vehicle)
    _enter(_VEHICLE_BOOK, Entry(name=name, record=found.record, title=title, source=source, remark=remark))
    remember("vehicle", name, vehicle_mapping(found.record, found.four_wheel))
    return found.record


def _enter(book: _Book[R], entry: Entry[R]) -> None:
    for field in ("title", "source", "remark"):
        if not isinstance(value := getattr(entry, field), str):
            raise InvalidParameter(f"{field} must be text for readers of the catalogue, got {shown(value)}")
    name = entry.name
    if not isinstance(name, str) or not name.isidentifier():
        raise InvalidParameter(f"name must be of letters, digits and underscores, got {shown(name)}")
    if name in book.catalogue and name not in book.own:
        raise InvalidParameter(f"the catalogue has a {book.kind} named {name!r} already: take another name")
    book.catalogue.register(entry)
    book.own.add(name)
