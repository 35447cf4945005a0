"""Sensors by name: what a vehicle of that class has on board, each number with its source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from offroad_env.errors import InvalidParameter
from offroad_env.physics.numerics import GRAVITY
from offroad_env.simulation.sensor_configs import GnssConfig, ImuConfig, WheelSpeedConfig, noise_sd
from offroad_env.simulation.sensors import SensorSuite
from offroad_env.world.argument_checks import require_record
from offroad_env.world.yaml_text import shown

__all__ = ["SENSORS", "SensorPreset", "make_sensors"]

_DEGREE = 0.017453292519943295  #: [rad]
_MILLI_G = 1e-3 * GRAVITY  #: [m/s^2]
_PER_HOUR = _DEGREE / 3600.0  #: degrees per hour [rad/s]
#: Sampling rate of the inertial units here [Hz]: two samples in a control period of the environment.
_RATE = 100.0
#: Circle that holds half of the fixes, in standard deviations of an axis (Rayleigh distribution).
_CEP = 1.1774
#: By how much a sensor warms up after its offset was taken out at standstill [K]; assumed.
_WARMING = 5.0
#: Correlation time of GNSS errors [s]: geometric middle of the 10 to 900 s that Joerger & Pervan (2020) allow
#: for code multipath.
_GNSS_TIME = 100.0


@dataclass(frozen=True, kw_only=True)
class SensorPreset:
    """A set of sensors and where its numbers come from."""

    imu: ImuConfig
    wheel: WheelSpeedConfig
    gnss: GnssConfig
    title: str
    sources: tuple[tuple[str, str], ...]  #: (sensor: fields, source), in the order of the fields


_ASSUMED = "assumed: no data sheet states it"

#: Name -> preset, from the best sensors to the cheapest after the paper's own.
SENSORS: dict[str, SensorPreset] = {
    "paper": SensorPreset(
        title="white noise of the paper's IMU, RTK, no other error; the environment's default",
        imu=ImuConfig(),
        wheel=WheelSpeedConfig(),
        gnss=GnssConfig(),
        sources=(
            ("imu: noise", "Buzhardt & Tallapragada, ACC 2021: 0.2 m/s^2 and 1 degree/s"),
            ("wheel, gnss", "orders of magnitude of ABS sensors and of an RTK receiver"),
        ),
    ),
    "ideal": SensorPreset(
        title="white noise only, far below any other error; not a product",
        imu=ImuConfig(accel_noise=1e-3, gyro_noise=1e-4, kind="specific_force"),
        wheel=WheelSpeedConfig(noise=1e-3, scale_sd=0.0),
        gnss=GnssConfig(position_sd=0.02, velocity_sd=0.01),
        sources=(
            ("imu, wheel: noise", "chosen: filters and logs need a noise above zero"),
            ("gnss: position_sd", "RTK on a short baseline, 0.01 m + 1 ppm CEP (u-blox UBX-20039643)"),
        ),
    ),
    "automotive": SensorPreset(
        title="MEMS unit of a car, ABS wheel speeds, multi-band GNSS with corrections",
        imu=ImuConfig(
            rate=_RATE,
            kind="specific_force",
            accel_noise=noise_sd(0.12 * _MILLI_G, _RATE),
            gyro_noise=noise_sd(0.014 * _DEGREE, _RATE),
            accel_bias_sd=_WARMING * _MILLI_G,
            gyro_bias_sd=_WARMING * 0.015 * _DEGREE,
            accel_instability=0.013 * _MILLI_G,
            gyro_instability=8.0 * _PER_HOUR,
            accel_scale_sd=0.01,
            gyro_scale_sd=0.01,
            misalignment_sd=(0.01, 0.01, 0.01),
            accel_range=8.0 * GRAVITY,
            gyro_range=250.0 * _DEGREE,
            latency=0.01,
            dropout=0.001,
        ),
        wheel=WheelSpeedConfig(
            noise=0.0, scale_sd=0.01, pulses_per_turn=96.0, window=0.1, latency=0.02, dropout=0.001
        ),
        gnss=GnssConfig(
            position_sd=0.02,
            drift_sd=0.2 / _CEP,
            drift_time=_GNSS_TIME,
            velocity_sd=0.05,
            latency=0.1,
            dropout=0.01,
            outage=2.0,
        ),
        sources=(
            (
                "imu: noise",
                "Bosch BMA280, BMG160 (CISS manual, section 4.11): 120 ug, 0.014 deg/s per root Hz",
            ),
            ("imu: gyro_bias_sd", "zeroed at standstill, then 5 K (assumed) of 0.015 deg/s per K (the same)"),
            (
                "imu: accel_bias_sd",
                "levelled at standstill, then 5 K (assumed) of 1 mg per K, class of the BMA280",
            ),
            ("imu: instability", "Analog Devices ADIS16470, rev. C: 13 ug, 8 deg/h in run; 100 s assumed"),
            (
                "imu: scale_sd, misalignment_sd",
                "1 % sensitivity and cross-axis tolerance, class of the BMG160",
            ),
            ("imu: range", "selectable ranges 8 g and 250 deg/s (Bosch SMI230, V2.1)"),
            ("imu, wheel: latency, dropout", f"one and two periods of a 100 Hz bus, 0.1 %; {_ASSUMED}"),
            (
                "wheel: pulses_per_turn",
                "48 serrations (Toyota Avalon 1999, repair manual), both edges counted",
            ),
            (
                "wheel: window",
                "repetition time of message EBC2, SAE J1939-71; 0.1 s from memory, not looked up",
            ),
            ("wheel: scale_sd", "rolling radius over load, pressure and wear; assumed"),
            (
                "gnss: position",
                "decimetre class with corrections (u-blox ZED-F9K, UBX-20046189): CEP 0.2 m taken",
            ),
            ("gnss: drift_time", "10 to 900 s, Joerger & Pervan (2020), multipath"),
            ("gnss: velocity_sd", "0.05 m/s, class of u-blox M8 to F9"),
            ("gnss: latency, dropout, outage", f"one fix; 1 % in gaps of 2 s, trees and bridges; {_ASSUMED}"),
        ),
    ),
    "consumer": SensorPreset(
        title="hobby MEMS unit, slotted discs at the wheels, single-band GNSS",
        imu=ImuConfig(
            rate=_RATE,
            kind="specific_force",
            accel_noise=noise_sd(0.4 * _MILLI_G, _RATE),
            gyro_noise=noise_sd(0.005 * _DEGREE, _RATE),
            accel_bias_sd=50.0 * _MILLI_G,
            gyro_bias_sd=_WARMING * 20.0 / 60.0 * _DEGREE,
            accel_instability=0.1 * _MILLI_G,
            gyro_instability=36.0 * _PER_HOUR,
            accel_scale_sd=0.03,
            gyro_scale_sd=0.03,
            misalignment_sd=(0.02, 0.02, 0.02),
            accel_range=2.0 * GRAVITY,
            gyro_range=250.0 * _DEGREE,
            latency=0.02,
            dropout=0.01,
        ),
        wheel=WheelSpeedConfig(
            noise=0.0, scale_sd=0.02, pulses_per_turn=20.0, window=0.2, latency=0.04, dropout=0.01
        ),
        gnss=GnssConfig(
            rate=5.0,
            position_sd=0.3,
            drift_sd=2.5 / _CEP,
            drift_time=_GNSS_TIME,
            velocity_sd=0.1,
            latency=0.2,
            dropout=0.05,
            outage=5.0,
        ),
        sources=(
            ("imu: noise", "InvenSense MPU-6050, PS-MPU-6000A rev. 3.4: 400 ug, 0.005 deg/s per root Hz"),
            ("imu: accel_bias_sd", "the same: 50 mg initial tolerance, not taken out"),
            (
                "imu: gyro_bias_sd",
                "the same: 20 deg/s from 25 to 85 C; zeroed at standstill, then 5 K (assumed)",
            ),
            ("imu: instability", f"0.1 mg, 36 deg/h; {_ASSUMED}"),
            ("imu: scale_sd, misalignment_sd", "the same: 3 % sensitivity, 2 % cross-axis"),
            ("imu: range", "the same: power-on ranges 2 g, 250 deg/s"),
            ("imu, wheel: latency, dropout", f"two and four periods of 100 Hz, 1 %; {_ASSUMED}"),
            ("wheel: pulses_per_turn, window", f"slotted disc with 20 slots, 0.2 s; {_ASSUMED}"),
            ("wheel: scale_sd", "twice that of a car; assumed"),
            ("gnss: position", "2.5 m CEP, class of the u-blox NEO-M8; 0.3 m of it white (assumed)"),
            ("gnss: drift_time", "10 to 900 s, Joerger & Pervan (2020), multipath"),
            ("gnss: velocity_sd", f"twice the class of a car; {_ASSUMED}"),
            (
                "gnss: latency",
                "128 ms for position, 205 ms for velocity, measured by a user of a u-blox LEA-5H",
            ),
            ("gnss: dropout, outage", f"5 % in gaps of 5 s; {_ASSUMED}"),
        ),
    ),
}


def _preset(name: str) -> SensorPreset:
    if name not in SENSORS:
        raise InvalidParameter(f"sensors must be one of {', '.join(SENSORS)}, got {shown(name)}")
    return SENSORS[name]


#: What makes sensors, as a refusal names it.
_HERE = "make_sensors"


def _part(name: str, given: Any, own: Any, kind: type) -> Any:
    """A configuration: the preset's own, that of another preset, or the one that is given."""
    if isinstance(given, str):
        return own if given == "preset" else getattr(_preset(given), name)
    return require_record(name, given, kind, "its class, or a name")


def make_sensors(
    sensors: str | SensorSuite = "paper",
    *,
    imu: ImuConfig | str = "preset",
    wheel: WheelSpeedConfig | str | None = "preset",
    gnss: GnssConfig | str | None = "preset",
) -> SensorSuite:
    """Sensors by name, with parts of one's own or of other presets.

    Parameters
    ----------
    sensors
        A name in `SENSORS`, or sensors whose configuration is taken over.
    imu, wheel, gnss
        In place of the preset's own ("preset"): a configuration, the name of another preset, or None to leave
        wheel speeds or GNSS out.

    Raises
    ------
    InvalidParameter
        For an unknown name, or rates that do not fit.

    Examples
    --------
    >>> make_sensors("automotive", gnss="consumer").gnss.rate
    5.0
    """
    base: SensorPreset | SensorSuite
    base = (
        _preset(sensors)
        if isinstance(sensors, str)
        else require_record("sensors", sensors, SensorSuite, _HERE)
    )
    return SensorSuite(
        imu=_part("imu", imu, base.imu, ImuConfig),
        wheel=None if wheel is None else _part("wheel", wheel, base.wheel, WheelSpeedConfig),
        gnss=None if gnss is None else _part("gnss", gnss, base.gnss, GnssConfig),
    )
