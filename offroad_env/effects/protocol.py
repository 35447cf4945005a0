"""What an effect is, and what it may change: inputs, sensors, parameters, or the compiled model at a hook."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics.imu import ImuMount
from offroad_env.physics.records import (
    AxleContact,
    AxleForces,
    AxlePlace,
    AxleSpring,
    BodyForces,
    FloatArray,
    Ground,
    Soil,
    SpringState,
    Vehicle,
    WheelMotion,
)
from offroad_env.simulation.simulator import Plant, plant_model

__all__ = ["Change", "Effect", "Inputs", "Parameter", "SensorErrors", "Setup", "Values", "rotated"]

#: Parameter name -> value.
Values = Mapping[str, float]

FAMILIES = ("timing", "sensor", "steering", "mass", "longitudinal", "soil", "suspension", "lateral", "wheel")
HOOKS = ("actuator", "sensor", "parameter", "soil state", "wheel force", "suspension", "body force")


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Delays, scales and offsets of a command on its way to the vehicle; the defaults change nothing."""

    delay: float = 0.0  #: of all inputs against the sensors' clock [s]
    steer_delay: float = 0.0  #: of the steering alone [s]
    steer_lag: float = 0.0  #: time constant of a first-order lag of the steering [s]
    steer_gain: float = 1.0  #: [-]
    steer_offset: float = 0.0  #: [rad]
    drive_scale: float = 1.0  #: of drive torque, and of a body force ahead [-]
    brake_scale: float = 1.0  #: of brake torque, and of a body force backwards [-]

    def acting(self, pushed: np.ndarray) -> np.ndarray:
        """What acts of torques or forces, positive where they drive and negative where they brake."""
        return np.asarray(np.where(pushed > 0.0, self.drive_scale, self.brake_scale) * pushed)


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """What a sensor adds to the quantity that it measures; the defaults change nothing."""

    offset: tuple[float, ...] = (0.0,) * 5  #: of a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
    accel_scale: float = 1.0  #: of the three accelerometers [-]
    lean: float = 0.0  #: share by which a_y reads too much, since the body leans out of the turn [-]
    wheel_scale: float = 1.0  #: of the wheel speeds [-]
    wheel_split: float = 0.0  #: added to the scale of the front wheel speeds, taken from the rear ones' [-]
    wheel_delay: float = 0.0  #: age of the wheel speeds [s]
    pose_delay: float = 0.0  #: age of position, heading, speed over ground and course [s]
    antenna: float = 0.0  #: where position, speed and course are measured, ahead of the centre [m]

    def shifted(self, channel: int, by: float) -> SensorErrors:
        """The same with another offset of one IMU channel."""
        offset = list(self.offset)
        offset[channel] += by
        return replace(self, offset=tuple(offset))


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A vehicle with its inputs and sensors: what effects change, and what a simulation runs."""

    plant: Plant
    mount: ImuMount
    inputs: Inputs = field(default_factory=Inputs)
    errors: SensorErrors = field(default_factory=SensorErrors)

    @property
    def model(self) -> str:
        """The preset: "full" or "paper"."""
        return plant_model(self.plant)

    def stated_numbers(self) -> np.ndarray:
        """(F,) all numbers in the records of vehicle and soil, in SI units."""
        return np.array([*self.plant.vehicle, *self.plant.soil], dtype=float)

    def with_vehicle(self, **changes: float) -> Setup:
        """The same with other values in the vehicle's record."""
        return replace(self, plant=self.plant._replace(vehicle=self.plant.vehicle._replace(**changes)))

    def with_ground(self, ground: Ground) -> Setup:
        """The same on other ground."""
        return replace(self, plant=self.plant._replace(ground=ground))

    def with_soil(self, **changes: float) -> Setup:
        """The same with other values in the soil's record."""
        return replace(self, plant=self.plant._replace(soil=self.plant.soil._replace(**changes)))


