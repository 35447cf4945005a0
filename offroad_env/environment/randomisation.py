"""Domain randomisation: fields of soil, vehicle, sensors and terrain that differ from episode to episode.

What is drawn is the truth. Estimators, briefing and navigation keep the nominal soil, vehicle and sensors, as
with the option ``mismatch`` of a reset. Every key has a stream of random numbers of its own, from the seed of
the episode and the key: neither the order of the keys nor other keys change what is drawn, and course, noise
and n of a seed are those without randomisation.
"""

from __future__ import annotations

import copy
import json
import math
import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np

from offroad_env.environment.soil_draws import MeasuredSoils
from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Ground, Soil, Vehicle
from offroad_env.simulation.sensor_configs import GNSS_RANGES, IMU_RANGES, WHEEL_RANGES
from offroad_env.simulation.sensor_descriptions import read_sensors, sensors_mapping
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.world.argument_checks import numbers
from offroad_env.world.catalogue import Quantity
from offroad_env.world.descriptions import read_soil, read_vehicle, soil_mapping, vehicle_mapping
from offroad_env.world.documents import is_name, open_document
from offroad_env.world.soil_fields import SOIL_RANGES
from offroad_env.world.soils import make_soil
from offroad_env.world.terrain import add, grade
from offroad_env.world.vehicles import VEHICLE_RANGES, make_vehicle
from offroad_env.world.yaml_text import shown

__all__ = [
    "RANDOM_KEYS",
    "Choice",
    "Distribution",
    "LogUniform",
    "Normal",
    "Randomisation",
    "Truth",
    "Uniform",
    "apply_context",
    "checked_context",
    "plain_value",
    "random_meaning",
    "read_randomisation",
]


@runtime_checkable
class Distribution(Protocol):
    """From which a key is drawn."""

    def draw(self, rng: np.random.Generator) -> Any:
        """A value."""

    @property
    def ends(self) -> tuple[Any, ...]:
        """Values that must be possible."""

    @property
    def plain(self) -> Any:
        """As it stands in YAML and JSON."""


def _ordered(low: float, high: float) -> None:
    for value in (low, high):
        if numbers("a range", value).ndim:
            raise InvalidParameter(f"a range must be two numbers, got {shown(value)}")
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise InvalidParameter(f"a range must be (low, high) with low <= high, got ({low!r}, {high!r})")


@dataclass(frozen=True)
class Uniform:
    """Uniform from ``low`` to ``high``; a pair (low, high) means the same."""

    low: float  #: least value
    high: float  #: largest value

    def __post_init__(self) -> None:
        _ordered(self.low, self.high)

    def draw(self, rng: np.random.Generator) -> float:
        """A value."""
        return float(rng.uniform(self.low, self.high))

    @property
    def ends(self) -> tuple[float, ...]:
        """Both ends."""
        return self.low, self.high

    @property
    def plain(self) -> Any:
        """``[low, high]``."""
        return [self.low, self.high]


@dataclass(frozen=True)
class LogUniform:
    """Uniform in the logarithm, from ``low`` > 0 to ``high``."""

    low: float  #: least value
    high: float  #: largest value

    def __post_init__(self) -> None:
        _ordered(self.low, self.high)
        if self.low <= 0.0:
            raise InvalidParameter(f"LogUniform needs low > 0, got {shown(self.low)}")

    def draw(self, rng: np.random.Generator) -> float:
        """A value."""
        return float(math.exp(rng.uniform(math.log(self.low), math.log(self.high))))

    @property
    def ends(self) -> tuple[float, ...]:
        """Both ends."""
        return self.low, self.high

    @property
    def plain(self) -> Any:
        """``{log_uniform: [low, high]}``."""
        return {"log_uniform": [self.low, self.high]}


