"""From the YAML beside a log to its `LogConfig`, checked key by key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

from estimators.logs.config import (
    RIGID_KEYS,
    SOIL_KEYS,
    STATE_KEYS,
    UNKNOWN,
    GnssSpec,
    ImuSpec,
    LogConfig,
    StartSpec,
    TerrainSpec,
    Wave,
)
from estimators.logs.mounting import parse_orientation
from estimators.logs.schema import nearest
from estimators.logs.yaml_sections import Section
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import FourWheel, Soil, Vehicle, Wheel
from offroad_env.simulation.simulator import MODELS
from offroad_env.world.catalogue import Quantity
from offroad_env.world.descriptions import read_soil, read_vehicle
from offroad_env.world.four_wheel import FOUR_WHEEL_FIELDS, FourWheelFields, make_four_wheel
from offroad_env.world.soils import make_soil
from offroad_env.world.structures import read_structure
from offroad_env.world.tyres import require_fitting_tyre
from offroad_env.world.vehicles import make_vehicle, make_wheel
from offroad_env.world.yaml_text import shown

__all__ = ["parse_config"]

_Described = TypeVar("_Described")

_DRIVETRAINS = ("force", "torque")
_HOLDS = ("zoh", "linear")
#: In place of the section ``start``: position, heading and speed of the first samples.
_FROM_DATA = "log"
_TOLERANCES = ("usual", "none")
_TERRAINS = ("paper", "flat", "unknown", "waves", "grid")
_NEEDED_VEHICLE = ("m", "I_z", "I_y", "l_f", "l_r", "k_f", "k_r", "c_f", "c_r", "m_w", "r", "b")
_NEEDED_SOIL = ("k_phi", "n", "c", "phi")
_NEEDED_RIGID = ("mu", "C_alpha")

_SLIP = Quantity("in (-1, 1)", -1.0, 1.0, True, True, mistakes=((1.0, 100.0, "per cent"),))
_ACCELERATION_SD = Quantity("in (0, 50] m/s^2", 0.0, 50.0, low_open=True)
_RATE_SD = Quantity("in (0, 5] rad/s", 0.0, 5.0, low_open=True, mistakes=((5.0000001, 300.0, "deg/s"),))
_POSITION_SD = Quantity("in (0, 100] m", 0.0, 100.0, low_open=True, mistakes=((100.0000001, 1e5, "mm"),))
_IMU_RATE = Quantity("in [1, 1000] Hz", 1.0, 1000.0)
_SPEED_SD = Quantity("in (0, 20] m/s", 0.0, 20.0, low_open=True)
_ARM = Quantity("in [-10, 10] m", -10.0, 10.0, mistakes=((10.0000001, 1e4, "mm or cm given as m"),))
_HEIGHT = Quantity("in [-2, 2] m", -2.0, 2.0, mistakes=((2.0000001, 2e3, "mm or cm given as m"),))
_RMS = Quantity("in (0, 2] m", 0.0, 2.0, low_open=True, mistakes=((2.0000001, 2e3, "mm given as m"),))
_PLACE = Quantity("in [-1e8, 1e8] m", -1e8, 1e8)
_YAW = Quantity("in [-1e5, 1e5] rad", -1e5, 1e5)
_SPEED = Quantity("in [-100, 100] m/s", -100.0, 100.0)
_ANY = Quantity("of ordinary size", -1e12, 1e12)


def parse_config(top: Section, *, rig: bool) -> LogConfig:
    """Check the whole description and make its records.

    Parameters
    ----------
    top
        The YAML's top mapping; keys that only a bag has must have been taken already.
    rig
        Whether the columns are those of a wheel rig, which needs ``wheel`` (or ``vehicle``) with
        r and b, and ``soil``.

    Raises
    ------
    DataError
        One sentence with file, line, key, value, allowed range.
    """
    units = _units(top)
    if rig:
        config = _rig_config(top, units)
    else:
        vehicle, four_wheel = _vehicle_of(top)
        from_data = top.peek("start") == _FROM_DATA
        config = LogConfig(
            model=top.choice("model", MODELS),
            structure=_structure(top, Wheel(vehicle.r, vehicle.b)),
            drivetrain=top.choice("drivetrain", _DRIVETRAINS),
            slip=top.number("slip", _SLIP, 0.0),
            vehicle=vehicle,
            four_wheel=four_wheel,
            soil=_soil_of(top),
            terrain=_terrain(top.section("terrain")),
            imu=_imu(top.section("imu")),
            gnss=_gnss(top),
            hold=_hold(top),
            start=_start(top),
            start_from_data=from_data,
            unknown=_unknown(top),
            exact=top.choice("tolerances", _TOLERANCES, "usual") == "none",
            units=units,
        )
    top.finish()
    return config


def _structure(top: Section, wheel: Wheel) -> str:
    """The laws of the wheels, as text that can be read, with tyres that fit."""
    text = top.take("structure", "full")
    try:
        if not isinstance(text, str):
            raise InvalidParameter(f"structure must be text, got {shown(text)}")
        tyre = read_structure(text).tyre
        if tyre is not None:
            require_fitting_tyre(tyre, wheel)
    except InvalidParameter as error:
        raise top.error(str(error), "structure") from None
    return text


def _units(top: Section) -> tuple[tuple[str, str], ...]:
    section = top.optional("units")
    if section is None:
        return ()
    pairs = section.rest()
    for column, unit in pairs.items():
        if not isinstance(column, str) or not isinstance(unit, str):
            raise section.error(f"units.{column} must be the name of a unit, got {shown(unit)}", str(column))
    return tuple(pairs.items())


def _unknown(top: Section) -> tuple[str, ...]:
    given = top.take("unknown", [])
    names = given if isinstance(given, list) else [given]
    for name in names:
        if name not in UNKNOWN:
            near = nearest(name, UNKNOWN) if isinstance(name, str) else None
            hint = f" - did you mean {near}?" if near else ""
            allowed = ", ".join(UNKNOWN)
            raise top.error(f"unknown must be a list of {allowed}, got {shown(name)}{hint}", "unknown")
    return tuple(dict.fromkeys(names))


def _rig_config(top: Section, units: tuple[tuple[str, str], ...]) -> LogConfig:
    model = top.choice("model", MODELS, "full")
    key = "wheel" if "wheel" in top or "vehicle" not in top else "vehicle"
    if key == "wheel":
        body = top.section("wheel")
        wheel = _wheel(body)
        body.finish()
    else:  # the record of a vehicle whose wheel is on the rig: only the wheel matters
        body = top.section("vehicle")
        wheel = _wheel(body)
        body.rest()
    soil = _soil_of(top)
    for name in ("drivetrain", "slip", "terrain", "imu", "gnss", "inputs", "start", "unknown", "tolerances"):
        top.take(name, None)  # harmless beside a wheel: the same YAML may serve a vehicle
    return LogConfig(model=model, structure=_structure(top, wheel), wheel=wheel, soil=soil, units=units)


def _refused(section: Section, error: InvalidParameter) -> DataError:
    """The refusal of a factory with the place in the file; its message starts with the name of the field."""
    sentence, field_name = str(error), str(error).split()[0]
    if field_name in (*Vehicle._fields, *FOUR_WHEEL_FIELDS, *Soil._fields):
        return section.error(section.name(sentence), field_name)
    return section.error(f"{section.name('')[:-1]}: {sentence}")


def _wheel(section: Section) -> Wheel:
    try:
        return make_wheel(r=section.take("r"), b=section.take("b"))
    except InvalidParameter as error:
        raise _refused(section, error) from None


def _vehicle_of(top: Section) -> tuple[Vehicle, FourWheel | None]:
    """The vehicle: all keys, or a name of the catalogue, or a ``base`` with changes, or a file."""
    given = top.peek("vehicle")
    if isinstance(given, dict) and "base" not in given:
        return _vehicle(top.section("vehicle"))
    found = _described(top, "vehicle", read_vehicle)
    return found.record, found.four_wheel


def _soil_of(top: Section) -> Soil:
    """The soil, in the same ways."""
    given = top.peek("soil")
    if isinstance(given, dict) and "base" not in given:
        return _soil(top.section("soil"))
    return _described(top, "soil", read_soil).record


def _described(top: Section, key: str, read: Callable[[Any], _Described]) -> _Described:
    """What a name, a file or a mapping with ``base`` describes, as everywhere in the project."""
    value = top.take(key)
    if isinstance(value, str) and value.lower().endswith((".yaml", ".yml")):
        value = top.beside(value)
    elif not isinstance(value, (str, dict)):
        raise top.error(
            f"{key} must be a name of the catalogue, or hold keys with values, got {shown(value)}", key
        )
    try:
        return read(value)
    except (InvalidParameter, DataError) as error:
        sentence = str(error)
        raise top.error(sentence if sentence.startswith(key) else f"{key}: {sentence}", key) from None


def _vehicle(section: Section) -> tuple[Vehicle, FourWheel | None]:
    given = {name: section.number(name, _ANY) for name in _NEEDED_VEHICLE}
    given["wheels_per_axle"] = section.number("wheels_per_axle", _ANY, 2.0)
    for name in Vehicle._fields:
        if name not in given and (value := section.number(name, _ANY, None)) is not None:
            given[name] = value
    fields = {name: section.number(name, _ANY, None) for name in FOUR_WHEEL_FIELDS}
    stated = {name: value for name, value in fields.items() if value is not None}
    section.finish()
    try:
        vehicle = make_vehicle(None, **(_assumed(given) | given))
        return vehicle, _four_wheel(vehicle, cast("FourWheelFields", stated))
    except InvalidParameter as error:
        raise _refused(section, error) from None


def _four_wheel(vehicle: Vehicle, fields: FourWheelFields) -> FourWheel | None:
    """What the log states of a vehicle with four wheels; None where it states nothing."""
    return make_four_wheel(vehicle, **fields) if fields else None


def _assumed(given: Mapping[str, float]) -> dict[str, float]:
    """Values for the optional keys.

    What the log states acts as it stands: no lag or limit that the file does not name, no drag.
    The geometry that only load transfer and roll-over use, and the spin inertia, follow the
    proportions of the catalogue's vehicles.
    """
    m, r = max(given["m"], 0.0), max(given["r"], 0.0)
    wheelbase = max(given["l_f"] + given["l_r"], 0.05)
    share = given.get("drive_front", 0.5)
    return {
        "I_w": max(0.5 * given["m_w"] / max(given["wheels_per_axle"], 1.0) * r * r, 1e-7),
        "h_cg": 0.22 * wheelbase,
        "track": max(0.5 * wheelbase, 1.5 * given["b"], 0.01),
        "drag_area": 0.0,
        "rolling_resistance": 0.0,
        "steer_max": 1.5,
        "steer_rate": 19.0,
        "steer_lag": 0.0,
        "torque_lag": 0.0,
        "drive_torque_max": min(5.0 * GRAVITY * m * r, 1e6),
        "brake_torque_max": min(5.0 * GRAVITY * m * r, 1e6),
        "power_max": min(1999.0 * m, 1e7),  # so high that it takes less than 0.1 % of any torque
        "drive_front": share,
        "brake_front": share,
    }


def _soil(section: Section) -> Soil:
    kind = section.choice("kind", ("deformable", "rigid"), "deformable")
    keys: tuple[str, ...] = RIGID_KEYS if kind == "rigid" else SOIL_KEYS
    needed: tuple[str, ...] = _NEEDED_RIGID if kind == "rigid" else _NEEDED_SOIL
    given = {name: section.number(name, _ANY) for name in needed}
    for name in keys:
        if name not in needed and (value := section.number(name, _ANY, None)) is not None:
            given[name] = value
    section.finish()
    try:
        return make_soil(None, kind=kind, **given)
    except InvalidParameter as error:
        raise _refused(section, error) from None


def _terrain(section: Section) -> TerrainSpec:
    kind = section.choice("kind", _TERRAINS)
    if kind == "grid":
        raise section.error(
            "terrain.kind grid is not supported yet: the simulator's ground is a plane with waves - "
            "give kind: waves, or kind: unknown with the rms of the height",
            "kind",
        )
    if kind == "paper":
        spec = TerrainSpec(kind=kind, H_0=section.number("H0", _HEIGHT))
    elif kind == "unknown":
        spec = TerrainSpec(kind=kind, rms=section.number("rms", _RMS))
    elif kind == "waves":
        plane = section.triple("plane", _ANY, (0.0, 0.0, 0.0))
        spec = TerrainSpec(kind=kind, plane=plane, waves=_waves(section))
    else:
        spec = TerrainSpec(kind=kind)
    section.finish()
    return spec


def _waves(section: Section) -> tuple[Wave, ...]:
    rows = section.take("waves")
    if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 4 for row in rows):
        raise section.error("terrain.waves must be a list of [amplitude, p, q, phase]", "waves")
    try:
        return tuple(_wave(row) for row in rows)
    except InvalidParameter as error:
        raise section.error(str(error), "waves") from None


def _wave(row: list[float]) -> Wave:
    amplitude, p, q, phase = (_ANY.check("terrain.waves", value) for value in row)
    return amplitude, p, q, phase


def _imu(section: Section) -> ImuSpec:
    kinematic = section.flag("kinematic")
    position = section.triple("position", _ARM, (0.0, 0.0, 0.0))
    orientation = parse_orientation(section)
    sd = section.section("sd")
    spec = ImuSpec(
        kinematic=kinematic,
        position=position,
        sd_a=sd.number("a", _ACCELERATION_SD),
        sd_rate=sd.number("rate", _RATE_SD),
        orientation=orientation,
        rate=_rate(section),
    )
    sd.finish()
    section.finish()
    return spec


def _rate(section: Section) -> float | None:
    """``imu.rate``: a number [Hz], or text with the unit."""
    given = section.take("rate", None)
    if given is None:
        return None
    number: Any = given
    words = given.split() if isinstance(given, str) else []
    if len(words) == 2 and words[1].lower() == "hz":
        try:
            number = float(words[0])
        except ValueError:
            number = given
    if isinstance(number, str):
        raise section.error(f"imu.rate must be a rate such as 100 Hz, got {shown(given)}", "rate")
    try:
        return _IMU_RATE.check("imu.rate", number)
    except InvalidParameter as error:
        raise section.error(str(error), "rate") from None


def _gnss(top: Section) -> GnssSpec | None:
    section = top.optional("gnss")
    if section is None:
        return None
    sd = section.section("sd")
    spec = GnssSpec(
        sd_position=sd.number("position", _POSITION_SD), sd_speed=sd.number("speed", _SPEED_SD, None)
    )
    sd.finish()
    section.finish()
    return spec


def _hold(top: Section) -> str:
    section = top.optional("inputs")
    if section is None:
        return "zoh"
    hold = section.choice("hold", _HOLDS, "zoh")
    section.finish()
    return hold


def _start(top: Section) -> StartSpec:
    if top.peek("start") == _FROM_DATA:
        top.take("start")
        return StartSpec()
    section = top.section("start")
    if "settled" in section and not section.flag("settled"):
        raise section.error("start.settled must be true, or left out where start.state is given", "settled")
    x = section.number("x", _PLACE, 0.0)
    y = section.number("y", _PLACE, 0.0)
    yaw = section.number("yaw", _YAW, 0.0)
    if "state" not in section:
        speed = section.number("v_x", _SPEED)
        section.take("state", None)
        section.take("settled", None)
        section.finish()
        return StartSpec(x=x, y=y, yaw=yaw, v_x=speed)
    section.take("v_x", None)
    body = section.section("state")
    aliases = {"X": "x", "Y": "y"}  # as the paper writes them
    state = {
        name: body.number(alias, _ANY)
        for alias, name in (*aliases.items(), *((key, key) for key in STATE_KEYS))
        if alias in body
    }
    for key in STATE_KEYS:
        body.take(key, None)
    body.finish()
    section.finish()
    if "v_x" not in state:
        raise section.error("start.state.v_x is missing: without its speed the vehicle has no start", "state")
    return StartSpec(
        x=state.get("x", x),
        y=state.get("y", y),
        yaw=state.get("yaw", yaw),
        v_x=state["v_x"],
        state=tuple(state.items()),
    )
