"""Columns of a log, their units, and the range of possible values."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from difflib import get_close_matches
from types import MappingProxyType
from typing import NamedTuple

__all__ = [
    "ALL_COLUMNS",
    "DATA_ENDINGS",
    "DRIVE",
    "IMU",
    "RAW_COLUMNS",
    "REFERENCE",
    "RIG_COLUMNS",
    "UNITS",
    "VEHICLE_COLUMNS",
    "VEHICLE_INPUTS",
    "Column",
    "find_unit",
    "nearest",
    "plain_unit",
    "unit_factor",
]

#: Endings of the files that hold a log's samples; a description stands beside them.
DATA_ENDINGS = (".csv", ".parquet", ".bag", ".mcap")
REFERENCE = "ref_"  #: columns of this prefix are for people; no filter and no diagnosis uses them


class Column(NamedTuple):
    """A channel of a log."""

    name: str
    dimension: str  #: key of `UNITS`, whose first unit is the one in memory
    limit: float  #: no true value is larger than this, whatever the vehicle (in the unit in memory)
    mistake: str  #: what a larger value usually is
    meaning: str

    @property
    def unit(self) -> str:
        """Unit in memory (SI)."""
        return next(iter(UNITS[self.dimension]))


_TURN = math.radians(1.0)
_STANDARD_GRAVITY = 9.80665  #: what a sensor that reads in g means [m/s^2]

#: Units by dimension: name -> factor to the first one, which is the unit in memory.
UNITS = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
        "angle": {"rad": 1.0, "deg": _TURN, "mrad": 1e-3},
        "angular rate": {
            "rad/s": 1.0, "deg/s": _TURN, "mrad/s": 1e-3, "rpm": math.pi / 30.0, "rev/s": 2.0 * math.pi,
        },
        "acceleration": {
            "m/s^2": 1.0, "g": _STANDARD_GRAVITY, "mg": 1e-3 * _STANDARD_GRAVITY, "cm/s^2": 1e-2,
            "ft/s^2": 0.3048,
        },
        "force": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
        "torque": {"N m": 1.0, "kN m": 1e3, "N mm": 1e-3, "lbf ft": 1.3558179483314004},
        "length": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048},
        "speed": {
            "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0, "cm/s": 1e-2,
            "mm/s": 1e-3, "ft/s": 0.3048,
        },
        "ratio": {"-": 1.0, "%": 1e-2},
        "latitude": {"deg": 1.0, "rad": 1.0 / _TURN, "1e-7 deg": 1e-7},
    }
)  # fmt: skip

_SPELLINGS = MappingProxyType(
    {
        "degrees": "deg", "degree": "deg", "dps": "deg/s", "radians": "rad", "radian": "rad",
        "kph": "km/h", "km/hr": "km/h", "kmh": "km/h", "nm": "n m", "mps": "m/s", "hz": "rev/s",
        "1/min": "rpm", "rev/min": "rpm", "min^-1": "rpm", "min-1": "rpm", "u/min": "rpm", "tr/min": "rpm",
        "1/s": "rev/s", "s^-1": "rev/s", "s-1": "rev/s", "u/s": "rev/s", "tr/s": "rev/s", "rps": "rev/s",
        "gs": "g", "g0": "g", "milli-g": "mg", "sec": "s", "seconds": "s", "m/s2": "m/s^2", "m/s/s": "m/s^2",
        "m/s**2": "m/s^2", "cm/s2": "cm/s^2", "ft/s2": "ft/s^2", "percent": "%", "knots": "kn", "inch": "in",
        "meter": "m", "metre": "m", "meters": "m", "metres": "m", "newton": "n", "usec": "us", "msec": "ms",
        "nsec": "ns", "1": "-", "degrees/s": "deg/s", "degree/s": "deg/s", "deg/sec": "deg/s",
        "rad/sec": "rad/s", "m/sec": "m/s",
    }
)  # fmt: skip

_RIGHT_ANGLE = 0.5 * math.pi + 1e-6
_COUNTS = "raw counts of the sensor"
_DEGREES = "degrees given as rad"


def _table(rows: Iterable[tuple[str, str, float, str, str]]) -> MappingProxyType[str, Column]:
    return MappingProxyType({row[0]: Column(*row) for row in rows})


#: Columns of a vehicle log. A satellite receiver measures `speed` and `course`: the velocity over
#: ground, whose direction is not the heading.
VEHICLE_COLUMNS = _table(
    (
        ("t", "time", 1e12, "", "time"),
        ("steer", "angle", _RIGHT_ANGLE, _DEGREES, "front road-wheel angle, left positive"),
        ("drive_force", "force", 1e7, "", "total body force"),
        ("torque_f", "torque", 1e6, "", "torque at the wheels, front axle"),
        ("torque_r", "torque", 1e6, "", "torque at the wheels, rear axle"),
        ("omega_f", "angular rate", 1e4, _COUNTS, "wheel speed, mean of the front axle"),
        ("omega_r", "angular rate", 1e4, _COUNTS, "wheel speed, mean of the rear axle"),
        ("a_x", "acceleration", 1e4, _COUNTS, "acceleration of the IMU, forward"),
        ("a_y", "acceleration", 1e4, _COUNTS, "acceleration of the IMU, left"),
        ("a_z", "acceleration", 1e4, _COUNTS, "acceleration of the IMU, up"),
        ("roll_rate", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, "roll rate"),
        ("pitch_rate", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, "nose up positive"),
        ("yaw_rate", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, "left positive"),
        ("x", "length", 1e8, "mm given as m", "position"),
        ("y", "length", 1e8, "mm given as m", "position"),
        ("yaw", "angle", 1e5, _DEGREES, "heading"),
        ("pitch", "angle", _RIGHT_ANGLE, _DEGREES, "nose up positive"),
        ("roll", "angle", math.pi + 1e-6, _DEGREES, "right side down positive"),
        ("v_x", "speed", 400.0, "mm/s or cm/s given as m/s", "speed, forward body axis"),
        ("v_y", "speed", 400.0, "mm/s or cm/s given as m/s", "speed, left body axis"),
        ("speed", "speed", 400.0, "mm/s or cm/s given as m/s", "speed over ground"),
        ("course", "angle", 1e5, _DEGREES, "direction of travel, from x towards y"),
    )
)

_WHEEL, _GYRO = "wheel speed, {}", "rate about the {} axis of the IMU by the right hand"

#: Columns that a file may have in place of those of a log, which are computed from them
#: (`estimators.logs.raw`).
RAW_COLUMNS = _table(
    (
        ("gyro_x", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, _GYRO.format("x")),
        ("gyro_y", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, _GYRO.format("y")),
        ("gyro_z", "angular rate", 1e3, "deg/s given as rad/s, or " + _COUNTS, _GYRO.format("z")),
        ("q_w", "ratio", 1.1, "", "attitude as a quaternion, real part"),
        ("q_x", "ratio", 1.1, "", "attitude as a quaternion, x"),
        ("q_y", "ratio", 1.1, "", "attitude as a quaternion, y"),
        ("q_z", "ratio", 1.1, "", "attitude as a quaternion, z"),
        ("latitude", "latitude", 90.0, "degrees and minutes given as degrees", "north positive"),
        ("longitude", "latitude", 360.0, "degrees and minutes given as degrees", "east positive"),
        ("omega", "angular rate", 1e4, _COUNTS, _WHEEL.format("mean of all")),
        ("omega_fl", "angular rate", 1e4, _COUNTS, _WHEEL.format("front left")),
        ("omega_fr", "angular rate", 1e4, _COUNTS, _WHEEL.format("front right")),
        ("omega_rl", "angular rate", 1e4, _COUNTS, _WHEEL.format("rear left")),
        ("omega_rr", "angular rate", 1e4, _COUNTS, _WHEEL.format("rear right")),
        ("omega_left", "angular rate", 1e4, _COUNTS, _WHEEL.format("mean of the left side")),
        ("omega_right", "angular rate", 1e4, _COUNTS, _WHEEL.format("mean of the right side")),
        ("torque_total", "torque", 1e6, "", "torque at all wheels"),
        ("torque_fl", "torque", 1e6, "", "torque at the front left wheel"),
        ("torque_fr", "torque", 1e6, "", "torque at the front right wheel"),
        ("torque_rl", "torque", 1e6, "", "torque at the rear left wheel"),
        ("torque_rr", "torque", 1e6, "", "torque at the rear right wheel"),
    )
)
#: All columns that the file of a vehicle may have.
VEHICLE_INPUTS = MappingProxyType({**VEHICLE_COLUMNS, **RAW_COLUMNS})

#: Columns of a wheel-rig log, one row a steady trial. `condition` labels repeats of one setting.
RIG_COLUMNS = _table(
    (
        ("slip", "ratio", 1.0 + 1e-9, "per cent given as a ratio", "longitudinal slip"),
        ("slip_angle", "angle", _RIGHT_ANGLE, _DEGREES, "positive: the wheel slides to its left"),
        ("load", "force", 1e6, "", "wheel load"),
        ("drawbar", "force", 1e6, "", "force along the wheel, forward positive"),
        ("side_force", "force", 1e6, "", "force across the wheel, left positive"),
        ("torque", "torque", 1e6, "", "drive torque"),
        ("sinkage", "length", 3.0, "mm or cm given as m", "depth below the undisturbed surface"),
        ("condition", "ratio", 1e9, "", "label of the setting: repeats share it"),
    )
)

#: All columns that a file may have.
ALL_COLUMNS = MappingProxyType({**VEHICLE_INPUTS, **RIG_COLUMNS})

#: Channels of a complete IMU, besides roll_rate. A log may lack some of them.
IMU = ("a_x", "a_y", "a_z", "pitch_rate", "yaw_rate")
#: A vehicle log has at least one of these.
DRIVE = ("omega_f", "omega_r", "drive_force", "torque_f", "torque_r")


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that is spelt most like ``word``, or None if none is near."""
    table = {item.lower(): item for item in known}
    plain = word.lower().split("[")[0].split("(")[0].strip().replace(" ", "_").replace("-", "_")
    found = get_close_matches(plain, table, n=1, cutoff=0.6)
    return table[found[0]] if found else None


def plain_unit(unit: str) -> str:
    """One spelling of a unit: no spaces or dots, lower case, ASCII."""
    # With a capital a German degree, and no gradian or a thousand million radians.
    text = (
        re.sub(r"^Grad\b", "deg", unit.strip())
        .lower()
        .replace("⁻¹", "^-1")
        .replace("²", "^2")
        .replace("°", "deg")
        .replace("µ", "u")
        .replace("μ", "u")
    )
    for sign in (" ", "·", "*", "."):
        text = text.replace(sign, "") if text != "m/s**2" else text
    return _SPELLINGS.get(text, text)


def find_unit(unit: str, dimension: str) -> str | None:
    """The name in `UNITS` that ``unit`` is a spelling of, or None if it measures something else."""
    wanted = plain_unit(unit)
    return next((name for name in UNITS[dimension] if plain_unit(name) == wanted), None)


def unit_factor(unit: str, dimension: str) -> float:
    """What values in ``unit`` are multiplied by; the name must be one of `UNITS`."""
    return UNITS[dimension][unit]
