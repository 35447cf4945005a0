"""The YAML beside a log: everything a simulation of the run needs, checked key by key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml

from estimators.logs.schema import nearest
from offroad_env.catalogue import Quantity
from offroad_env.errors import DataError, InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.physics.records import Ground, Soil, Vehicle, Wheel
from offroad_env.simulator import MODELS
from offroad_env.soils import make_soil
from offroad_env.terrain import flat, paper_terrain
from offroad_env.vehicles import make_vehicle, make_wheel

__all__ = [
    "STATE_KEYS",
    "UNKNOWN",
    "GnssSpec",
    "ImuSpec",
    "LogConfig",
    "Section",
    "StartSpec",
    "TerrainSpec",
    "parse_config",
    "parse_yaml",
]

DRIVETRAINS = ("force", "torque")
HOLDS = ("zoh", "linear")
#: What a description may call unknown, although it has to hold some value.
UNKNOWN = ("imu.position", "gnss.position", "suspension")
TERRAINS = ("paper", "flat", "unknown", "waves", "grid")

#: Keys of ``start: {state: {...}}``, in the order of `offroad_env.physics.state`.
STATE_KEYS = (
    "x", "y", "yaw", "z", "pitch", "v_x", "v_y", "v_z", "pitch_rate", "yaw_rate",
    "omega_f", "omega_r", "steer", "drive_torque", "brake_torque",
)  # fmt: skip

_NEEDED_VEHICLE = ("m", "I_z", "I_y", "l_f", "l_r", "k_f", "k_r", "c_f", "c_r", "m_w", "r", "b")
_SOIL_KEYS = ("k_c", "k_phi", "n", "c", "phi", "k_x", "k_y", "a_0", "a_1", "b_0", "b_1")
_NEEDED_SOIL = ("k_phi", "n", "c", "phi")
_NEEDED_RIGID = ("mu", "C_alpha")
_RIGID_KEYS = (*_NEEDED_RIGID, "C_kappa")

_SLIP = Quantity("in (-1, 1)", -1.0, 1.0, True, True, mistakes=((1.0, 100.0, "per cent"),))
_ACCELERATION_SD = Quantity("in (0, 50] m/s^2", 0.0, 50.0, low_open=True)
_RATE_SD = Quantity("in (0, 5] rad/s", 0.0, 5.0, low_open=True, mistakes=((5.0000001, 300.0, "deg/s"),))
_POSITION_SD = Quantity("in (0, 100] m", 0.0, 100.0, low_open=True, mistakes=((100.0000001, 1e5, "mm"),))
_SPEED_SD = Quantity("in (0, 20] m/s", 0.0, 20.0, low_open=True)
_ARM = Quantity("in [-10, 10] m", -10.0, 10.0, mistakes=((10.0000001, 1e4, "mm or cm given as m"),))
_HEIGHT = Quantity("in [-2, 2] m", -2.0, 2.0, mistakes=((2.0000001, 2e3, "mm or cm given as m"),))
_RMS = Quantity("in (0, 2] m", 0.0, 2.0, low_open=True, mistakes=((2.0000001, 2e3, "mm given as m"),))
_PLACE = Quantity("in [-1e8, 1e8] m", -1e8, 1e8)
_YAW = Quantity("in [-1e5, 1e5] rad", -1e5, 1e5)
_SPEED = Quantity("in [-100, 100] m/s", -100.0, 100.0)
_ANY = Quantity("of ordinary size", -1e12, 1e12)


@dataclass(frozen=True, kw_only=True)
class ImuSpec:
    """What the accelerometers feel, where the IMU sits, and its noise."""

    kinematic: bool  #: True: acceleration; False: specific force, which holds +g at rest
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: from the CG: forward, left, up [m]
    sd_a: float  #: standard deviation of an acceleration sample [m/s^2]
    sd_rate: float  #: standard deviation of a rate sample [rad/s]


@dataclass(frozen=True, kw_only=True)
class GnssSpec:
    """Noise of position and speed."""

    sd_position: float  #: each axis [m]
    sd_speed: float | None = None  #: [m/s]


@dataclass(frozen=True, kw_only=True)
class TerrainSpec:
    """The ground of the run."""

    kind: str  #: "flat", "paper", "unknown" or "waves"
    H_0: float = 0.0  #: greatest height of the paper's field [m]
    rms: float = 0.0  #: standard deviation of the height of an unknown ground [m]
    plane: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: height [m] and slopes [-] under the waves
    waves: tuple[tuple[float, float, float, float], ...] = ()  #: rows as in `records.Ground.waves`

    def ground(self) -> Ground:
        """The ground as far as it is known: level where it is not."""
        if self.kind == "paper":
            return paper_terrain(self.H_0)
        if self.kind == "waves":
            rows = np.ascontiguousarray(np.array(self.waves, dtype=np.float64).reshape(-1, 4))
            return Ground(*self.plane, rows)
        return flat()


@dataclass(frozen=True, kw_only=True)
class StartSpec:
    """How the run begins. Values in ``state`` replace those of the settled vehicle."""

    x: float = 0.0  #: [m]
    y: float = 0.0  #: [m]
    yaw: float = 0.0  #: [rad]
    v_x: float = 0.0  #: [m/s]
    state: tuple[tuple[str, float], ...] = ()  #: (name of `STATE_KEYS`, value) in SI


@dataclass(frozen=True, kw_only=True)
class LogConfig:
    """What the YAML says, in SI. A wheel rig has ``wheel`` instead of ``vehicle`` and what hangs on it."""

    soil: Soil  #: prior
    model: str = "full"  #: "full" or "paper"
    drivetrain: str = "torque"  #: "force" or "torque"
    slip: float = 0.0  #: constant slip of the paper's model [-]
    vehicle: Vehicle | None = None
    wheel: Wheel | None = None
    terrain: TerrainSpec = field(default_factory=lambda: TerrainSpec(kind="flat"))
    imu: ImuSpec | None = None
    gnss: GnssSpec | None = None
    hold: str = "zoh"  #: inputs hold from their stamp ("zoh") or run straight to the next ("linear")
    start: StartSpec = field(default_factory=StartSpec)
    unknown: tuple[str, ...] = ()  #: of `UNKNOWN`: what nobody has measured; a diagnosis does not judge it
    units: tuple[tuple[str, str], ...] = ()  #: (column, unit) that the file was read with

    def to_yaml(self) -> str:
        """The text of the YAML file; ``units`` is left out, since a written log is in SI."""
        return yaml.safe_dump(_as_mapping(self), sort_keys=False, default_flow_style=None, width=110)


class _Loader(yaml.SafeLoader):
    """YAML 1.1 takes 1e5 and 13.19e3 for text; people write them for numbers."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def parse_yaml(text: str, file: str) -> tuple[dict[str, Any], dict[str, int]]:
    """Content of a YAML file, and the line of every key path (``"vehicle.m"``).

    Raises
    ------
    DataError
        For a syntax error, a key given twice, or anything but a mapping, with file and line.
    """
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        lines: dict[str, int] = {}
        _note_lines(node, "", lines, file)
        data = None if node is None else loader.construct_document(node)
    except DataError:
        raise
    except yaml.YAMLError as error:
        raise DataError(_syntax(error, text, file)) from None
    except (ValueError, TypeError, OverflowError) as error:
        raise DataError(f"{file}: a value cannot be read: {error}") from None
    except RecursionError:
        raise DataError(f"{file}: nested too deeply to be the description of a log") from None
    finally:
        if loader is not None:
            loader.dispose()
    if data is None:
        raise DataError(f"{file}: is empty; it must describe vehicle, soil, terrain, IMU and start")
    if not isinstance(data, dict):
        raise DataError(f"{file}, line 1: must hold keys with values (vehicle: ...), got {_shown(data)}")
    return data, lines


