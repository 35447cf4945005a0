"""ROS 1 and ROS 2 bags as tables: the YAML maps fields of topics to columns.

    topics:
      imu: /imu/data                                   # sensor_msgs/Imu: six columns, signs included
      odometry: /odom                                  # nav_msgs/Odometry: x, y, yaw, v_x, v_y
      steer: /ackermann_cmd drive.steering_angle       # topic, then the field
      omega_f: {topic: /joints, field: "velocity[0]", factor: 1.0}
    clock: header                                      # or bag: when the recorder received it

A row stands for every time stamp of any topic; columns without a sample there are NaN.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from estimators.logs.file_keys import TimeKeys
from estimators.logs.schema import REFERENCE, VEHICLE_INPUTS, nearest
from estimators.logs.tables import MOST_LOG, Table
from estimators.logs.yaml_sections import Section
from offroad_env.errors import DataError
from offroad_env.world.files import open_file
from offroad_env.world.yaml_text import shown

__all__ = [
    "BAG_EXTRA",
    "Topics",
    "add_file",
    "is_bag",
    "is_ros2_bag",
    "parse_topics",
    "read_bag",
    "topics_of",
]

BAG_EXTRA = 'reading ROS bags needs rosbags: pip install "offroad-bekker[data]"'

#: sensor_msgs/Imu has axes forward, left, up. Turning about "left" by the right hand lowers the
#: nose, so its y rate is minus the pitch rate.
_IMU_FIELDS = (
    ("a_x", "linear_acceleration.x", 1.0),
    ("a_y", "linear_acceleration.y", 1.0),
    ("a_z", "linear_acceleration.z", 1.0),
    ("roll_rate", "angular_velocity.x", 1.0),
    ("pitch_rate", "angular_velocity.y", -1.0),
    ("yaw_rate", "angular_velocity.z", 1.0),
)
_ODOMETRY_FIELDS = (
    ("x", "pose.pose.position.x", 1.0),
    ("y", "pose.pose.position.y", 1.0),
    ("yaw", "pose.pose.orientation", 1.0),
    ("v_x", "twist.twist.linear.x", 1.0),
    ("v_y", "twist.twist.linear.y", 1.0),
)
_SENSORS = {"imu": _IMU_FIELDS, "odometry": _ODOMETRY_FIELDS}
_CLOCKS = ("header", "bag")
_INDEXED = re.compile(r"(?P<field>[\w.]+)\[(?P<index>\d+)\]")


class Digest(Protocol):
    """A hash that can take more bytes."""

    def update(self, data: bytes, /) -> None:
        """Add bytes."""

    def hexdigest(self) -> str:
        """The hash of all bytes so far."""


@dataclass(frozen=True, kw_only=True)
class _Source:
    """Where a column comes from."""

    column: str
    topic: str
    field: str
    factor: float


@dataclass(frozen=True, kw_only=True)
class Topics:
    """Sources of the columns, from the YAML of a bag."""

    sources: tuple[_Source, ...]
    clock: str  #: "header" or "bag"
    section: Section  #: for errors that name the line


def is_ros2_bag(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return (path / "metadata.yaml").is_file()


def is_bag(path: Path) -> bool:
    """Whether a file or folder holds messages of topics, not a table."""
    return path.is_dir() or path.suffix.lower() in (".bag", ".mcap")


def parse_topics(top: Section) -> Topics:
    """Take the keys that only a bag has, ``topics`` and ``clock``, out of the YAML.

    Raises
    ------
    DataError
        With file, line and key.
    """
    section = top.section("topics")
    sources: list[_Source] = []
    for key, value in section.rest().items():
        for source in _sources(section, str(key), value):
            if any(other.column == source.column for other in sources):
                raise section.error(f"topics.{key}: column {source.column!r} has two sources", str(key))
            sources.append(source)
    if not sources:
        raise top.error("topics names no topic", "topics")
    return Topics(sources=tuple(sources), clock=top.choice("clock", _CLOCKS, "header"), section=section)


def _sources(section: Section, key: str, value: Any) -> Iterable[_Source]:
    if key in _SENSORS:
        if not isinstance(value, str) or not value.startswith("/"):
            raise section.error(f"topics.{key} must be a topic such as /{key}, got {shown(value)}", key)
        return [_Source(column=c, topic=value, field=f, factor=k) for c, f, k in _SENSORS[key]]
    if key == "t" or (key not in VEHICLE_INPUTS and not key.startswith(REFERENCE)):
        near = nearest(key, (*VEHICLE_INPUTS, *_SENSORS))
        hint = f" - did you mean {near!r}?" if near else ""
        raise section.error(f"topics.{key}: a bag fills no such column{hint}", key)
    if isinstance(value, str) and len(value.split()) == 2:
        topic, field = value.split()
        return [_Source(column=key, topic=topic, field=field, factor=1.0)]
    if isinstance(value, dict) and {"topic", "field"} <= set(value) <= {"topic", "field", "factor"}:
        topic, field, factor = value["topic"], value["field"], value.get("factor", 1.0)
        texts = isinstance(topic, str) and isinstance(field, str)
        if texts and isinstance(factor, (int, float)) and math.isfinite(factor) and factor != 0.0:
            return [_Source(column=key, topic=topic, field=field, factor=float(factor))]
    raise section.error(
        f"topics.{key} must be '/topic field' or {{topic: /topic, field: name, factor: 1.0}}, "
        f"got {shown(value)}",
        key,
    )


def read_bag(path: Path, topics: Topics, time: TimeKeys) -> tuple[Table, Digest]:
    """All mapped columns of a bag, and the hash of its files so far.

    ``time`` states whether messages of a topic may be out of order, or have one stamp.

    Raises
    ------
    DataError
        If rosbags is missing, the bag is damaged, a topic or field is not in it, a field is no
        number, or the stamps of a topic do not increase.
    """
    digest = hashlib.sha256()
    for name in sorted(path.iterdir()) if path.is_dir() else [path]:
        with open_file(name, most=MOST_LOG) as file:
            add_file(digest, file)
    stamps = {
        topic: _in_order(path, topic, messages, time) for topic, messages in _messages(path, topics).items()
    }
    times = np.array(sorted(set().union(*(times for times, _ in stamps.values()))), dtype=np.int64)
    columns = {"t": (times - times[0]) * 1e-9}
    for source in topics.sources:
        own, values = stamps[source.topic]
        column = np.full(len(times), math.nan)
        column[np.searchsorted(times, np.array(own, dtype=np.int64))] = values[source.column]
        columns[source.column] = column
    return Table(file=str(path), columns=columns, rows=np.arange(1, len(times) + 1)), digest


def add_file(digest: Digest, file: BinaryIO) -> Digest:
    """Add the rest of a file to a hash, piece by piece."""
    while piece := file.read(1_000_000):
        digest.update(piece)
    return digest


def topics_of(path: Path) -> dict[str, str]:
    """Topics of a bag with the types of their messages.

    Raises
    ------
    DataError
        If rosbags is missing, or the bag is damaged.
    """
    with _opened(path) as reader:
        return {topic: info.msgtype or "several types" for topic, info in reader.topics.items()}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A reader of the bag; whatever fails inside is said in one sentence."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError(BAG_EXTRA) from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            yield reader
    except DataError:
        raise
    except Exception as error:  # a damaged bag fails anywhere inside the reader, in many ways
        reason = " ".join(str(error).split())[:120]
        raise DataError(f"{path}: cannot be read as a ROS bag: {reason or type(error).__name__}") from None


def _messages(path: Path, topics: Topics) -> dict[str, tuple[list[int], dict[str, list[float]]]]:
    """Per topic: stamps [ns] and values by column."""
    wanted = {
        source.topic: [s for s in topics.sources if s.topic == source.topic] for source in topics.sources
    }
    found: dict[str, tuple[list[int], dict[str, list[float]]]] = {
        topic: ([], {source.column: [] for source in sources}) for topic, sources in wanted.items()
    }
    with _opened(path) as reader:
        _check_topics(reader, wanted, path, topics.section)
        connections = [c for c in reader.connections if c.topic in wanted]
        for connection, received, raw in reader.messages(connections=connections):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = _stamp(message, received, topics.clock)
            _store(path, message, stamp, wanted[connection.topic], found[connection.topic])
    for topic, (times, _) in found.items():
        if not times:
            raise DataError(f"{path}: topic {topic} holds no message")
    return found


def _check_topics(reader: Any, wanted: Iterable[str], path: Path, section: Section) -> None:
    for topic in wanted:
        if topic not in reader.topics:
            near = nearest(topic, reader.topics)
            names = (
                f"did you mean {near}?" if near else f"it has {', '.join(sorted(reader.topics)) or 'none'}"
            )
            raise section.error(f"{path} has no topic {topic} - {names}")


def _stamp(message: Any, received: int, clock: str) -> int:
    """When the message was measured [ns]: the stamp of its header, or else its time of arrival."""
    header = getattr(message, "header", None)
    if clock == "bag" or header is None:
        return received
    stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    return stamp or received


def _store(
    path: Path,
    message: Any,
    stamp: int,
    sources: Iterable[_Source],
    found: tuple[list[int], dict[str, list[float]]],
) -> None:
    times, columns = found
    for source in sources:
        where = f"{path}, topic {source.topic}, message {len(times) + 1}"
        value = _value(message, source.field, where)
        columns[source.column].append(value * source.factor)
    times.append(stamp)


def _in_order(
    path: Path, topic: str, messages: tuple[list[int], dict[str, list[float]]], time: TimeKeys
) -> tuple[list[int], dict[str, list[float]]]:
    """Messages of a topic in the order of their stamps, one for each, as far as ``time`` allows."""
    times, columns = messages
    rows = list(range(len(times)))
    if time.order != "refuse":
        rows.sort(key=times.__getitem__)
    kept = rows[:1]
    for row in rows[1:]:
        stamp, before = times[row], times[kept[-1]]
        if stamp == before and time.repeated == "merge":
            continue
        if stamp <= before:
            how = "stands twice" if stamp == before else f"follows {before * 1e-9:.6f} s"
            mend = "time.repeated: merge" if stamp == before else "time.order: sort"
            raise DataError(
                f"{path}, topic {topic}, message {row + 1}: time must increase, but {stamp * 1e-9:.6f} s "
                f"{how} ({mend} in the YAML mends it)"
            )
        kept.append(row)
    return [times[row] for row in kept], {
        name: [values[row] for row in kept] for name, values in columns.items()
    }


def _value(message: Any, field: str, where: str) -> float:
    indexed = _INDEXED.fullmatch(field)
    try:
        value = attrgetter(indexed["field"] if indexed else field)(message)
        if indexed:
            value = value[int(indexed["index"])]
    except AttributeError:
        names = ", ".join(name for name in vars(message) if not name.startswith("_"))
        raise DataError(f"{where}: has no field {field!r}; it has {names}") from None
    except IndexError:
        raise DataError(f"{where}: {field!r} is out of range") from None
    if all(hasattr(value, axis) for axis in "wxyz"):
        return _heading(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise DataError(f"{where}: {field!r} is no number") from None


def _heading(q: Any) -> float:
    """Yaw of a quaternion [rad]."""
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
