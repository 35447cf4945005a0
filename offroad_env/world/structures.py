"""Structures: which laws a wheel follows on soil, as named choices that combine freely.

No structure is the truth. Which one a log or a rig follows is a question for `offroad replay`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Structure, Tyre
from offroad_env.world.argument_checks import is_one_of, numbers
from offroad_env.world.tyres import TYRE_RANGES, TYRES, TyreFields, make_tyre, with_tyre
from offroad_env.world.yaml_text import shown

__all__ = [
    "LADDER",
    "LAWS",
    "STRUCTURES",
    "STRUCTURE_NUMBERS",
    "make_structure",
    "read_structure",
    "structure_laws",
]

#: Each choice with its options; the first is that of preset "full".
LAWS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pressure_direction": ("rim_normal", "ground_normal"),
        "pressure_from": ("wong_reece", "own_sinkage"),
        "shear": ("wheel_frame", "soil_path"),
        "strength": ("resultant", "independent"),
        "ruts": ("none", "pressure", "pressure_and_shear"),
        "width": ("rim", "hull"),
        "slip_sinkage": ("none", "linear", "lyasko"),
        "shaft_torque": ("reacted", "external"),
    }
)

_GRID = {
    "pressure_direction": "ground_normal",
    "pressure_from": "own_sinkage",
    "shear": "soil_path",
    "ruts": "pressure_and_shear",
}
#: Presets: what departs from the first options. "paper" and "full" are the two rigid rims with Wong-Reece
#: angles; "grid" does what simulated vehicles on a grid of soil nodes do (Project Chrono's SCM), with two
#: artefacts: the hull's width, and torques on the wheels to which no body reacts; "field" is the same without
#: these and with slip sinkage.
STRUCTURES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "paper": {"strength": "independent"},
        "full": {},
        "grid": {**_GRID, "width": "hull", "shaft_torque": "external"},
        "field": {**_GRID, "slip_sinkage": "lyasko"},
    }
)

#: From "full" to "grid", one law at a time.
LADDER: tuple[str, ...] = (
    "full",
    "full,pressure_direction=ground_normal",
    "full,pressure_direction=ground_normal,pressure_from=own_sinkage",
    "grid,shaft_torque=reacted,ruts=none,width=rim",
    "grid,shaft_torque=reacted,ruts=none",
    "grid,shaft_torque=reacted,ruts=pressure",
    "grid,shaft_torque=reacted",
    "grid",
)

#: Slope of unloading of compacted soil [Pa/m]: Project Chrono's SCM takes 2e8 for its wheels.
_ELASTIC_MODULUS = 2e8
#: Growth of the linear slip sinkage: what Lyasko's factor has at zero slip.
_SLIP_SINKAGE_RATE = 1.5

#: Numbers of a structure: (lowest, highest, default).
STRUCTURE_NUMBERS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "elastic_modulus": (1e6, 1e11, _ELASTIC_MODULUS),
        "slip_sinkage_rate": (0.0, 10.0, _SLIP_SINKAGE_RATE),
        "damping": (0.0, 1e7, 0.0),
        "grouser_height": (0.0, 0.2, 0.0),
    }
)

#: Key of the tyre in a text, by its name, and of its fields.
_TYRE = "tyre"
_TYRE_NUMBERS: Mapping[str, str] = MappingProxyType({f"tyre_{name}": name for name in TYRE_RANGES})


def make_structure(
    preset: str = "full",
    *,
    elastic_modulus: float = _ELASTIC_MODULUS,
    slip_sinkage_rate: float = _SLIP_SINKAGE_RATE,
    damping: float = 0.0,
    grouser_height: float = 0.0,
    **laws: str,
) -> Structure:
    """A structure from a preset and departures from it.

    Parameters
    ----------
    preset : {"full", "paper", "grid", "field"}
    elastic_modulus : float
        Slope of unloading and reloading [Pa/m], 1e6 ... 1e11.
    slip_sinkage_rate : float
        Of ``slip_sinkage="linear"``: sinkage grows by this times the slip [-], 0 ... 10.
    damping : float
        Pressure per downward speed of the rim [Pa s/m], 0 ... 1e7.
    grouser_height : float
        Height of grousers beyond the wheel's radius [m], 0 ... 0.2: soil shears along their tips (shearing
        radius; Ding et al., J. Terramechanics 48 (2011) 27-45).
    **laws : str
        Choices of `LAWS`, such as ``ruts="none"``.

    Raises
    ------
    InvalidParameter
        For an unknown preset, choice or option, or a number out of range.
    """
    if not is_one_of(preset, STRUCTURES):
        raise InvalidParameter(f"structure must be one of {', '.join(STRUCTURES)}, got {shown(preset)}")
    for name, option in laws.items():
        if name not in LAWS:
            raise InvalidParameter(f"a structure has no choice {name!r}; it has {', '.join(LAWS)}")
        if not is_one_of(option, LAWS[name]):
            raise InvalidParameter(f"{name} must be one of {', '.join(LAWS[name])}, got {shown(option)}")
    chosen = {name: options[0] for name, options in LAWS.items()} | dict(STRUCTURES[preset]) | laws
    if chosen["pressure_from"] != "own_sinkage":
        _require_unused(damping=damping, elastic_modulus=elastic_modulus)
    if chosen["ruts"] != "none" and chosen["pressure_from"] != "own_sinkage":
        raise InvalidParameter(
            'ruts need pressure_from="own_sinkage": contact angles that are a function of slip know no '
            "depth from which soil has borne already"
        )
    if chosen["ruts"] == "pressure_and_shear" and chosen["shear"] != "soil_path":
        raise InvalidParameter(
            'ruts="pressure_and_shear" needs shear="soil_path": shear displacement in the wheel\'s frame '
            "does not stay with the soil"
        )
    return Structure(
        ground_normal=_flag(chosen["pressure_direction"] == "ground_normal"),
        own_sinkage=_flag(chosen["pressure_from"] == "own_sinkage"),
        soil_path=_flag(chosen["shear"] == "soil_path"),
        resultant=_flag(chosen["strength"] == "resultant"),
        ruts=_flag(chosen["ruts"] != "none"),
        shear_carry=_flag(chosen["ruts"] == "pressure_and_shear"),
        hull=_flag(chosen["width"] == "hull"),
        slip_sinkage=float(LAWS["slip_sinkage"].index(chosen["slip_sinkage"])),
        slip_sinkage_rate=_within("slip_sinkage_rate", slip_sinkage_rate, "in percent?"),
        elastic_modulus=_within("elastic_modulus", elastic_modulus, "Pa/m, not kPa/m?"),
        damping=_within("damping", damping, "Pa s/m?"),
        grouser_height=_within("grouser_height", grouser_height, "in mm?"),
        external_torque=_flag(chosen["shaft_torque"] == "external"),
    )


def _require_unused(**numbers: float) -> None:
    """Refuse numbers of the soil under each point of the rim where no point has a sinkage of its own."""
    for name, value in numbers.items():
        if value != STRUCTURE_NUMBERS[name][2]:
            raise InvalidParameter(
                f'{name} needs pressure_from="own_sinkage": with the angles of Wong and Reece no point of '
                "the rim knows how the soil under it has moved"
            )


def read_structure(text: str) -> Structure:
    """A structure from text: a preset and departures, ``"grid,ruts=none,elastic_modulus=1e8"``.

    Flexible tyres belong to it by name, by their fields, or both: ``"field,tyre=mrzr,tyre_inflation=12e4"``,
    ``"field,tyre_r=0.33,tyre_b=0.21,tyre_inflation=12e4"``.
    """
    preset, *changes = [part.strip() for part in text.split(",")]
    laws: dict[str, str] = {}
    numbers: dict[str, float] = {}
    tyre: dict[str, float] = {}
    base: str | None = None
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise InvalidParameter(f"structure {text!r}: {change!r} is not of the form choice=option")
        if name in LAWS:
            laws[name] = value
        elif name == _TYRE:
            base = value
        elif name in STRUCTURE_NUMBERS:
            numbers[name] = _number(text, name, value)
        elif name in _TYRE_NUMBERS:
            tyre[_TYRE_NUMBERS[name]] = _number(text, name, value)
        else:
            raise InvalidParameter(f"structure {text!r}: there is no choice or number {name!r}; {_known()}")
    structure = make_structure(
        preset,
        elastic_modulus=numbers.get("elastic_modulus", _ELASTIC_MODULUS),
        slip_sinkage_rate=numbers.get("slip_sinkage_rate", _SLIP_SINKAGE_RATE),
        damping=numbers.get("damping", 0.0),
        grouser_height=numbers.get("grouser_height", 0.0),
        **laws,
    )
    if base is None and not tyre:
        return structure
    return with_tyre(structure, make_tyre(base, **cast("TyreFields", tyre)))


def _number(text: str, name: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InvalidParameter(
            f"structure {text!r}: {name} must be a number without a unit, got {value!r}"
        ) from None


def _known() -> str:
    numbers = ", ".join((*STRUCTURE_NUMBERS, *_TYRE_NUMBERS))
    return f"choices are {', '.join(LAWS)}, {_TYRE}, numbers {numbers}"


def structure_laws(structure: Structure) -> dict[str, str]:
    """The choices of a structure by name, as `LAWS` has them."""
    ruts = (
        "none"
        if structure.ruts < 0.5
        else "pressure_and_shear"
        if structure.shear_carry > 0.5
        else "pressure"
    )
    return {
        "pressure_direction": LAWS["pressure_direction"][int(structure.ground_normal)],
        "pressure_from": LAWS["pressure_from"][int(structure.own_sinkage)],
        "shear": LAWS["shear"][int(structure.soil_path)],
        "strength": LAWS["strength"][1 - int(structure.resultant)],
        "ruts": ruts,
        "width": LAWS["width"][int(structure.hull)],
        "slip_sinkage": LAWS["slip_sinkage"][int(structure.slip_sinkage)],
        "shaft_torque": LAWS["shaft_torque"][int(structure.external_torque)],
    }


def structure_text(structure: Structure) -> str:
    """The text from which `read_structure` makes a structure: a preset's name where it is one."""
    rigid, tyre = structure._replace(tyre=None), structure.tyre
    on = [] if tyre is None else _tyre_text(tyre)
    for preset in STRUCTURES:
        if make_structure(preset) == rigid:
            return ",".join([preset, *on])
    laws = structure_laws(rigid)
    changes = [f"{name}={option}" for name, option in laws.items() if option != LAWS[name][0]]
    for name, (_, _, default) in STRUCTURE_NUMBERS.items():
        if getattr(rigid, name) != default:
            changes.append(f"{name}={float(getattr(rigid, name))!r}")
    return ",".join(["full", *changes, *on])


def _tyre_text(tyre: Tyre) -> list[str]:
    """A tyre by its name; otherwise by its size and pressure, and by what departs from the usual of these."""
    for name in TYRES:
        if TYRES[name] == tyre:
            return [f"{_TYRE}={name}"]
    usual = make_tyre(r=tyre.r, b=tyre.b, inflation=tyre.inflation)
    stated = ("r", "b", "inflation")
    return [
        f"{key}={float(getattr(tyre, name))!r}"
        for key, name in _TYRE_NUMBERS.items()
        if name in stated or getattr(tyre, name) != getattr(usual, name)
    ]


def _flag(value: bool) -> float:
    return 1.0 if value else 0.0


def _within(name: str, value: float, hint: str) -> float:
    low, high, _ = STRUCTURE_NUMBERS[name]
    number = float(array) if (array := numbers(name, value)).ndim == 0 else math.nan
    if not low <= number <= high:
        raise InvalidParameter(f"{name} must be in [{low:g}, {high:g}], got {shown(value)} - {hint}")
    return number
