"""Constants and first memory of sensors whose errors wander, are late or are lost: a record of `SENSING`."""

from __future__ import annotations

import math
from dataclasses import fields
from statistics import NormalDist

import numpy as np

from offroad_env.errors import InvalidParameter
from offroad_env.physics.sensor_errors import DEPTH, GNSS_LOSS, IMU_LOSS, SENSING, WHEEL_LOSS
from offroad_env.simulation.sensor_configs import ALLAN_PEAK, GnssConfig, ImuConfig, WheelSpeedConfig

__all__ = ["SCALES", "SLOW_CONSTANTS", "has_memory", "make_memory", "samples_of"]

#: Standard normal numbers with which drift, encoders and scales begin: five biases, two errors of the
#: position, where the encoders stand, five scales.
_BIASES, _FIX, _PHASES, SCALES = slice(0, 5), slice(5, 7), slice(7, 9), slice(9, 14)
SLOW_CONSTANTS = 14
#: What makes a sensor one with a memory.
_REMEMBERED = (
    *("accel_instability", "gyro_instability", "accel_range", "gyro_range"),
    *("latency", "dropout", "pulses_per_turn", "drift_sd"),
)

Config = ImuConfig | WheelSpeedConfig | GnssConfig


def has_memory(config: Config | None) -> bool:
    """Whether what the sensor delivers depends on more than the present and on constant errors."""
    if config is None:
        return False
    return any(getattr(config, item.name) > 0.0 for item in fields(config) if item.name in _REMEMBERED)


def samples_of(name: str, time: float, rate: float) -> int:
    """A time [s] in samples of the IMU, which comes at ``rate`` [Hz]."""
    count = time * rate
    if abs(count - round(count)) > 1e-6:
        raise InvalidParameter(
            f"{name} must be a multiple of the IMU's sampling period {1.0 / rate:g} s, got {time:g} s"
        )
    return round(count)


def _quantile(probability: float) -> float:
    """Below it a standard normal number lies with this probability."""
    if probability <= 0.0:
        return -math.inf
    return math.inf if probability >= 1.0 else NormalDist().inv_cdf(probability)


def _losses(name: str, config: Config) -> tuple[float, float]:
    """(lose, recover): thresholds of a standard normal number for a sample of the sensor (Gilbert 1960)."""
    recover = 1.0 / max(config.outage * config.rate, 1.0)
    lose = recover * config.dropout / (1.0 - config.dropout)
    if lose > 1.0:
        raise InvalidParameter(
            f"{name}.dropout = {config.dropout:g} needs losses that last longer: raise {name}.outage"
        )
    return _quantile(lose), _quantile(recover)


def _markov(sd: float, time: float, dt: float) -> tuple[float, float]:
    """(keep, push) of a first-order Gauss-Markov process, exact for the step ``dt``."""
    keep = math.exp(-dt / time) if time > 0.0 else 0.0
    return keep, sd * math.sqrt(1.0 - keep * keep)


def _set_wheels(record: np.void, imu: ImuConfig, wheel: WheelSpeedConfig, radius: float | None) -> None:
    """The encoder and its window."""
    if not wheel.pulses_per_turn > 0.0:
        return
    if radius is None:
        raise InvalidParameter("wheel.pulses_per_turn needs the wheel's radius: call reset(rng, radius=...)")
    window = samples_of("wheel.window", wheel.window or 1.0 / wheel.rate, imu.rate)
    record["pitch"], record["window"] = 2.0 * math.pi * radius / wheel.pulses_per_turn, window


def make_memory(
    imu: ImuConfig,
    wheel: WheelSpeedConfig | None,
    gnss: GnssConfig | None,
    z: np.ndarray,
    radius: float | None,
) -> np.ndarray:
    """(1,) record of the type `SENSING` at the start of an episode.

    Parameters
    ----------
    imu, wheel, gnss
    z
        (SLOW_CONSTANTS,) standard normal numbers: drifts start anywhere in their stationary spread.
    radius
        Nominal radius of the wheels [m], for encoders.

    Raises
    ------
    InvalidParameter
        For a latency or window between samples, or longer than the memory; encoders without a radius.
    """
    memory = np.zeros(1, SENSING)
    record, dt = memory[0], 1.0 / imu.rate
    record["active"], record["dt"], record["window"] = 1.0, dt, 1
    limits = [value or math.inf for value in (imu.accel_range, imu.gyro_range)]
    record["limit"] = np.repeat(limits, (3, 2))
    sd = np.repeat([imu.accel_instability, imu.gyro_instability], (3, 2)) / ALLAN_PEAK
    record["keep"], push = _markov(1.0, imu.bias_time, dt)
    record["push"], record["bias"] = push * sd, sd * z[_BIASES]
    if gnss is not None:
        record["fix_keep"], record["fix_push"] = _markov(gnss.drift_sd, gnss.drift_time, dt)
        record["fix_error"] = gnss.drift_sd * z[_FIX]
    if wheel is not None:
        _set_wheels(record, imu, wheel, radius)
    parts: tuple[tuple[str, int, Config | None], ...] = (
        ("imu", IMU_LOSS, imu),
        ("wheel", WHEEL_LOSS, wheel),
        ("gnss", GNSS_LOSS, gnss),
    )
    for name, i, config in parts:
        record["lose"][i] = record["recover"][i] = -math.inf
        if config is not None:
            record["late"][i] = samples_of(f"{name}.latency", config.latency, imu.rate)
            record["lose"][i], record["recover"][i] = _losses(name, config)
    longest = max(*record["late"], record["late"][WHEEL_LOSS] + record["window"])
    if longest >= DEPTH:
        raise InvalidParameter(
            f"latency and window reach back {longest / imu.rate:g} s, "
            f"at most {(DEPTH - 1) / imu.rate:g} s are kept"
        )
    record["phase"] = [NormalDist().cdf(value) for value in z[_PHASES]]
    return memory
