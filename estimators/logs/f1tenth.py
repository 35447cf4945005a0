"""The indoor drives of a 1:10 car (data set ``f1tenth_indoor``) as logs on hard ground.

As published, the gyro reads in deg/s under the heading rad/s, the accelerometer in g under m/s^2,
and the IMU is turned on the car: its x axis points left, its y axis backwards. `f1tenth_log`
gives the drive as published, so that the checks can find this, or put right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

import numpy as np

from estimators.logs.config import GnssSpec, ImuSpec, LogConfig, StartSpec, TerrainSpec
from estimators.logs.csv_tables import parse_csv
from estimators.logs.log import Log
from estimators.logs.schema import unit_factor
from estimators.logs.tables import MOST_LOG
from estimators.logs.writing import content_hash
from offroad_env.physics.records import Vehicle
from offroad_env.world.files import read_file
from offroad_env.world.soils import make_soil
from offroad_env.world.vehicles import VEHICLES, make_vehicle

__all__ = ["f1tenth_log"]


@dataclass(frozen=True, kw_only=True)
class _Source:
    column: str  #: column of the published file
    sign: float = 1.0


#: The header taken literally: axes forward, left, up; a gyro about "left" reads -pitch_rate.
_AS_PUBLISHED = {
    "a_x": _Source(column="acc_x_m_s2"),
    "a_y": _Source(column="acc_y_m_s2"),
    "a_z": _Source(column="acc_z_m_s2"),
    "roll_rate": _Source(column="gyro_x_rad_s"),
    "pitch_rate": _Source(column="gyro_y_rad_s", sign=-1.0),
    "yaw_rate": _Source(column="gyro_z_rad_s"),
}
#: Mounting of the IMU according to the data: its x axis points left and its y axis backwards.
_AS_MOUNTED = {
    "a_x": _Source(column="acc_y_m_s2", sign=-1.0),
    "a_y": _Source(column="acc_x_m_s2"),
    "a_z": _Source(column="acc_z_m_s2"),
    "roll_rate": _Source(column="gyro_y_rad_s", sign=-1.0),
    "pitch_rate": _Source(column="gyro_x_rad_s", sign=-1.0),
    "yaw_rate": _Source(column="gyro_z_rad_s"),
}
_POSE = {"x": "pf_x_m", "y": "pf_y_m", "yaw": "pf_yaw_rad"}
#: Noise while the car drives, vibration included: second differences of the corrected channels give
#: 0.4 ... 3 m/s^2 and 0.03 ... 0.2 rad/s. Standing still it is 0.15 m/s^2 and 0.02 rad/s.
_SD_A, _SD_RATE = 0.7, 0.05
#: Single-track parameters that the F1TENTH gym publishes: friction 1.0489, cornering stiffness of
#: 4.718 (front) and 5.4562 (rear) per unit of load and rad.
_MU, _C_ALPHA = 1.0489, 5.09


def f1tenth_log(path: str | PathLike[str], *, corrected: bool = False) -> Log:
    """One published drive as a log on hard, level ground.

    Parameters
    ----------
    path
        ``DS1.csv``, ``DS2.csv`` or ``DS3.csv``.
    corrected
        False: the columns under the units and axes that the source states. True: gyro from deg/s,
        accelerations from g, and the IMU's axes turned to the car's.

    Returns
    -------
    Log
        Commanded steering (zero-order hold), wheel speed as rim speed over the nominal radius on
        both axles, IMU (specific force), pose of the authors' particle filter. ``ref_cmd_speed`` and
        ``ref_pf_speed`` (a delayed copy of the wheel speed, so no measurement) stay as references.

    Raises
    ------
    DataError
        If the file is not one of these drives.
    """
    path = Path(path)
    table = parse_csv(read_file(path, most=MOST_LOG), str(path))
    axes = _AS_MOUNTED if corrected else _AS_PUBLISHED
    for name in (
        "t_s",
        "cmd_steer_rad",
        "vesc_speed_m_s",
        *_POSE.values(),
        *(s.column for s in axes.values()),
    ):
        if name not in table.columns:
            raise table.error("the column is missing: this is no drive of f1tenth_indoor", column=name)
    columns, vehicle = table.columns, _vehicle()
    rim = columns["vesc_speed_m_s"] / vehicle.r
    channels = {"steer": columns["cmd_steer_rad"].copy(), "omega_f": rim, "omega_r": rim.copy()}
    for name, source in axes.items():
        unit = ("g", "acceleration") if name.startswith("a_") else ("deg/s", "angular rate")
        factor = unit_factor(*unit) if corrected else 1.0
        channels[name] = source.sign * factor * columns[source.column]
    channels |= {name: columns[source].copy() for name, source in _POSE.items()}
    references = {
        "ref_cmd_speed": columns["cmd_speed_m_s"].copy(),
        "ref_pf_speed": columns["pf_speed_m_s"].copy(),
    }
    t = columns["t_s"].copy()
    for array in (t, *channels.values(), *references.values()):
        array.flags.writeable = False
    config = _config(vehicle, channels)
    log = Log(name=path.stem, t=t, channels=channels, references=references, config=config, hash="")
    return replace(log, hash=content_hash(log))


def _vehicle() -> Vehicle:
    """The catalogue's 1:10 car without drag or actuator lags: those are for the data to show.

    Its steering turns at 3.2 rad/s at most, as the F1TENTH gym publishes.
    """
    return make_vehicle(
        VEHICLES["f1tenth"],
        drag_area=0.0,
        rolling_resistance=0.0,
        steer_lag=0.0,
        torque_lag=0.0,
    )


def _config(vehicle: Vehicle, channels: dict[str, np.ndarray]) -> LogConfig:
    x, y, yaw = (float(channels[name][0]) for name in ("x", "y", "yaw"))
    speed = float(channels["omega_f"][0]) * vehicle.r
    return LogConfig(
        model="full",
        drivetrain="torque",
        vehicle=vehicle,
        soil=make_soil(kind="rigid", mu=_MU, C_alpha=_C_ALPHA),
        terrain=TerrainSpec(kind="flat"),
        imu=ImuSpec(kinematic=False, sd_a=_SD_A, sd_rate=_SD_RATE),
        gnss=GnssSpec(sd_position=0.05),
        hold="zoh",
        start=StartSpec(x=x, y=y, yaw=yaw, v_x=speed),
        # Nobody has published where the IMU sits, which point the pose is of, springs or dampers.
        unknown=("imu.position", "gnss.position", "suspension"),
    )
