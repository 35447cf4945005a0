"""What an effect is, and what it may change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics.records import Ground, Vehicle
from offroad_env.physics.sensor_kernels import ImuMount
from offroad_env.simulator import Plant, plant_model

__all__ = ["Effect", "Inputs", "Parameter", "SensorErrors", "Setup", "Values", "rotated"]

#: Parameter name -> value.
Values = Mapping[str, float]

FAMILIES = ("timing", "sensor", "steering", "mass", "longitudinal", "soil", "suspension", "lateral", "wheel")
HOOKS = ("actuator", "sensor", "parameter", "soil state", "wheel force", "suspension", "body force")


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """What becomes of a command on its way to the vehicle; the defaults change nothing."""

    delay: float = 0.0  #: of all inputs against the sensors' clock [s]
    steer_delay: float = 0.0  #: of the steering alone [s]
    steer_lag: float = 0.0  #: time constant of a first-order lag of the steering [s]
    steer_gain: float = 1.0  #: [-]
    steer_offset: float = 0.0  #: [rad]
    drive_scale: float = 1.0  #: of drive torque, brake torque and body force [-]


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """What a sensor adds to what it should read; the defaults change nothing."""

    offset: tuple[float, ...] = (0.0,) * 5  #: of a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
    accel_scale: float = 1.0  #: of the three accelerometers [-]
    lean: float = 0.0  #: share of itself that a_y reads too much, since the body leans out of the turn [-]
    wheel_scale: float = 1.0  #: of the wheel speeds [-]
    wheel_split: float = 0.0  #: what the front wheel speeds have more of it, and the rear ones less [-]
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
    """One number of an effect."""

    name: str
    unit: str
    off: float = 0.0  #: the value that means "not there"; meaningless for a place or direction
    low: float = -np.inf  #: smallest value that the model bears
    high: float = np.inf  #: largest


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One way in which the model may be wrong.

    Either ``change`` acts on the setup (inputs, sensors, parameters of the records), or ``law`` is a
    compiled function at one of the model's hooks: soil state, wheel force, suspension or body force.
    ``law`` takes (what the hook passes on, row of parameters, ...); the row holds the size first.
    """

    id: str
    family: str  #: one of `FAMILIES`
    hook: str  #: one of `HOOKS`
    size: Parameter  #: how large it is; at ``size.off`` the effect is not composed at all
    others: tuple[Parameter, ...] = ()  #: where or in which direction: not sizes, at most two
    plausible: Callable[[Vehicle], float]  #: largest believable departure from ``off``, in the size's unit
    sentence: str  #: what it is, with {size} for the number and its unit
    needs: tuple[tuple[str, ...], ...] = ()  #: for each entry the log must hold one of its channels
    look_alikes: tuple[str, ...] = ()  #: effects that a log can hardly tell from this one
    separated_by: str = ""  #: the experiment that can
    models: tuple[str, ...] = ("full", "paper")  #: where it means something; "rig": on a wheel rig
    soil_only: bool = False  #: means nothing on hard ground
    hard_only: bool = False  #: means nothing on soil
    sensors_only: bool = False  #: changes sensors alone: the vehicle's motion stays
    searched: bool = True  #: a cause that a finder may name; else only a probe
    change: Callable[[Setup, Values], Setup] | None = None
    law: Callable[..., Any] | None = None
    places: Callable[[np.ndarray], list[dict[str, float]]] | None = None  #: values of ``others`` for a route

    def __post_init__(self) -> None:
        if self.family not in FAMILIES or self.hook not in HOOKS:
            raise InvalidParameter(f"effect {self.id}: unknown family {self.family!r} or hook {self.hook!r}")
        if (self.change is None) == (self.law is None):
            raise InvalidParameter(f"effect {self.id}: needs either a change or a law")
        if bool(self.others) != (self.places is not None) or len(self.others) > 2:
            raise InvalidParameter(f"effect {self.id}: up to two other parameters, with their places")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The size, then the others."""
        return (self.size, *self.others)

    def describe(self, size: float) -> str:
        """The sentence with its number."""
        return self.sentence.format(size=f"{size:.3g} {self.size.unit}".removesuffix(" -"))