@dataclass(frozen=True)
class Normal:
    """Normal, with what falls outside ``low`` to ``high`` drawn again; by default 3 sd to both sides."""

    mean: float  #: middle of the values
    sd: float  #: their standard deviation
    low: float | None = None  #: least value
    high: float | None = None  #: largest value

    def __post_init__(self) -> None:
        if numbers("mean", self.mean).ndim or not (numbers("sd", self.sd) >= 0.0).all():
            raise InvalidParameter(f"Normal needs sd >= 0, got {shown(self.sd)}")
        _ordered(*self.ends)
        low, high = self.ends
        if max(low - self.mean, self.mean - high) > 3.0 * self.sd:
            raise InvalidParameter(f"Normal: {low:g} ... {high:g} lies more than 3 sd from {self.mean:g}")

    def draw(self, rng: np.random.Generator) -> float:
        """A value."""
        low, high = self.ends
        while True:
            value = float(rng.normal(self.mean, self.sd))
            if low <= value <= high:
                return value

    @property
    def ends(self) -> tuple[float, float]:
        """Both limits."""
        return (
            self.mean - 3.0 * self.sd if self.low is None else self.low,
            self.mean + 3.0 * self.sd if self.high is None else self.high,
        )

    @property
    def plain(self) -> Any:
        """``{normal: [mean, sd, low, high]}``."""
        return {"normal": [self.mean, self.sd, *self.ends]}


@dataclass(frozen=True)
class Choice:
    """One of several values with equal probability; a list of names means the same."""

    values: tuple[Any, ...]  #: equally probable

    def __post_init__(self) -> None:
        if not isinstance(self.values, list | tuple) or not self.values:
            raise InvalidParameter(f"Choice needs a list of at least one value, got {shown(self.values)}")
        object.__setattr__(self, "values", tuple(self.values))

    def draw(self, rng: np.random.Generator) -> Any:
        """A value."""
        return self.values[int(rng.integers(len(self.values)))]

    @property
    def ends(self) -> tuple[Any, ...]:
        """All values."""
        return self.values

    @property
    def plain(self) -> Any:
        """``{choice: [...]}``."""
        return {"choice": [plain_value(value) for value in self.values]}


_KINDS: Mapping[str, Any] = MappingProxyType(
    {
        "uniform": lambda values: Uniform(*values),
        "log_uniform": lambda values: LogUniform(*values),
        "normal": lambda values: Normal(*values),
        "choice": lambda values: Choice(tuple(values)),
        "measured_soils": lambda values: MeasuredSoils(**values),
    }
)
_SLOPE = Quantity("in [-0.5, 0.5] rad", -0.5, 0.5, mistakes=((0.5000001, 30.0, "degrees"),))
#: Besides fields of the records: key -> (range, meaning with unit).
_EXTRA: Mapping[str, tuple[Quantity, str]] = MappingProxyType(
    {
        "imu.bias": (
            Quantity("in [-20, 20] m/s^2", -20.0, 20.0),
            "constant error of accelerations [m/s^2]",
        ),
        "imu.gyro_bias": (Quantity("in [-2, 2] rad/s", -2.0, 2.0), "constant error of both rates [rad/s]"),
        "terrain.slope": (_SLOPE, "added to the ground, uphill along the path's first direction [rad]"),
        "terrain.cross_slope": (_SLOPE, "added to the ground, uphill to the left of it [rad]"),
        "terrain.height_scale": (Quantity("in [0, 5]", 0.0, 5.0), "factor on the height of all waves [-]"),
    }
)
_PARTS = {"soil": SOIL_RANGES, "vehicle": VEHICLE_RANGES}
_SENSORS = {"imu": IMU_RANGES, "wheel": WHEEL_RANGES, "gnss": GNSS_RANGES}
#: Things that are drawn as a whole.
_WHOLE = ("soil", "vehicle", "sensors")
#: The clock of the control period, and what it is in the environment [Hz].
_FIXED, _CLOCK = ("imu.rate",), 100.0
#: Soil holds together by as much, or not at all [Pa]: `SOIL_RANGES`.
_LEAST_COHESION = 100.0


def _numbers() -> dict[str, Quantity]:
    found = {
        f"{part}.{name}": quantity
        for part, ranges in {**_PARTS, **_SENSORS}.items()
        for name, quantity in ranges.items()
    }
    found |= {key: quantity for key, (quantity, _) in _EXTRA.items()}
    return {key: quantity for key, quantity in found.items() if key not in _FIXED}


#: Keys of ``randomise`` and ``context`` with numbers -> allowed range. "n" means "soil.n".
RANDOM_KEYS: Mapping[str, Quantity] = MappingProxyType({"n": SOIL_RANGES["n"], **_numbers()})


