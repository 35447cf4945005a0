"""Sensors by name, as objects, as mappings and as YAML: all the same thing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields, replace
from typing import Annotated, Any

from offroad_env.errors import InvalidParameter
from offroad_env.simulation.sensor_configs import (
    GNSS_RANGES,
    IMU_KINDS,
    IMU_RANGES,
    IMU_TRIPLES,
    WHEEL_RANGES,
    GnssConfig,
    ImuConfig,
    WheelSpeedConfig,
)
from offroad_env.simulation.sensor_presets import SENSORS, SensorPreset, make_sensors
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.world.catalogue import Quantity
from offroad_env.world.descriptions import Description
from offroad_env.world.documents import Document, is_name, open_document
from offroad_env.world.schema import CheckedBy, SectionSchema
from offroad_env.world.yaml_text import shown

__all__ = [
    "GNSS_KEYS",
    "IMU_KEYS",
    "PARTS",
    "SENSOR_KEYS",
    "WHEEL_KEYS",
    "SensorsLike",
    "read_sensors",
    "sensors_mapping",
]

Config = ImuConfig | WheelSpeedConfig | GnssConfig
#: What `read_sensors` takes.
SensorsLike = SensorSuite | SensorPreset | Config | Description


def _defaults(config: type[Config]) -> dict[str, object]:
    return {entry.name: entry.default for entry in fields(config) if entry.default is not MISSING}


def _triple(key: str, quantity: Quantity) -> Any:
    """Type of a key with three numbers."""

    def check(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise InvalidParameter(f"{key} must be a list of 3 numbers, got {shown(value)}")
        return tuple(quantity.check(f"{key}[{i}]", number) for i, number in enumerate(value))

    return Annotated[tuple[float, ...] | None, CheckedBy(check)]


IMU_KEYS = SectionSchema(
    name="imu",
    about="Inertial measurement unit.",
    records=(ImuConfig,),
    choices={"kind": IMU_KINDS},
    ranges=IMU_RANGES,
    flags=("body_axes",),
    others={
        key: (_triple(key, quantity), f"three, each {quantity.allowed}")
        for key, quantity in IMU_TRIPLES.items()
    },
    defaults=_defaults(ImuConfig),
    bases=lambda: SENSORS,
)
WHEEL_KEYS = SectionSchema(
    name="wheel",
    about="Wheel speed sensors.",
    records=(WheelSpeedConfig,),
    ranges=WHEEL_RANGES,
    defaults=_defaults(WheelSpeedConfig),
    bases=lambda: SENSORS,
)
GNSS_KEYS = SectionSchema(
    name="gnss",
    about="Satellite receiver.",
    records=(GnssConfig,),
    ranges=GNSS_RANGES,
    defaults=_defaults(GnssConfig),
    bases=lambda: SENSORS,
)
#: Sensor -> its keys.
PARTS: Mapping[str, SectionSchema] = {"imu": IMU_KEYS, "wheel": WHEEL_KEYS, "gnss": GNSS_KEYS}

_PART_OF: Mapping[type, str] = {ImuConfig: "imu", WheelSpeedConfig: "wheel", GnssConfig: "gnss"}

SENSOR_KEYS = SectionSchema(
    name="sensors",
    about="All sensors of a vehicle: a preset (`base`), and departures from it sensor by sensor.",
    records=(),
    ranges={},
    others=dict.fromkeys(PARTS, (Any, "description, preset, null")),
    defaults=dict.fromkeys(PARTS, "of the base"),
    meanings={
        "imu": "keys of `imu` below",
        "wheel": "keys of `wheel` below; null: no wheel speeds",
        "gnss": "keys of `gnss` below; null: no receiver",
    },
    bases=lambda: SENSORS,
)


def read_sensors(given: SensorsLike) -> SensorSuite:
    """Sensors from a name in `SENSORS`, an object, a mapping or YAML.

    Objects are those of `make_sensors` and `SENSORS`, and one configuration, which replaces that of "paper".

    Raises
    ------
    InvalidParameter, DataError
        With what is wrong, and where.
    """
    if isinstance(given, SensorSuite) or (isinstance(given, str) and is_name(given)):
        return make_sensors(given)
    if isinstance(given, SensorPreset):
        return SensorSuite(imu=given.imu, wheel=given.wheel, gnss=given.gnss)
    if isinstance(given, Config):
        return make_sensors("paper", **{_PART_OF[type(given)]: given})  # type: ignore[arg-type]
    document = open_document(given, "sensors")
    stated = document.check(SENSOR_KEYS)
    start = read_sensors(document.beside(stated.pop("base", "paper")))
    with document.refusing():
        parts = {name: _part(name, value, getattr(start, name), document) for name, value in stated.items()}
        return make_sensors(start, **parts)


def _part(name: str, value: Any, start: Config | None, document: Document) -> Any:
    """One sensor: as `make_sensors` takes it."""
    if value is None or isinstance(value, str | Config):
        return value
    lines = {
        key.removeprefix(f"{name}."): line
        for key, line in document.lines.items()
        if key.startswith(f"{name}.")
    }
    stated = PARTS[name].check(value, f"{document.where}: {name}", lines)
    base = stated.pop("base", None)
    if base is not None:
        start = getattr(make_sensors(base), name)
    if start is None:
        start = getattr(make_sensors("paper"), name)
    return replace(start, **stated)


def sensors_mapping(sensors: SensorSuite) -> dict[str, Any]:
    """The mapping from which `read_sensors` makes these sensors."""
    found: dict[str, Any] = {}
    for name in PARTS:
        part = getattr(sensors, name)
        found[name] = None if part is None else asdict(part)
    return found