def rotated(mount: ImuMount, roll: float, pitch: float) -> ImuMount:
    """The IMU turned in the body by small angles [rad]: roll to the right, pitch nose up."""
    turn = np.array([[1.0, 0.0, -pitch], [0.0, 1.0, -roll], [pitch, roll, 1.0]])
    columns, _ = np.linalg.qr(mount.rotation @ turn)
    columns = columns * np.sign(np.sum(columns * mount.rotation, axis=0))
    return mount._replace(rotation=np.ascontiguousarray(columns))


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect: its size, or a place or direction."""

    name: str
    unit: str
    off: float = 0.0  #: the value that means "not there"; meaningless for a place or direction
    low: float  #: smallest value at which the model can be computed
    high: float  #: largest

    def check(self, value: float, effect: str) -> None:
        """Refuse a value outside of the range.

        Raises
        ------
        InvalidParameter
        """
        if not self.low <= value <= self.high:
            allowed = f"[{self.low:g}, {self.high:g}] {self.unit}"
            raise InvalidParameter(f"{effect}: {self.name} must be in {allowed}, got {value:g}")


#: Acts on a setup, with the size of the effect and its other parameters: its inputs, sensors or parameters.
Change = Callable[..., Setup]

#: Laws at the hooks of `offroad_env.physics.hooks`: the quantity that the hook passes on, the row of the
#: effect's parameters with the size first, and the further arguments of the hook.
SoilLaw = Callable[[Soil, FloatArray, WheelMotion, AxlePlace], Soil]
WheelLaw = Callable[[AxleForces, FloatArray, WheelMotion, AxleContact], AxleForces]
LoadLaw = Callable[[float, FloatArray, SpringState, AxleSpring], float]
BodyLaw = Callable[[BodyForces, FloatArray, FloatArray, Vehicle], BodyForces]


#: Words of a sentence that a negative size turns into their opposites; the first that occurs is replaced.
_OPPOSITES = (
    ("too much", "too little"), ("heavier", "lighter"), ("larger", "smaller"), ("stiffer", "softer"),
    ("further ahead of", "further behind"), ("further ahead", "further behind"),
    ("further above", "further below"), ("further back", "further forward"),
    ("further left", "further right"), ("older than", "newer than"), ("later than", "earlier than"),
    ("nose up", "nose down"), ("to the right", "to the left"), ("to the left", "to the right"),
    ("climbs", "falls"), ("grows by", "falls by"), ("more", "less"), ("further", "less far"),
    ("pushes forward", "pushes back"), ("higher", "lower"), ("lag {size} behind", "run {size} ahead of"),
    ("add {size} times", "lack {size} times"), ("turns the", "holds back the"),
)  # fmt: skip
#: Numbers without a unit that are no shares of anything.
_PLAIN_NUMBERS = ("n_step", "n_trend", "slip_exponent", "slip_sinkage", "soil_loosening")


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One way in which the model may be wrong; one id names one law.

    Either ``change`` acts on the setup (inputs, sensors, parameters of the records), or ``law`` is a
    compiled function at one of the model's hooks: soil state, wheel force, suspension or body force.

    Raises
    ------
    InvalidParameter
        If the fields contradict each other, or the source is missing.
    """

    id: str
    former_ids: tuple[str, ...] = ()  #: earlier ids, the first one first; files of older versions have them
    family: str  #: one of `FAMILIES`
    hook: str  #: one of `HOOKS`
    size: Parameter  #: how large it is; at ``size.off`` the effect is not composed at all
    others: tuple[Parameter, ...] = ()  #: where or in which direction: not sizes, at most two
    plausible: Callable[[Vehicle], float]  #: largest believable departure from ``off``, in the size's unit
    sentence: str  #: what it is, with {size} for the number and its unit
    #: Where the law comes from: the literature, "definition: ..." for a shift of a stated number, or
    #: "assumption of this project: ..." for a form of our own.
    source: str
    needs: tuple[tuple[str, ...], ...] = ()  #: for each entry the log must hold one of its channels
    look_alikes: tuple[str, ...] = ()  #: effects that a log can hardly tell from this one
    separated_by: str = ""  #: the experiment that can
    models: tuple[str, ...] = ("full", "paper")  #: where it means something; "rig": on a wheel rig
    soil_only: bool = False  #: means nothing on hard ground
    hard_only: bool = False  #: means nothing on soil
    tyres_only: bool = False  #: means nothing on rigid rims
    sensors_only: bool = False  #: changes sensors alone: the vehicle's motion stays
    searched: bool = True  #: a cause that a diagnosis may name; else a probe or a nuisance parameter
    change: Change | None = None
    law: SoilLaw | WheelLaw | LoadLaw | BodyLaw | None = None
    places: Callable[[np.ndarray], list[dict[str, float]]] | None = None  #: values of ``others`` for a route

    def __post_init__(self) -> None:
        if self.family not in FAMILIES or self.hook not in HOOKS:
            raise InvalidParameter(f"effect {self.id}: unknown family {self.family!r} or hook {self.hook!r}")
        if (self.change is None) == (self.law is None):
            raise InvalidParameter(f"effect {self.id}: needs either a change or a law")
        if bool(self.others) != (self.places is not None) or len(self.others) > 2:
            raise InvalidParameter(f"effect {self.id}: up to two other parameters, with their places")
        if not all(math.isfinite(end) for p in self.parameters for end in (p.low, p.high)):
            raise InvalidParameter(f"effect {self.id}: every parameter needs a finite range")
        if not self.source.strip():
            raise InvalidParameter(
                f"effect {self.id}: needs a source: the literature, a definition or an assumption"
            )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The size, then the others."""
        return (self.size, *self.others)

    def describe(self, size: float) -> str:
        """The sentence with its number: a share in per cent, and less of something for a negative size."""
        sentence, sign = self.wording(size)
        return sentence.format(size=self.amount(sign * size))

    def wording(self, size: float) -> tuple[str, float]:
        """The sentence for a size of this sign, and the sign by which its number is printed."""
        if size >= 0.0:
            return self.sentence, 1.0
        for more, less in _OPPOSITES:
            if f" {more}" in self.sentence:
                return self.sentence.replace(f" {more}", f" {less}"), -1.0
        return self.sentence, 1.0

    def amount(self, size: float) -> str:
        """A size with its unit."""
        if self.size.unit == "-" and self.id not in _PLAIN_NUMBERS:
            return f"{100.0 * size:.3g} %"
        return f"{size:.3g} {self.size.unit}".removesuffix(" -")