def random_meaning(key: str) -> list[tuple[str, str]]:
    """[(unit, meaning)] of a key that is no field of a record; empty for the others."""
    if key not in _EXTRA:
        return []
    words, _, unit = _EXTRA[key][1].partition(" [")
    return [(unit.rstrip("]"), words)]


def read_randomisation(given: Any) -> Randomisation:
    """What is randomised, from a mapping, inline YAML or a file; itself where it is read already.

    Raises
    ------
    InvalidParameter, DataError
        With what is wrong, and where.
    """
    if isinstance(given, Randomisation):
        return given
    if isinstance(given, os.PathLike) or (isinstance(given, str) and not is_name(given)):
        given = open_document(given, "randomise").content
    return Randomisation(given)


def _legal(key: str, value: Any) -> Any:
    """The nearest value of a key that is allowed where a continuous range holds others."""
    if key == "soil.c":
        return 0.0 if value < _LEAST_COHESION else value
    if key == "vehicle.wheels_per_axle":
        return float(round(value))
    part, _, name = key.partition(".")
    if part in _SENSORS and name == "latency":
        return round(value * _CLOCK) / _CLOCK
    if part in _SENSORS and name == "rate":
        return _CLOCK / max(round(_CLOCK / value), 1)
    return value


def _known(key: object) -> str:
    """The key, or a refusal with the nearest one."""
    from difflib import get_close_matches

    if isinstance(key, str) and (key in RANDOM_KEYS or key in _WHOLE):
        return key
    near = get_close_matches(str(key), [*RANDOM_KEYS, *_WHOLE], n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"whole: {', '.join(_WHOLE)}"
    raise InvalidParameter(f"there is no {key!r} to randomise - {hint}")


def _read(key: str, given: Any) -> Distribution:
    if isinstance(given, Distribution):
        return given
    if isinstance(given, Mapping) and len(given) == 1:
        ((kind, values),) = given.items()
        if kind in _KINDS:
            try:
                return cast("Distribution", _KINDS[kind](values))
            except TypeError as error:
                raise InvalidParameter(f"{key}: {kind} cannot be made from {shown(values)}") from error
    if isinstance(given, list | tuple) and not hasattr(given, "_fields"):
        numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in given)
        if numbers and len(given) == 2:
            low, high = given
            return Uniform(float(low), float(high))
        return Choice(tuple(given))
    return Choice((given,))


class Truth(NamedTuple):
    """What a context decides in an episode."""

    vehicle: Vehicle
    soil: Soil
    ground: Ground
    sensors: SensorSuite


def checked_context(context: Any) -> dict[str, Any]:
    """A context with known keys, numbers in range, names and descriptions as they are.

    Raises
    ------
    InvalidParameter
        For a key that cannot be set, or a value out of range.
    """
    if not isinstance(context, Mapping):
        raise InvalidParameter(f"context must map keys to values, got {shown(context)}")
    found = {}
    for name, value in context.items():
        key = _known(name)
        found[key] = RANDOM_KEYS[key].check(key, value) if key in RANDOM_KEYS else _noted(value)
    if "n" in found and "soil.n" in found:
        raise InvalidParameter('"n" and "soil.n" are the same: give one of them')
    return found


