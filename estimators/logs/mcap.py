"""Logs as MCAP files, which Foxglove, Lichtblick, PlotJuggler and Rerun open.

The IMU is a topic of ``sensor_msgs/Imu`` where all of its axes are sampled together, every other channel one
of ``std_msgs/Float64``, reference columns are below ``/reference``. Stamps are those of the rows, in
nanoseconds.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from estimators.logs.bags import BAG_EXTRA
from estimators.logs.log import Log
from estimators.logs.mounting import ACCELEROMETERS, GYROS
from offroad_env.errors import DataError

__all__ = ["mcap_bytes", "mcap_topics"]

_IMU_TOPIC = "/imu"
_SENSED = tuple(name for name, _ in (*ACCELEROMETERS, *GYROS))


def _single(log: Log) -> dict[str, tuple[str, np.ndarray]]:
    """Topic -> (column, values) of all topics of one number."""
    own = {f"/{name}": (name, values) for name, values in log.channels.items() if not _in_imu(log, name)}
    references = {f"/reference/{name[4:]}": (name, values) for name, values in log.references.items()}
    return own | references


def _in_imu(log: Log, name: str) -> bool:
    """Whether a channel is part of the message of the IMU, which has all axes of one instant."""
    return name in _SENSED and _is_whole(log)


def _is_whole(log: Log) -> bool:
    """Whether all axes of an IMU, but for the roll rate, are there, and each sampled in the same rows."""
    if not all(axis in log.channels for axis in _SENSED if axis != "roll_rate"):
        return False
    missing = [np.isnan(log.channels[axis]) for axis in _SENSED if axis in log.channels]
    return all(np.array_equal(rows, missing[0]) for rows in missing)


def mcap_topics(log: Log) -> dict[str, Any]:
    """The section ``topics`` of the YAML beside the file."""
    topics: dict[str, Any] = {name: f"{topic} data" for topic, (name, _) in _single(log).items()}
    for name, field in _FIELDS.items():
        if _in_imu(log, name) and name in log.channels:
            topics[name] = f"{_IMU_TOPIC} {field}"
            if name == "pitch_rate":
                topics[name] = {"topic": _IMU_TOPIC, "field": field, "factor": -1.0}
    return topics


_FIELDS = {
    "a_x": "linear_acceleration.x",
    "a_y": "linear_acceleration.y",
    "a_z": "linear_acceleration.z",
    "roll_rate": "angular_velocity.x",
    "pitch_rate": "angular_velocity.y",
    "yaw_rate": "angular_velocity.z",
}


def mcap_bytes(log: Log) -> bytes:
    """Content of the file.

    Raises
    ------
    DataError
        Where rosbags is not installed, or for a wheel-rig log.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError(BAG_EXTRA.replace("reading", "writing")) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    stamps = np.round(log.times * 1e9).astype(np.int64)
    stamps = stamps - min(int(stamps[0]), 0)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "log"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {topic: values for topic, (_, values) in _single(log).items()}
            connections = {topic: writer.add_connection(topic, _NUMBER, typestore=store) for topic in topics}
            imu = writer.add_connection(_IMU_TOPIC, _IMU_TYPE, typestore=store) if _has_imu(log) else None
            for row, stamp in enumerate(stamps.tolist()):
                for topic, values in topics.items():
                    if not math.isnan(values[row]):
                        message = store.types[_NUMBER](float(values[row]))
                        writer.write(connections[topic], stamp, store.serialize_cdr(message, _NUMBER))
                whole = None if imu is None else _imu_message(log, row, stamp, store.types)
                if imu is not None and whole is not None:
                    writer.write(imu, stamp, store.serialize_cdr(whole, _IMU_TYPE))
        (file,) = bag.glob("*.mcap")
        return file.read_bytes()


_NUMBER, _IMU_TYPE = "std_msgs/msg/Float64", "sensor_msgs/msg/Imu"


def _has_imu(log: Log) -> bool:
    return _in_imu(log, "a_x")


def _imu_message(log: Log, row: int, stamp: int, types: Mapping[str, Any]) -> Any | None:
    """The message of one row, None where the IMU has no sample."""
    values = {name: float(log.channels[name][row]) for name in _SENSED if name in log.channels}
    if any(math.isnan(value) for value in values.values()):
        return None
    vector = types["geometry_msgs/msg/Vector3"]
    axes = [sign * values.get(name, 0.0) for name, sign in GYROS]
    unknown = np.full(9, -1.0)  # as the type has it: no covariance
    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](stamp // 1_000_000_000, stamp % 1_000_000_000), "imu"
    )
    return types[_IMU_TYPE](
        header,
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        unknown,
        vector(*axes),
        unknown,
        vector(*(values[name] for name, _ in ACCELEROMETERS)),
        unknown,
    )
