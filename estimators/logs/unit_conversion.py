"""Units of the columns of a log: what a value in a file is multiplied by, and added to.

Common units are in `estimators.logs.schema`; anything else is looked up in Pint (pint.readthedocs.io).
A unit may have a number before it: ``0.0175 deg/s`` for the counts of a sensor.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

from estimators.logs.schema import UNITS, Column, find_unit, nearest, unit_factor
from offroad_env.errors import InvalidParameter
from offroad_env.world.yaml_text import shown

__all__ = ["COMPASS", "Conversion", "conversion"]

#: Suffix of a unit of angle: clockwise from north, where a log counts counterclockwise from x (east).
COMPASS = "compass"

_SCALED = re.compile(r"(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\*?\s*(?P<unit>.+)")
#: Names that Pint is asked for: words, each with one power of a digit, products and quotients. Powers of
#: powers would be computed, for hours if they are large.
_NAME = re.compile(r"(?:[A-Za-zµμ°Ωωπ_%](?:\^-?\d|\*\*-?\d|[²³])?|[-·*/ ()])+")
_LONGEST = 40
#: Coherent SI units of the dimensions.
_COHERENT = {
    "time": "second", "angle": "radian", "angular rate": "radian/second", "acceleration": "meter/second**2",
    "force": "newton", "torque": "newton*meter", "length": "meter", "speed": "meter/second",
    "ratio": "dimensionless", "latitude": "degree",
}  # fmt: skip


class Conversion(NamedTuple):
    """From a file to memory: ``factor * value + shift``."""

    factor: float
    shift: float = 0.0
    over_radius: bool = False  #: a speed of the rim: to be divided by the wheel's radius


def conversion(unit: str, column: Column) -> Conversion:
    """How values of a column in ``unit`` are converted.

    Raises
    ------
    InvalidParameter
        If the unit is none, or measures something else.
    """
    text = unit.strip()
    scaled = _SCALED.fullmatch(text)
    number, name = (float(scaled["number"]), scaled["unit"]) if scaled else (1.0, text)
    if find_unit(text, column.dimension) is not None:
        number, name = 1.0, text  # such as 1e-7 deg
    if column.dimension == "angle" and name.endswith(COMPASS):
        angle = conversion(name.removesuffix(COMPASS).strip() or "deg", column)
        return Conversion(-number * angle.factor, 0.5 * math.pi)
    factor = _factor(name, column.dimension)
    if factor is not None and number != 0.0:
        return Conversion(number * factor)
    if column.name.startswith("omega") and (rim := _factor(name, "speed")) is not None and number != 0.0:
        return Conversion(number * rim, over_radius=True)
    raise InvalidParameter(
        f"must be a unit of {_allowed(column)}, got {shown(unit)}{_hint(name, column.dimension)}"
    )


def _allowed(column: Column) -> str:
    rim = "; or of the speed of the rim (m/s, km/h)" if column.name.startswith("omega") else ""
    compass = f", deg {COMPASS}" if column.name in ("yaw", "course") else ""
    return f"{column.dimension} ({', '.join(UNITS[column.dimension])}{compass}{rim})"


def _hint(name: str, dimension: str) -> str:
    near = nearest(name, UNITS[dimension])
    if near:
        return f" - did you mean {near}?"
    other = next((d for d in UNITS if find_unit(name, d) is not None), None)
    return f" - that is a unit of {other}" if other and other != dimension else ""


def _factor(name: str, dimension: str) -> float | None:
    """Factor to SI of a unit without a number, None if it is none of that dimension."""
    known = find_unit(name, dimension)
    if known is not None:
        return unit_factor(known, dimension)
    if any(find_unit(name, other) for other in UNITS):
        return None  # a g is no gram here
    if len(name) > _LONGEST or not _NAME.fullmatch(name) or (dimension.startswith("angular") and "%" in name):
        return None
    return _asked(name, _COHERENT[dimension])


@cache
def _registry() -> Any:
    import pint  # half a second that most logs do not need

    return pint.UnitRegistry(cache_folder=None)


def _of_turns(base: Any, coherent: str) -> float:
    """What turns an angle or angular rate as Pint counts it, which takes any number for radians, into ours.

    A rate per time alone counts turns, as ``1/min`` and Hz do; counts and shares (%) are no angle: factor 0.
    """
    if not coherent.startswith("radian") or "radian" in str(base.units):
        return 1.0
    return 2.0 * math.pi if str(base.units) == "1 / second" else 0.0


@cache
def _asked(name: str, coherent: str) -> float | None:
    """Factor by Pint."""
    registry = _registry()
    try:
        found = registry.Quantity(1.0, registry.parse_units(name.replace("^", "**")))
        factor = _of_turns(found.to_base_units(), coherent) * float(found.to(coherent).magnitude)
    except Exception:  # Pint fails in many ways on text that is no unit; all of them mean the same
        return None
    return factor if math.isfinite(factor) and factor != 0.0 else None
