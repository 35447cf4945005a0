"""Simulated sensors: IMU, wheel speeds, GNSS. Filters and policies see nothing else of the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics.imu import (
    CHANNELS,
    GNSS,
    IMU,
    NOISE_SD,
    OFFSET,
    SCALE,
    WHEEL,
    ImuMount,
    sense,
)
from offroad_env.physics.numerics import GRAVITY
from offroad_env.world.catalogue import Quantity

__all__ = ["GnssConfig", "ImuConfig", "SensorSample", "SensorSuite", "WheelSpeedConfig"]

_RATE = Quantity("in [1, 1000] Hz", 1.0, 1000.0, mistakes=((1e-6, 0.9999, "a period in s"),))
_ACCELERATION_SD = Quantity("in [0, 20] m/s^2", 0.0, 20.0)
_ANGULAR_RATE_SD = Quantity("in [0, 2] rad/s", 0.0, 2.0, mistakes=((2.0000001, 120.0, "degrees/s"),))
_ANGLE_SD = Quantity("in [0, 0.3] rad", 0.0, 0.3, mistakes=((0.3000001, 20.0, "degrees"),))
_ARM = Quantity("in [-10, 10] m", -10.0, 10.0, mistakes=((10.0000001, 1e4, "cm or mm given as m"),))
_SPEED_SD = Quantity("in [0, 5] m/s", 0.0, 5.0)
_SCALE_SD = Quantity("in [0, 0.2]", 0.0, 0.2, mistakes=((0.2000001, 20.0, "per cent"),))
_POSITION_SD = Quantity("in [0, 50] m", 0.0, 50.0)

KINDS = ("kinematic", "specific_force")
#: Standard normal numbers of one episode's constant errors.
_BIASES, _MISALIGNMENT, _SCALES, _OFFSETS = slice(0, 5), slice(5, 8), slice(8, 10), slice(10, 12)
_CONSTANT_DRAWS = 12


def _check_fields(config: ImuConfig | WheelSpeedConfig | GnssConfig, ranges: dict[str, Quantity]) -> None:
    """Check every numeric field of a frozen config and store it as float (or tuple of floats)."""
    for item in fields(config):
        if item.name not in ranges:
            continue
        value, quantity = getattr(config, item.name), ranges[item.name]
        if isinstance(item.default, tuple):
            if np.shape(value) != np.shape(item.default):
                raise InvalidParameter(f"{item.name} must have {len(item.default)} numbers, got {value!r}")
            numbers = tuple(quantity.check(f"{item.name}[{i}]", v) for i, v in enumerate(value))
            object.__setattr__(config, item.name, numbers)
        else:
            object.__setattr__(config, item.name, quantity.check(item.name, value))


@dataclass(frozen=True, kw_only=True)
class ImuConfig:
    """Inertial measurement unit: three accelerometers, the gyros for pitch and yaw.

    The defaults are the paper's: noise only. Channels: a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
    (a forward-left-up gyro would call the first of the two -omega_y).

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """

    rate: float = 100.0  #: samples per second [Hz]; the other sensors' rates must divide it
    accel_noise: float = 0.2  #: standard deviation of a sample [m/s^2]
    gyro_noise: float = 0.0175  #: standard deviation of a sample [rad/s]
    accel_bias_sd: float = 0.0  #: spread of the constant bias, drawn once per episode [m/s^2]
    gyro_bias_sd: float = 0.0  #: spread of the constant bias, drawn once per episode [rad/s]
    misalignment_sd: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: spread of roll, pitch, yaw [rad]
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: position from the CG, x, y, z [m]
    kind: str = "kinematic"  #: "kinematic" acceleration, or "specific_force" as a real IMU measures it
    body_axes: bool = True  #: False: held level, axes do not pitch with the body (the paper)

    def __post_init__(self) -> None:
        ranges = {
            "rate": _RATE,
            "accel_noise": _ACCELERATION_SD,
            "gyro_noise": _ANGULAR_RATE_SD,
            "accel_bias_sd": _ACCELERATION_SD,
            "gyro_bias_sd": _ANGULAR_RATE_SD,
            "misalignment_sd": _ANGLE_SD,
            "lever_arm": _ARM,
        }
        _check_fields(self, ranges)
        if self.kind not in KINDS:
            raise InvalidParameter(f"kind must be one of {', '.join(KINDS)}, got {self.kind!r}")

    def mount(self, misalignment: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ImuMount:
        """The record for ``imu_reading``; without misalignment it is what a filter may assume.

        Parameters
        ----------
        misalignment
            Roll, pitch (nose up), yaw of the sensor in the body [rad].
        """
        return ImuMount(
            np.array(self.lever_arm),
            _rotation(*misalignment),
            1.0 if self.body_axes else 0.0,
            GRAVITY if self.kind == "specific_force" else 0.0,
        )


@dataclass(frozen=True, kw_only=True)
class WheelSpeedConfig:
    """Wheel speed sensors, one per axle, in m/s at the nominal radius.

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """

    rate: float = 50.0  #: samples per second [Hz]
    noise: float = 0.05  #: standard deviation of a sample [m/s]
    scale_sd: float = 0.01  #: spread of the scale error (rolling radius), drawn once per episode [-]

    def __post_init__(self) -> None:
        _check_fields(self, {"rate": _RATE, "noise": _SPEED_SD, "scale_sd": _SCALE_SD})


@dataclass(frozen=True, kw_only=True)
class GnssConfig:
    """Satellite receiver above the CG: X, Y [m], speed [m/s], course [rad, -pi ... pi].

    Course is the direction of travel, not the heading, and arbitrary at rest. The defaults are of the order
    of a receiver with carrier-phase corrections (RTK).

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """

    rate: float = 10.0  #: fixes per second [Hz]
    position_sd: float = 0.03  #: standard deviation of a fix, each axis [m]
    offset_sd: float = 0.0  #: spread of the constant offset, drawn once per episode, each axis [m]
    velocity_sd: float = 0.05  #: standard deviation of the velocity, each axis [m/s]

    def __post_init__(self) -> None:
        ranges = {"rate": _RATE, "position_sd": _POSITION_SD, "offset_sd": _POSITION_SD}
        _check_fields(self, {**ranges, "velocity_sd": _SPEED_SD})


class SensorSample(NamedTuple):
    """What the sensors deliver at one instant; new arrays every time."""

    imu: np.ndarray  #: (5,) a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
    wheel: np.ndarray  #: (2,) front and rear wheel speed r omega [m/s]; NaN between samples
    gnss: np.ndarray  #: (4,) X, Y [m], speed [m/s], course [rad]; NaN between fixes
    wheel_valid: bool  #: whether ``wheel`` is a sample
    gnss_valid: bool  #: whether ``gnss`` is a fix

    @property
    def channels(self) -> np.ndarray:
        """(CHANNELS,) all channels in the order of `offroad_env.physics.imu`; a new array."""
        return np.concatenate((self.imu, self.wheel, self.gnss))


def _rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Columns: axes that are yawed left, then pitched nose up, then rolled, in forward-left-up axes."""
    c, s = math.cos(roll), math.sin(roll)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = math.cos(pitch), math.sin(pitch)
    about_y = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # nose up: about -y
    c, s = math.cos(yaw), math.sin(yaw)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.ascontiguousarray(about_z @ about_y @ about_x)