def _syntax(error: yaml.YAMLError, text: str, file: str) -> str:
    mark, position = getattr(error, "problem_mark", None), getattr(error, "position", None)
    line = mark.line + 1 if mark else text.count("\n", 0, position) + 1 if position else None
    where = "" if line is None else f", line {line}"
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "not YAML"
    return f"{file}{where}: YAML syntax: {problem}"


def _note_lines(node: yaml.Node | None, path: str, lines: dict[str, int], file: str) -> None:
    """Lines of all keys; refuses a key that stands twice in one mapping (YAML would keep the last)."""
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        name = f"{path}.{key.value}" if path else str(key.value)
        line = key.start_mark.line + 1
        if name in lines:
            raise DataError(f"{file}, line {line}: {name} is given twice, first in line {lines[name]}")
        lines[name] = line
        _note_lines(value, name, lines, file)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."


_REQUIRED = object()


class Section:
    """One mapping of a YAML file: takes keys out one by one and names file, line and key in each error."""

    def __init__(self, data: dict[str, Any], lines: dict[str, int], file: str, path: str = "") -> None:
        self._rest, self._lines, self._file, self._path = dict(data), lines, file, path
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._rest

    def given(self, path: str) -> bool:
        """Whether the file holds a key of this full path (``"vehicle.m"``)."""
        return path in self._lines

    def error(self, sentence: str, key: str = "") -> DataError:
        """A `DataError` that says where: file, line, key."""
        full = ".".join(part for part in (self._path, key) if part)
        line = self._lines.get(full, self._lines.get(self._path))
        where = self._file if line is None else f"{self._file}, line {line}"
        return DataError(f"{where}: {sentence}")

    def name(self, key: str) -> str:
        """The key with the sections it stands in."""
        return f"{self._path}.{key}" if self._path else key

    def take(self, key: str, default: Any = _REQUIRED) -> Any:
        """Value of a key; None (nothing behind the colon) counts as a mistake."""
        self._known.append(key)
        if key not in self._rest:
            if default is _REQUIRED:
                near = nearest(key, (str(k) for k in self._rest))
                hint = f" - is it {near!r}?" if near else ""
                raise self.error(f"{self.name(key)} is missing{hint}")
            return default
        value = self._rest.pop(key)
        if value is None:
            raise self.error(f"{self.name(key)} has no value", key)
        return value

    def section(self, key: str) -> Section:
        """A mapping below this one; must be there."""
        value = self.take(key)
        if not isinstance(value, dict):
            raise self.error(f"{self.name(key)} must hold keys with values, got {_shown(value)}", key)
        return Section(value, self._lines, self._file, self.name(key))

    def number(self, key: str, quantity: Quantity, default: Any = _REQUIRED) -> Any:
        """A number in the range of ``quantity``."""
        value = self.take(key, default)
        if value is default:
            return value
        return self._checked(key, value, quantity)

    def numbers(self, key: str, size: int, quantity: Quantity, default: Any = _REQUIRED) -> Any:
        """A list of ``size`` numbers, as a tuple."""
        value = self.take(key, default)
        if value is default:
            return value
        if not isinstance(value, list) or len(value) != size:
            raise self.error(f"{self.name(key)} must be a list of {size} numbers, got {_shown(value)}", key)
        return tuple(self._checked(key, item, quantity) for item in value)

    def _checked(self, key: str, value: Any, quantity: Quantity) -> float:
        try:
            return quantity.check(self.name(key), value)
        except InvalidParameter as error:
            raise self.error(str(error), key) from None

    def choice(self, key: str, allowed: tuple[str, ...], default: Any = _REQUIRED) -> str:
        """One word of several."""
        value = self.take(key, default)
        if value not in allowed:
            near = nearest(value, allowed) if isinstance(value, str) else None
            hint = f" - did you mean {near}?" if near else ""
            names = ", ".join(allowed)
            raise self.error(f"{self.name(key)} must be one of {names}, got {_shown(value)}{hint}", key)
        return value

    def flag(self, key: str) -> bool:
        """True or false."""
        value = self.take(key)
        if not isinstance(value, bool):
            raise self.error(f"{self.name(key)} must be true or false, got {_shown(value)}", key)
        return value

    def rest(self) -> dict[str, Any]:
        """All keys that nobody has taken."""
        rest, self._rest = self._rest, {}
        return rest

    def finish(self) -> None:
        """Refuse keys that nobody has taken: a misspelt key must not be lost."""
        for key in self._rest:
            near = nearest(str(key), self._known)
            hint = f"did you mean {near!r}?" if near else f"known: {', '.join(self._known)}"
            raise self.error(f"{self.name(str(key))!r} is not a key of a log - {hint}", str(key))


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
        config = LogConfig(
            model=top.choice("model", MODELS),
            drivetrain=top.choice("drivetrain", DRIVETRAINS),
            slip=top.number("slip", _SLIP, 0.0),
            vehicle=_vehicle(top.section("vehicle")),
            soil=_soil(top.section("soil")),
            terrain=_terrain(top.section("terrain")),
            imu=_imu(top.section("imu")),
            gnss=_gnss(top.section("gnss")) if "gnss" in top else _absent(top, "gnss"),
            hold=_hold(top.section("inputs")) if "inputs" in top else _absent(top, "inputs") or "zoh",
            start=_start(top.section("start")),
            unknown=_unknown(top),
            units=units,
        )
    top.finish()
    return config