@dataclass(frozen=True)
class Randomisation:
    """Keys and the distributions from which they are drawn.

    Parameters
    ----------
    given
        Key -> `Uniform`, `Normal`, `LogUniform`, `Choice`; a pair of numbers is uniform, another list a
        choice, anything else constant. As in YAML: ``{normal: [mean, sd]}``, ``{choice: [...]}``.

    Raises
    ------
    InvalidParameter
        For a key that there is not, or a distribution that reaches beyond the key's range.
    """

    given: Mapping[str, Any]
    table: dict[str, Distribution] = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.given, Mapping):
            raise InvalidParameter(f"randomise must map keys to distributions, got {shown(self.given)}")
        object.__setattr__(
            self, "table", {_known(key): _read(key, value) for key, value in self.given.items()}
        )
        for key, distribution in self.table.items():
            for end in distribution.ends:
                checked_context({key: end})
        checked_context({key: distribution.ends[0] for key, distribution in self.table.items()})

    def ends(self, key: str) -> tuple[Any, ...]:
        """Values of a key that must be possible, as `draw` would give them."""
        distribution = self.table[key]
        if isinstance(distribution, Choice):
            return distribution.ends  # stated one by one: not to be changed in silence
        return tuple(_legal(key, end) for end in distribution.ends)

    @property
    def n_range(self) -> tuple[float, float] | None:
        """Range of n, where it is drawn."""
        found = self.table.get("n", self.table.get("soil.n"))
        return None if found is None else (min(found.ends), max(found.ends))

    def draw(self, generator: np.random.Generator) -> dict[str, Any]:
        """A context; takes no number from the generator."""
        base = int(copy.deepcopy(generator).integers(2**63))
        context = {}
        for key in sorted(self.table):
            rng = np.random.default_rng([base, zlib.crc32(key.encode())])
            context[key] = _legal(key, _noted(self.table[key].draw(rng)))
        return {key: context[key] for key in self.table}

    @property
    def plain(self) -> dict[str, Any]:
        """As it stands in YAML and JSON."""
        return {key: distribution.plain for key, distribution in self.table.items()}


def plain_value(value: Any) -> Any:
    """A value of a context without objects: names, numbers, mappings."""
    if isinstance(value, Soil):
        return soil_mapping(value)
    if isinstance(value, Vehicle):
        return vehicle_mapping(value)
    return sensors_mapping(value) if isinstance(value, SensorSuite) else value


def _noted(value: Any) -> Any:
    """A value as a context names it: a number, a name, or inline YAML, which can be set again."""
    plain = plain_value(value)
    return json.dumps(dict(plain)) if isinstance(plain, Mapping) else plain


def apply_context(context: Mapping[str, Any], nominal: Truth) -> Truth:
    """The truth of an episode: the nominal one, changed by a checked context.

    Raises
    ------
    InvalidParameter
        Where the values do not belong to one vehicle or soil together.
    """
    parts: dict[str, dict[str, float]] = {}
    for key, value in context.items():
        if key not in _WHOLE:
            part, _, name = ("soil", "", "n") if key == "n" else key.partition(".")
            parts.setdefault(part, {})[name] = value
    soil, vehicle, ground, sensors = nominal.soil, nominal.vehicle, nominal.ground, nominal.sensors
    if "soil" in context:
        soil = read_soil(context["soil"]).record
    if "vehicle" in context:
        vehicle = read_vehicle(context["vehicle"]).record
    if "soil" in parts:
        soil = make_soil(soil, **cast("Any", parts["soil"]))
    if "vehicle" in parts:
        vehicle = make_vehicle(vehicle, **cast("Any", parts["vehicle"]))
    if "terrain" in parts:
        ground = _changed_ground(ground, parts["terrain"])
    if "sensors" in context:
        sensors = read_sensors(context["sensors"]).anew(body_axes=sensors.imu.body_axes)
    return Truth(vehicle, soil, ground, _changed_sensors(sensors, parts))


def _changed_ground(ground: Ground, changes: Mapping[str, float]) -> Ground:
    scale = changes.get("height_scale", 1.0)
    waves = ground.waves * np.array([scale, 1.0, 1.0, 1.0])
    return add(
        ground._replace(waves=waves),
        grade(changes.get("slope", 0.0)),
        grade(changes.get("cross_slope", 0.0), 0.5 * math.pi),
    )


def _changed_sensors(sensors: SensorSuite, parts: Mapping[str, Mapping[str, float]]) -> SensorSuite:
    """Sensors with other numbers; the same ones where nothing changes."""
    if not any(name in parts for name in _SENSORS):
        return sensors
    configs: dict[str, Any] = {}
    bias = [0.0, 0.0]
    for name in _SENSORS:
        config, changes = getattr(sensors, name), dict(parts.get(name, {}))
        if name == "imu":
            bias = [changes.pop("bias", 0.0), changes.pop("gyro_bias", 0.0)]
        if config is None and changes:
            raise InvalidParameter(f"{name}.{next(iter(changes))}: these sensors have no {name}")
        configs[name] = replace(config, **changes) if changes else config
    accel, gyro = bias
    return SensorSuite(**configs, accel_bias=accel, gyro_bias=gyro)
