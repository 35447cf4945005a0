"""What each simulated sensor is: rates, noise, errors that last, errors that wander, what it loses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics.imu import ImuMount
from offroad_env.physics.numerics import GRAVITY
from offroad_env.world.catalogue import Quantity
from offroad_env.world.yaml_text import shown

__all__ = [
    "ALLAN_PEAK",
    "ALLAN_PEAK_TIME",
    "GNSS_RANGES",
    "IMU_KINDS",
    "IMU_RANGES",
    "IMU_TRIPLES",
    "WHEEL_RANGES",
    "GnssConfig",
    "ImuConfig",
    "WheelSpeedConfig",
    "allan_deviation",
    "noise_sd",
]

_RATE = Quantity("in [1, 1000] Hz", 1.0, 1000.0, mistakes=((1e-6, 0.9999, "a period in s"),))
_ACCELERATION_SD = Quantity("in [0, 20] m/s^2", 0.0, 20.0)
_ANGULAR_RATE_SD = Quantity("in [0, 2] rad/s", 0.0, 2.0, mistakes=((2.0000001, 120.0, "degrees/s"),))
_ANGLE_SD = Quantity("in [0, 0.3] rad", 0.0, 0.3, mistakes=((0.3000001, 20.0, "degrees"),))
_ARM = Quantity("in [-10, 10] m", -10.0, 10.0, mistakes=((10.0000001, 1e4, "cm or mm given as m"),))
_SPEED_SD = Quantity("in [0, 5] m/s", 0.0, 5.0)
_SCALE_SD = Quantity("in [0, 0.2]", 0.0, 0.2, mistakes=((0.2000001, 20.0, "per cent"),))
_POSITION_SD = Quantity("in [0, 50] m", 0.0, 50.0)
_TIME = Quantity("in [0, 1e6] s", 0.0, 1e6)
_LATENCY = Quantity("in [0, 0.6] s", 0.0, 0.6, mistakes=((0.6000001, 1e3, "ms"),))
_DROPOUT = Quantity("in [0, 0.9]", 0.0, 0.9, mistakes=((0.9000001, 90.0, "per cent"),))
_LIMIT = Quantity("in [0, 1e4]", 0.0, 1e4)
_PULSES = Quantity("in [0, 1e6]", 0.0, 1e6)
#: Largest Allan deviation of a first-order Gauss-Markov process in units of its standard deviation, at 1.89
#: correlation times (IEEE Std 952-1997, C.1.1: 0.437 times the driving noise times the root of the time).
ALLAN_PEAK, ALLAN_PEAK_TIME = 0.61736, 1.8926

IMU_KINDS = ("kinematic", "specific_force")
#: What every sensor has: latency and losses.
_DELIVERY = {"latency": _LATENCY, "dropout": _DROPOUT, "outage": _TIME}
#: Allowed range of every number of an IMU, and of those that are three.
IMU_RANGES: Mapping[str, Quantity] = MappingProxyType(
    {
        "rate": _RATE,
        "accel_noise": _ACCELERATION_SD,
        "gyro_noise": _ANGULAR_RATE_SD,
        "accel_bias_sd": _ACCELERATION_SD,
        "gyro_bias_sd": _ANGULAR_RATE_SD,
        "accel_scale_sd": _SCALE_SD,
        "gyro_scale_sd": _SCALE_SD,
        "accel_instability": _ACCELERATION_SD,
        "gyro_instability": _ANGULAR_RATE_SD,
        "bias_time": _TIME,
        "accel_range": _LIMIT,
        "gyro_range": _LIMIT,
        **_DELIVERY,
    }
)
IMU_TRIPLES: Mapping[str, Quantity] = MappingProxyType({"misalignment_sd": _ANGLE_SD, "lever_arm": _ARM})
#: Of the wheel speeds.
WHEEL_RANGES: Mapping[str, Quantity] = MappingProxyType(
    {
        "rate": _RATE,
        "noise": _SPEED_SD,
        "scale_sd": _SCALE_SD,
        "pulses_per_turn": _PULSES,
        "window": _LATENCY,
        **_DELIVERY,
    }
)
#: Of a satellite receiver.
GNSS_RANGES: Mapping[str, Quantity] = MappingProxyType(
    {
        "rate": _RATE,
        "position_sd": _POSITION_SD,
        "offset_sd": _POSITION_SD,
        "velocity_sd": _SPEED_SD,
        "drift_sd": _POSITION_SD,
        "drift_time": _TIME,
        **_DELIVERY,
    }
)


def _check_fields(config: ImuConfig | WheelSpeedConfig | GnssConfig, ranges: Mapping[str, Quantity]) -> None:
    """Check every numeric field of a frozen config and store it as float (or tuple of floats)."""
    for item in fields(config):
        if item.name not in ranges:
            continue
        value, quantity = getattr(config, item.name), ranges[item.name]
        if isinstance(item.default, tuple):
            if np.shape(value) != np.shape(item.default):
                raise InvalidParameter(
                    f"{item.name} must have {len(item.default)} numbers, got {shown(value)}"
                )
            numbers = tuple(quantity.check(f"{item.name}[{i}]", v) for i, v in enumerate(value))
            object.__setattr__(config, item.name, numbers)
        else:
            object.__setattr__(config, item.name, quantity.check(item.name, value))


def noise_sd(density: float, rate: float) -> float:
    """Standard deviation of a sample from the noise density of a data sheet.

    Parameters
    ----------
    density
        One-sided, of the unit per root Hz.
    rate
        Samples per second [Hz]; the bandwidth is half of it.
    """
    return density * math.sqrt(0.5 * rate)


def allan_deviation(values: np.ndarray, length: int) -> float:
    """Overlapping Allan deviation of a series, for clusters of ``length`` samples (IEEE Std 952-1997, C.1).

    Parameters
    ----------
    values
        (T,) a rate or an acceleration; T must be at least twice ``length``.
    """
    sums = np.concatenate(([0.0], np.cumsum(values)))
    means = (sums[length:] - sums[:-length]) / length
    return float(np.sqrt(0.5 * np.mean((means[length:] - means[:-length]) ** 2)))


@dataclass(frozen=True, kw_only=True)
class ImuConfig:
    """Inertial measurement unit: three accelerometers, the gyros for pitch and yaw.

    The defaults are the paper's: noise only. The bias is a constant plus a first-order Gauss-Markov process.
    Channels: a_x, a_y, a_z [m/s^2], pitch_rate, yaw_rate [rad/s]
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
    accel_scale_sd: float = 0.0  #: spread of the scale error, drawn once per episode [-]
    gyro_scale_sd: float = 0.0  #: spread of the scale error, drawn once per episode [-]
    accel_instability: float = 0.0  #: largest Allan deviation of the drifting part of the bias [m/s^2]
    gyro_instability: float = 0.0  #: largest Allan deviation of the drifting part of the bias [rad/s]
    bias_time: float = 100.0  #: correlation time of the drift [s]; far above a drive's: a random walk
    accel_range: float = 0.0  #: at which a channel saturates [m/s^2]; 0: nowhere
    gyro_range: float = 0.0  #: at which a channel saturates [rad/s]; 0: nowhere
    latency: float = 0.0  #: age of a sample on delivery [s]; a multiple of the sampling period
    dropout: float = 0.0  #: share of samples that are lost, where the last one is repeated [-]
    outage: float = 0.0  #: mean duration of a loss [s]; at most a sample's: single samples
    kind: str = "kinematic"  #: "kinematic" acceleration, or "specific_force" as a real IMU measures it
    body_axes: bool = True  #: False: held level, axes do not pitch with the body (the paper)

    def __post_init__(self) -> None:
        _check_fields(self, {**IMU_RANGES, **IMU_TRIPLES})
        if self.kind not in IMU_KINDS:
            raise InvalidParameter(f"kind must be one of {', '.join(IMU_KINDS)}, got {shown(self.kind)}")

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

    With ``pulses_per_turn`` the speed is a count of pulses over ``window``, in steps of
    2 pi r / (``pulses_per_turn`` ``window``). A lost sample is NaN.

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """

    rate: float = 50.0  #: samples per second [Hz]
    noise: float = 0.05  #: standard deviation of a sample [m/s]
    scale_sd: float = 0.01  #: spread of the scale error (rolling radius), drawn once per episode [-]
    pulses_per_turn: float = 0.0  #: counts of the encoder per turn of the wheel; 0: no encoder, any speed
    window: float = 0.0  #: time over which pulses are counted [s]; 0: from sample to sample
    latency: float = 0.0  #: age of a sample on delivery [s]; a multiple of the IMU's sampling period
    dropout: float = 0.0  #: share of samples that are lost [-]
    outage: float = 0.0  #: mean duration of a loss [s]; at most a sample's: single samples

    def __post_init__(self) -> None:
        _check_fields(self, WHEEL_RANGES)


@dataclass(frozen=True, kw_only=True)
class GnssConfig:
    """Satellite receiver above the CG: X, Y [m], speed [m/s], course [rad] from -pi to pi.

    Course is the direction of travel, not the heading, and arbitrary at rest. The defaults are of the order
    of a receiver with carrier-phase corrections (RTK). The error of the position is the sum of a constant, a
    first-order Gauss-Markov process and white noise. A lost fix is NaN.

    Raises
    ------
    InvalidParameter
        If a value is out of range.
    """

    rate: float = 10.0  #: fixes per second [Hz]
    position_sd: float = 0.03  #: standard deviation of a fix, each axis [m]
    offset_sd: float = 0.0  #: spread of the constant offset, drawn once per episode, each axis [m]
    velocity_sd: float = 0.05  #: standard deviation of the velocity, each axis [m/s]
    drift_sd: float = 0.0  #: standard deviation of the correlated error of the position, each axis [m]
    drift_time: float = 100.0  #: its correlation time [s]
    latency: float = 0.0  #: age of a fix on delivery [s]; a multiple of the IMU's sampling period
    dropout: float = 0.0  #: share of fixes that are lost [-]
    outage: float = 0.0  #: mean duration of a loss [s]; at most a fix's: single fixes

    def __post_init__(self) -> None:
        _check_fields(self, GNSS_RANGES)

    @property
    def total_position_sd(self) -> float:
        """Standard deviation of a fix with its correlated part, each axis [m]."""
        return math.hypot(self.position_sd, self.drift_sd)


def _rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Columns: axes that are yawed left, then pitched nose up, then rolled, in forward-left-up axes."""
    c, s = math.cos(roll), math.sin(roll)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = math.cos(pitch), math.sin(pitch)
    about_y = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # nose up: about -y
    c, s = math.cos(yaw), math.sin(yaw)
    about_z = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.ascontiguousarray(about_z @ about_y @ about_x)