def _absent(section: Section, key: str) -> None:
    """Make an optional key known, so that a misspelling of it is recognised."""
    section.take(key, None)


def _units(top: Section) -> tuple[tuple[str, str], ...]:
    if "units" not in top:
        _absent(top, "units")
        return ()
    section = top.section("units")
    pairs = section.rest()
    for column, unit in pairs.items():
        if not isinstance(column, str) or not isinstance(unit, str):
            raise section.error(f"units.{column} must be the name of a unit, got {_shown(unit)}", str(column))
    return tuple(pairs.items())


def _unknown(top: Section) -> tuple[str, ...]:
    given = top.take("unknown", [])
    names = given if isinstance(given, list) else [given]
    for name in names:
        if name not in UNKNOWN:
            near = nearest(name, UNKNOWN) if isinstance(name, str) else None
            hint = f" - did you mean {near}?" if near else ""
            allowed = ", ".join(UNKNOWN)
            raise top.error(f"unknown must be a list of {allowed}, got {_shown(name)}{hint}", "unknown")
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
    soil = _soil(top.section("soil"))
    for name in ("drivetrain", "slip", "terrain", "imu", "gnss", "inputs", "start", "unknown"):
        top.take(name, None)  # harmless beside a wheel: the same YAML may serve a vehicle
    return LogConfig(model=model, wheel=wheel, soil=soil, units=units)