def _divisor(name: str, imu_rate: float, rate: float) -> int:
    """IMU samples from one sample of another sensor to the next."""
    ratio = imu_rate / rate
    if abs(ratio - round(ratio)) > 1e-9 or ratio < 0.5:
        raise InvalidParameter(
            f"{name}.rate must divide imu.rate = {imu_rate:g} Hz, got {rate:g} Hz (ratio {ratio:g})"
        )
    return round(ratio)


def _is_due(tick: int, every: int) -> bool:
    return every > 0 and tick % every == 0


class SensorSuite:
    """All sensors of a vehicle, sampled together at the IMU's rate.

    Parameters
    ----------
    imu
        The inertial measurement unit, whose rate is the clock of the suite.
    wheel, gnss
        The other sensors; None leaves a sensor out (its channels are always NaN).

    Raises
    ------
    InvalidParameter
        If a rate does not divide the IMU's.

    Notes
    -----
    ``reset`` takes one number from the given Generator and seeds the suite's own from it. Constant errors
    come first, then a fixed count of numbers per sample, whatever the configuration: the same seed gives
    the same noise with any set of sensors, and nothing else that draws from the Generator notices.
    """

    def __init__(
        self,
        *,
        imu: ImuConfig | None = None,
        wheel: WheelSpeedConfig | None = None,
        gnss: GnssConfig | None = None,
    ) -> None:
        self.imu = ImuConfig() if imu is None else imu
        self.wheel = wheel
        self.gnss = gnss
        #: IMU samples from one sample of the wheel speeds, and of the GNSS, to the next; 0: none.
        self.wheel_every = _divisor("wheel", self.imu.rate, wheel.rate) if wheel else 0
        self.gnss_every = _divisor("gnss", self.imu.rate, gnss.rate) if gnss else 0
        self._rng: np.random.Generator | None = None

    @property
    def period(self) -> float:
        """Time from sample to sample [s]."""
        return 1.0 / self.imu.rate

    @property
    def mount(self) -> ImuMount:
        """The IMU as it really sits in this episode (truth: for ``info`` and tests, not for a filter)."""
        self._generator()
        return self._mount

    @property
    def errors(self) -> np.ndarray:
        """This episode's offset, scale error and noise sd of every channel, (3, CHANNELS) (truth)."""
        self._generator()
        return self._errors.copy()

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode: draw the constant errors, restart the clock.

        Parameters
        ----------
        rng
            The caller's Generator, from which one number is taken.
        """
        self._rng = np.random.default_rng(int(rng.integers(2**63)))
        z = self._rng.standard_normal(_CONSTANT_DRAWS)
        self._errors = self._draw_errors(z)
        roll, pitch, yaw = (z[_MISALIGNMENT] * self.imu.misalignment_sd).tolist()
        self._mount = self.imu.mount((roll, pitch, yaw))
        self._tick = 0

    def _draw_errors(self, z: np.ndarray) -> np.ndarray:
        errors = np.zeros((3, CHANNELS))
        errors[OFFSET, IMU] = z[_BIASES] * np.repeat([self.imu.accel_bias_sd, self.imu.gyro_bias_sd], (3, 2))
        errors[NOISE_SD, IMU] = np.repeat([self.imu.accel_noise, self.imu.gyro_noise], (3, 2))
        if self.wheel:
            errors[SCALE, WHEEL] = z[_SCALES] * self.wheel.scale_sd
            errors[NOISE_SD, WHEEL] = self.wheel.noise
        if self.gnss:
            position, velocity = self.gnss.position_sd, self.gnss.velocity_sd
            errors[OFFSET, GNSS] = np.append(z[_OFFSETS], (0.0, 0.0)) * self.gnss.offset_sd
            errors[NOISE_SD, GNSS] = (position, position, velocity, velocity)
        return errors

    def draw_noise(self, out: np.ndarray) -> None:
        """Fill ``out`` (samples, CHANNELS) with the standard normal numbers of the next instants.

        For callers that run the kernel ``sense`` themselves, and count the instants by `wheel_every` and
        `gnss_every`.
        """
        self._generator().standard_normal(out=out)

    def sample(self, state: np.ndarray, readings: np.ndarray) -> SensorSample:
        """Measure now; call once per ``period``.

        Parameters
        ----------
        state
            (15,) state of the vehicle, as laid out in ``offroad_env.physics.state``.
        readings
            (32,) readings of the model at that state.

        Raises
        ------
        InvalidParameter
            Before the first ``reset``.
        """
        noise, out = self._generator().standard_normal(CHANNELS), np.empty(CHANNELS)
        wheel_due, gnss_due = _is_due(self._tick, self.wheel_every), _is_due(self._tick, self.gnss_every)
        self._tick += 1
        sense(state, readings, self._mount, self._errors, noise, (wheel_due, gnss_due), out)
        return SensorSample(out[IMU], out[WHEEL], out[GNSS], wheel_due, gnss_due)

    def _generator(self) -> np.random.Generator:
        """The suite's own Generator; refuses what needs a `reset` before."""
        if self._rng is None:
            raise InvalidParameter("the sensors have no noise yet: call reset(rng) first")
        return self._rng
