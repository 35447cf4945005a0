"""Simulated sensors: IMU, wheel speeds, GNSS. Filters and policies see nothing else of the truth."""

from __future__ import annotations

from dataclasses import replace
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
from offroad_env.physics.sensor_errors import NOISE_COLUMNS, sense_into
from offroad_env.physics.state import STATE_SIZE
from offroad_env.simulation.sensor_configs import GnssConfig, ImuConfig, WheelSpeedConfig
from offroad_env.simulation.sensor_memory import SCALES, SLOW_CONSTANTS, has_memory, make_memory

__all__ = ["GnssConfig", "ImuConfig", "SensorSample", "SensorSuite", "WheelSpeedConfig"]

#: Standard normal numbers of one episode's constant errors.
_BIASES, _MISALIGNMENT, _SCALES, _OFFSETS = slice(0, 5), slice(5, 8), slice(8, 10), slice(10, 12)
_CONSTANT_DRAWS = 12
#: Channels of the IMU.
_ACCELERATIONS, _RATES = 3, 2


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
    accel_bias, gyro_bias
        Known constant errors of all accelerations [m/s^2] and both rates [rad/s], beside those that `reset`
        draws.

    Raises
    ------
    InvalidParameter
        If a rate does not divide the IMU's.

    Notes
    -----
    ``reset`` takes one number from the given Generator and seeds the suite's own from it. Constant errors
    come first, then a fixed count of numbers per sample, whatever the configuration: the same seed gives
    the same noise with any set of sensors, and nothing else that draws from the Generator notices. What
    drives drift, scale errors of the IMU and losses comes from a second one of the same seed, so that it does
    not shift the noise either.
    """

    def __init__(
        self,
        *,
        imu: ImuConfig | None = None,
        wheel: WheelSpeedConfig | None = None,
        gnss: GnssConfig | None = None,
        accel_bias: float = 0.0,
        gyro_bias: float = 0.0,
    ) -> None:
        self._bias = np.array([*[accel_bias] * _ACCELERATIONS, *[gyro_bias] * _RATES])
        self.imu = ImuConfig() if imu is None else imu
        self.wheel = wheel
        self.gnss = gnss
        self._is_biased, (self._errors_sd, self._noise_sd) = bool(self._bias.any()), self._spreads()
        #: IMU samples from one sample of the wheel speeds, and of the GNSS, to the next; 0: none.
        self.wheel_every = _divisor("wheel", self.imu.rate, wheel.rate) if wheel else 0
        self.gnss_every = _divisor("gnss", self.imu.rate, gnss.rate) if gnss else 0
        #: Whether errors have a memory: drift, latency, losses, encoders, saturation.
        self.has_memory = any(has_memory(config) for config in (self.imu, wheel, gnss))
        self._rng: np.random.Generator | None = None
        self._slow: np.random.Generator | None = None
        self._memory: np.ndarray | None = None

    def anew(self, *, body_axes: bool | None = None) -> SensorSuite:
        """Sensors of the same configuration that have not been reset; ``body_axes`` replaces the IMU's."""
        imu = self.imu if body_axes is None else replace(self.imu, body_axes=body_axes)
        accel, *_, gyro = self._bias.tolist()
        return SensorSuite(imu=imu, wheel=self.wheel, gnss=self.gnss, accel_bias=accel, gyro_bias=gyro)

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

    @property
    def memory(self) -> np.ndarray:
        """(1,) what the sensors remember, a record of `physics.sensor_errors.SENSING` (truth)."""
        self._generator()
        if self._memory is None:
            slow = np.random.default_rng([self._seed, 1]).standard_normal(SLOW_CONSTANTS)
            self._memory = make_memory(self.imu, self.wheel, self.gnss, slow, self._radius)
        return self._memory

    def reset(self, rng: np.random.Generator, *, radius: float | None = None) -> None:
        """Start an episode: draw the constant errors, restart the clock.

        Parameters
        ----------
        rng
            The caller's Generator, from which one number is taken.
        radius
            Nominal radius of the wheels [m]; needed where an encoder counts their turns.
        """
        self._seed, self._radius = int(rng.integers(2**63)), radius
        self._rng = np.random.default_rng(self._seed)
        drawn = self._rng.standard_normal(_CONSTANT_DRAWS) * self._errors_sd
        self._errors = self._placed(drawn)
        roll, pitch, yaw = drawn[_MISALIGNMENT].tolist()
        self._mount = self.imu.mount((roll, pitch, yaw))
        self._tick = 0
        self._slow = self._memory = None
        if self.has_memory or self.imu.accel_scale_sd > 0.0 or self.imu.gyro_scale_sd > 0.0:
            self._slow = np.random.default_rng([self._seed, 1])
            slow = self._slow.standard_normal(SLOW_CONSTANTS)
            scale_sd = np.repeat([self.imu.accel_scale_sd, self.imu.gyro_scale_sd], (3, 2))
            self._errors[SCALE, IMU] = slow[SCALES] * scale_sd
            if self.has_memory:
                self._memory = make_memory(self.imu, self.wheel, self.gnss, slow, radius)

    def _spreads(self) -> tuple[np.ndarray, np.ndarray]:
        """What an episode's standard normal numbers are multiplied by, and the noise sd of the channels."""
        constant, noise = np.zeros(_CONSTANT_DRAWS), np.zeros(CHANNELS)
        constant[_BIASES] = np.repeat([self.imu.accel_bias_sd, self.imu.gyro_bias_sd], (3, 2))
        constant[_MISALIGNMENT] = self.imu.misalignment_sd
        noise[IMU] = np.repeat([self.imu.accel_noise, self.imu.gyro_noise], (3, 2))
        if self.wheel:
            constant[_SCALES], noise[WHEEL] = self.wheel.scale_sd, self.wheel.noise
        if self.gnss:
            position, velocity = self.gnss.position_sd, self.gnss.velocity_sd
            constant[_OFFSETS], noise[GNSS] = self.gnss.offset_sd, (position, position, velocity, velocity)
        return constant, noise

    def _placed(self, drawn: np.ndarray) -> np.ndarray:
        """The constant errors of an episode (_CONSTANT_DRAWS,), and the noise sd, by channel."""
        errors = np.zeros((3, CHANNELS))
        errors[NOISE_SD] = self._noise_sd
        errors[OFFSET, IMU] = drawn[_BIASES]
        if self._is_biased:
            errors[OFFSET, IMU] += self._bias
        if self.wheel:
            errors[SCALE, WHEEL] = drawn[_SCALES]
        if self.gnss:
            errors[OFFSET, GNSS][:2] = drawn[_OFFSETS]
        return errors

    def draw_noise(self, out: np.ndarray) -> None:
        """Fill ``out`` (samples, NOISE_COLUMNS) with the standard normal numbers of the next instants.

        For callers that run the kernels ``sense`` or ``sense_with_memory`` themselves, and count the instants
        by `wheel_every` and `gnss_every`. Columns that nothing depends on are left alone.
        """
        out[:, :CHANNELS] = self._generator().standard_normal((len(out), CHANNELS))
        if self._slow is not None:
            out[:, CHANNELS:] = self._slow.standard_normal((len(out), NOISE_COLUMNS - CHANNELS))

    def sample(self, state: np.ndarray, readings: np.ndarray) -> SensorSample:
        """Measure now; call once per ``period``.

        Parameters
        ----------
        state
            (15,) state of the vehicle, as laid out in ``offroad_env.physics.state``, or longer: with roll.
        readings
            (32,) readings of the model at that state, or longer.

        Raises
        ------
        InvalidParameter
            Before the first ``reset``.
        """
        noise, out = np.zeros((1, NOISE_COLUMNS)), np.empty(CHANNELS)
        self.draw_noise(noise)
        wheel_due, gnss_due = _is_due(self._tick, self.wheel_every), _is_due(self._tick, self.gnss_every)
        self._tick += 1
        due = (wheel_due, gnss_due)
        if self._memory is None and len(state) == STATE_SIZE:
            sense(state, readings, self._mount, self._errors, noise[0], due, out)
        else:
            sense_into(state, readings, self._mount, self._errors, noise[0], due, self.memory, out)
        wheel_valid, gnss_valid = (bool(np.isfinite(out[i]).all()) for i in (WHEEL, GNSS))
        return SensorSample(out[IMU], out[WHEEL], out[GNSS], wheel_valid, gnss_valid)

    def _generator(self) -> np.random.Generator:
        """The suite's own Generator; refuses what needs a `reset` before."""
        if self._rng is None:
            raise InvalidParameter("the sensors have no noise yet: call reset(rng) first")
        return self._rng