def _refused(section: Section, error: InvalidParameter) -> DataError:
    """What a factory refuses, with the place in the file; its message starts with the field's name."""
    sentence, field_name = str(error), str(error).split()[0]
    if field_name in (*Vehicle._fields, *Soil._fields):
        return section.error(section.name(sentence), field_name)
    return section.error(f"{section.name('')[:-1]}: {sentence}")


def _wheel(section: Section) -> Wheel:
    try:
        return make_wheel(r=section.take("r"), b=section.take("b"))
    except InvalidParameter as error:
        raise _refused(section, error) from None


def _vehicle(section: Section) -> Vehicle:
    given = {name: section.number(name, _ANY) for name in _NEEDED_VEHICLE}
    given["wheels_per_axle"] = section.number("wheels_per_axle", _ANY, 2.0)
    for name in Vehicle._fields:
        if name not in given and (value := section.number(name, _ANY, None)) is not None:
            given[name] = value
    section.finish()
    try:
        return make_vehicle(**(_assumed(given) | given))
    except InvalidParameter as error:
        raise _refused(section, error) from None


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
    if kind == "rigid":
        keys, needed = _RIGID_KEYS, _NEEDED_RIGID
    else:
        keys, needed = _SOIL_KEYS, _NEEDED_SOIL
    given = {name: section.number(name, _ANY) for name in needed}
    given |= {name: section.number(name, _ANY, None) for name in keys if name not in needed}
    given = {name: value for name, value in given.items() if value is not None}
    section.finish()
    try:
        return make_soil(kind=kind, **given)
    except InvalidParameter as error:
        raise _refused(section, error) from None


def _terrain(section: Section) -> TerrainSpec:
    kind = section.choice("kind", TERRAINS)
    if kind == "grid":
        raise section.error(
            "terrain.kind grid is not supported yet: the simulator's ground is a plane with waves - "
            "give kind: waves, or kind: unknown with the rms of the height",
            "kind",
        )
    spec = {"kind": kind}
    if kind == "paper":
        spec["H_0"] = section.number("H0", _HEIGHT)
    elif kind == "unknown":
        spec["rms"] = section.number("rms", _RMS)
    elif kind == "waves":
        spec["plane"] = section.numbers("plane", 3, _ANY, (0.0, 0.0, 0.0))
        spec["waves"] = _waves(section)
    section.finish()
    return TerrainSpec(**spec)


