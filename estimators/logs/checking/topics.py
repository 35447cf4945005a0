"""Topics of a bag or MCAP file as columns of a log, by the types of their messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from estimators.logs import bags
from estimators.logs.checking.mends import Line, Remark
from estimators.logs.checking.naming import column_of
from estimators.logs.reading import parse_description
from estimators.logs.schema import VEHICLE_INPUTS
from offroad_env.errors import DataError

__all__ = ["topic_remarks"]

#: Type of message -> (key under ``topics``, field; "" takes the whole message).
_KNOWN = {
    "sensor_msgs/msg/Imu": (("imu", ""),),
    "nav_msgs/msg/Odometry": (("odometry", ""),),
    "sensor_msgs/msg/NavSatFix": (("latitude", "latitude"), ("longitude", "longitude")),
    "ackermann_msgs/msg/AckermannDriveStamped": (("steer", "drive.steering_angle"),),
    "ackermann_msgs/msg/AckermannDrive": (("steer", "steering_angle"),),
    "geometry_msgs/msg/TwistStamped": (("v_x", "twist.linear.x"), ("v_y", "twist.linear.y")),
}
_NUMBERS = ("std_msgs/msg/Float64", "std_msgs/msg/Float32", "std_msgs/msg/Int32", "std_msgs/msg/Int64")


def topic_remarks(path: Path, text: str) -> list[Remark]:
    """Lines for the topics of a file whose YAML names none.

    Raises
    ------
    DataError
        If the file cannot be read.
    """
    top = parse_description(text.encode(), "")
    if "topics" in top:
        return []
    topics = bags.topics_of(path)
    lines: dict[str, Line] = {}
    for topic, kind in sorted(topics.items()):
        for key, value in _columns(topic, kind):
            lines.setdefault(key, Line(f"topics.{key}", value))
    listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(topics.items()))
    if not lines:
        raise DataError(f"{path}: no topic is of a known type: name the fields under topics; it has {listed}")
    return [
        Remark(
            severity="problem", sentence=f"topics are missing; it has {listed}", lines=tuple(lines.values())
        )
    ]


def _columns(topic: str, kind: str) -> Iterator[tuple[str, str]]:
    for key, field in _KNOWN.get(kind, ()):
        yield key, f"{topic} {field}".strip()
    if kind in _NUMBERS:
        name = topic.rsplit("/", 1)[-1]
        column = name if name in VEHICLE_INPUTS else column_of(topic.strip("/"))
        if column is not None and not topic.startswith("/reference/"):
            yield column, f"{topic} data"