def _waves(section: Section) -> tuple[tuple[float, float, float, float], ...]:
    rows = section.take("waves")
    if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 4 for row in rows):
        raise section.error("terrain.waves must be a list of [amplitude, p, q, phase]", "waves")
    try:
        return tuple(tuple(_ANY.check("terrain.waves", value) for value in row) for row in rows)
    except InvalidParameter as error:
        raise section.error(str(error), "waves") from None


def _imu(section: Section) -> ImuSpec:
    kinematic = section.flag("kinematic")
    position = section.numbers("position", 3, _ARM, (0.0, 0.0, 0.0))
    sd = section.section("sd")
    spec = ImuSpec(
        kinematic=kinematic,
        position=position,
        sd_a=sd.number("a", _ACCELERATION_SD),
        sd_rate=sd.number("rate", _RATE_SD),
    )
    sd.finish()
    section.finish()
    return spec


def _gnss(section: Section) -> GnssSpec:
    sd = section.section("sd")
    spec = GnssSpec(
        sd_position=sd.number("position", _POSITION_SD), sd_speed=sd.number("speed", _SPEED_SD, None)
    )
    sd.finish()
    section.finish()
    return spec


def _hold(section: Section) -> str:
    hold = section.choice("hold", HOLDS, "zoh")
    section.finish()
    return hold


def _start(section: Section) -> StartSpec:
    if "settled" in section and not section.flag("settled"):
        raise section.error("start.settled must be true, or left out where start.state is given", "settled")
    values = {
        "x": section.number("x", _PLACE, 0.0),
        "y": section.number("y", _PLACE, 0.0),
        "yaw": section.number("yaw", _YAW, 0.0),
    }
    if "state" not in section:
        speed = section.number("v_x", _SPEED)
        section.take("state", None)
        section.take("settled", None)
        section.finish()
        return StartSpec(**values, v_x=speed)
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
    values |= {name: state[name] for name in ("x", "y", "yaw") if name in state}
    return StartSpec(**values, v_x=state["v_x"], state=tuple(state.items()))


def _as_mapping(config: LogConfig) -> dict[str, Any]:
    soil = config.soil
    keys = _RIGID_KEYS if soil.rigid > 0.5 else _SOIL_KEYS
    ground = {name: getattr(soil, name) for name in keys}
    if soil.rigid > 0.5:
        ground = {"kind": "rigid", **ground}
    if config.vehicle is None:
        return {"model": config.model, "wheel": config.wheel._asdict(), "soil": ground}
    mapping = {
        "model": config.model,
        "drivetrain": config.drivetrain,
        "slip": config.slip,
        "vehicle": config.vehicle._asdict(),
        "soil": ground,
        "terrain": _terrain_mapping(config.terrain),
        "imu": {
            "kinematic": config.imu.kinematic,
            "position": list(config.imu.position),
            "sd": {"a": config.imu.sd_a, "rate": config.imu.sd_rate},
        },
        "inputs": {"hold": config.hold},
        "start": _start_mapping(config.start),
    }
    if config.gnss is not None:
        sd = {"position": config.gnss.sd_position, "speed": config.gnss.sd_speed}
        mapping["gnss"] = {"sd": {name: value for name, value in sd.items() if value is not None}}
    if config.unknown:
        mapping["unknown"] = list(config.unknown)
    return mapping


def _terrain_mapping(terrain: TerrainSpec) -> dict[str, Any]:
    more: dict[str, dict[str, Any]] = {
        "paper": {"H0": terrain.H_0},
        "unknown": {"rms": terrain.rms},
        "waves": {"plane": list(terrain.plane), "waves": [list(row) for row in terrain.waves]},
    }
    return {"kind": terrain.kind, **more.get(terrain.kind, {})}


def _start_mapping(start: StartSpec) -> dict[str, Any]:
    pose = {"x": start.x, "y": start.y, "yaw": start.yaw}
    if start.state:
        return {**pose, "state": dict(start.state)}
    return {"settled": True, **pose, "v_x": start.v_x}
