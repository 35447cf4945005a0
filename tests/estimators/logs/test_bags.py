"""ROS bags become the same logs as files: stamps, signs, several rates."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from foreign_logs import Foreign, drive
from foreign_logs import write as write_foreign

from estimators.logs import quality, read_log, write_log
from estimators.logs.checking.check import check_log, with_lines
from offroad_env.errors import DataError

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START = 1_700_000_000_250_000_000  # of the recording [ns]
ARRIVAL = 3_000_000  # the recorder gets a message this much after it was measured [ns]
TOPICS = {
    "imu": "/imu/data",
    "odometry": "/odom",
    "steer": {"topic": "/steer", "field": "data", "factor": -1.0},
    "omega_f": "/joints velocity[0]",
    "omega_r": "/joints velocity[1]",
}
DESCRIPTION = {
    "model": "full",
    "drivetrain": "torque",
    "vehicle": {
        "m": 1378.0, "I_z": 1787.0, "I_y": 1395.0, "l_f": 1.537, "l_r": 1.183, "k_f": 28029.0,
        "k_r": 88329.0, "c_f": 14287.0, "c_r": 5707.0, "m_w": 68.0, "r": 0.33, "b": 0.212,
    },
    "soil": {"kind": "rigid", "mu": 0.8, "C_alpha": 10.0},
    "terrain": {"kind": "flat"},
    "imu": {"kinematic": False, "sd": {"a": 0.05, "rate": 0.003}},
    "start": {"x": 0.0, "y": 0.0, "yaw": 0.0, "v_x": 4.0},
    "topics": TOPICS,
}  # fmt: skip


def signals(t: float) -> dict[str, float]:
    """A drive: what each channel of the log shall hold."""
    return {
        "a_x": 0.1 + t, "a_y": 0.2 * t, "a_z": 9.81, "roll_rate": 0.01 * t, "pitch_rate": 0.03 + 0.02 * t,
        "yaw_rate": 0.3, "x": 4.0 * t, "y": 0.6 * t * t, "yaw": 0.3 * t - 1.0, "v_x": 4.0, "v_y": -0.1,
        "steer": 0.2 * t, "omega_f": 12.0 + t, "omega_r": 13.0 - t,
    }  # fmt: skip


class Recording:
    """Writes messages of either ROS into a bag."""

    def __init__(self, path: Path, ros: int) -> None:
        self.ros, self.store = ros, get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        self.writer = Writer1(path) if ros == 1 else Writer2(path, version=9)
        self.writer.open()
        self.connections = {}

    def header(self, stamp: int):
        seconds, rest = divmod(stamp, 1_000_000_000)
        types = self.store.types
        time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        number = {"seq": 0} if self.ros == 1 else {}
        return types["std_msgs/msg/Header"](**number, stamp=time, frame_id="base_link")

    def add(self, topic: str, kind: str, message, stamp: int) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        pack = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], stamp + ARRIVAL, pack(message, kind))

    def imu(self, stamp: int, s: dict[str, float]) -> None:
        types = self.store.types
        vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
        message = types["sensor_msgs/msg/Imu"](
            header=self.header(stamp),
            orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9),
            # ROS axes are forward, left, up: turning about "left" lowers the nose.
            angular_velocity=vector(x=s["roll_rate"], y=-s["pitch_rate"], z=s["yaw_rate"]),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(x=s["a_x"], y=s["a_y"], z=s["a_z"]),
            linear_acceleration_covariance=np.zeros(9),
        )
        self.add("/imu/data", "sensor_msgs/msg/Imu", message, stamp)

    def odometry(self, stamp: int, s: dict[str, float]) -> None:
        types = self.store.types
        vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
        q = types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(0.5 * s["yaw"]), w=math.cos(0.5 * s["yaw"])
        )
        pose = types["geometry_msgs/msg/Pose"](position=point(x=s["x"], y=s["y"], z=0.0), orientation=q)
        still = vector(x=0.0, y=0.0, z=0.0)
        twist = types["geometry_msgs/msg/Twist"](linear=vector(x=s["v_x"], y=s["v_y"], z=0.0), angular=still)
        message = types["nav_msgs/msg/Odometry"](
            header=self.header(stamp),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
        )
        self.add("/odom", "nav_msgs/msg/Odometry", message, stamp)

    def steer(self, stamp: int, s: dict[str, float]) -> None:
        message = self.store.types["std_msgs/msg/Float64"](data=-s["steer"])  # this vehicle steers right
        self.add("/steer", "std_msgs/msg/Float64", message, stamp - ARRIVAL)  # no header: arrival counts

    def joints(self, stamp: int, s: dict[str, float]) -> None:
        message = self.store.types["sensor_msgs/msg/JointState"](
            header=self.header(stamp),
            name=["front", "rear"],
            position=np.zeros(2),
            velocity=np.array([s["omega_f"], s["omega_r"]]),
            effort=np.zeros(2),
        )
        self.add("/joints", "sensor_msgs/msg/JointState", message, stamp)


def record(path: Path, ros: int, order: tuple[int, ...] = tuple(range(200))) -> Path:
    """2 s: IMU 100 Hz, joints 50 Hz, steering 20 Hz, odometry 10 Hz."""
    recording = Recording(path, ros)
    for i in order:
        stamp, s = START + 10_000_000 * i, signals(0.01 * i)
        recording.imu(stamp, s)
        for every, write in ((2, recording.joints), (5, recording.steer), (10, recording.odometry)):
            if i % every == 0:
                write(stamp, s)
    recording.writer.close()
    return path


def describe(path: Path, **changes: object) -> None:
    text = yaml.safe_dump(DESCRIPTION | changes, sort_keys=False)
    base = path.with_suffix("") if path.is_file() else path
    base.with_name(base.name + ".yaml").write_text(text)


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("bags")
    paths = {1: record(folder / "one.bag", 1), 2: record(folder / "two", 2)}
    for path in paths.values():
        describe(path)
    return paths


@pytest.mark.parametrize("ros", [1, 2])
def test_every_channel_of_a_bag_is_what_was_driven_and_nothing_is_resampled(ros, bags):
    log = read_log(bags[ros])
    rates = {"a_x": 200, "pitch_rate": 200, "omega_f": 100, "omega_r": 100, "steer": 40, "x": 20, "yaw": 20}
    for name, count in rates.items():
        t, values = log.samples(name)
        assert len(t) == count
        np.testing.assert_allclose(values, [signals(one)[name] for one in t], atol=1e-6)
    assert set(log.channels) == set(signals(0.0))
    assert log.t[0] == 0.0
    np.testing.assert_allclose(np.diff(log.t), 0.01, atol=1e-9)
    assert quality(log).duration == pytest.approx(1.99)


def test_both_generations_of_ros_give_one_log(bags):
    one, two = read_log(bags[1]), read_log(bags[2])
    assert np.array_equal(one.t, two.t)
    for name, values in one.channels.items():
        assert np.array_equal(values, two.channels[name], equal_nan=True)
    assert one.hash != two.hash  # other bytes


def test_the_clock_of_the_recorder_can_be_asked_for(bags, tmp_path):
    path = Path(shutil.copy(bags[1], tmp_path / "one.bag"))
    describe(path, clock="bag")
    # By arrival the steering, which has no header, comes 3 ms before the IMU of the same moment.
    log = read_log(path)
    offset = log.samples("a_x")[0][0] - log.samples("steer")[0][0]
    assert offset == pytest.approx(0.003, abs=1e-9)


@pytest.mark.parametrize(
    ("topics", "words"),
    [
        ({"imu": "/imu"}, ["line", "/imu", "did you mean /imu/data?"]),
        ({"steer": "/steer angle"}, ["/steer, message 1", "'angle'", "data"]),
        ({"omega_f": "/joints velocity[7]"}, ["/joints, message 1", "out of range"]),
        ({"omega_f": "/joints name[0]"}, ["/joints, message 1", "no number"]),
        ({"steering": "/steer data"}, ["line", "topics.steering", "'steer'"]),
        ({"t": "/steer data"}, ["topics.t"]),
        ({"steer": "/steer"}, ["topics.steer", "field"]),
        ({"steer": {"topic": "/steer", "field": "data", "factor": 0.0}}, ["topics.steer"]),
        ({"yaw_rate": "/steer data"}, ["'yaw_rate'", "two sources"]),
    ],
)
def test_a_wrong_topic_mapping_gets_one_sentence(topics, words, bags, tmp_path):
    path = Path(shutil.copy(bags[1], tmp_path / "one.bag"))
    describe(path, topics=TOPICS | topics)
    with pytest.raises(DataError) as caught:
        read_log(path)
    for word in words:
        assert word in str(caught.value)


def test_a_bag_without_topics_in_its_description_is_refused(bags, tmp_path):
    path = Path(shutil.copy(bags[1], tmp_path / "one.bag"))
    (tmp_path / "one.yaml").write_text("model: full\n")
    with pytest.raises(DataError, match="topics is missing"):
        read_log(path)


def test_messages_written_out_of_order_come_by_their_time(tmp_path):
    path = record(tmp_path / "odd.bag", 1, order=(0, 1, 2, 4, 3, 5))
    describe(path)
    log = read_log(path)
    np.testing.assert_allclose(log.channels["a_x"], 0.1 + 0.01 * np.arange(6), atol=1e-9)


def test_a_clock_that_jumps_back_is_refused_with_topic_and_number(tmp_path):
    path = tmp_path / "jump.bag"
    recording = Recording(path, 1)
    for i, stamp in enumerate((0, 10, 20, 15, 30)):
        message_stamp = START + stamp * 1_000_000
        types = recording.store.types
        vector = types["geometry_msgs/msg/Vector3"]
        message = types["geometry_msgs/msg/Vector3Stamped"](
            header=recording.header(message_stamp), vector=vector(x=0.1, y=0.0, z=0.0)
        )
        arrival = START + 10_000_000 * i
        recording.add("/steer", "geometry_msgs/msg/Vector3Stamped", message, arrival)
    recording.writer.close()
    describe(path, topics={"steer": "/steer vector.x"})
    with pytest.raises(DataError, match=r"jump\.bag, topic /steer, message 4: time must increase"):
        read_log(path)


def test_messages_out_of_order_are_sorted_where_the_yaml_says_so(tmp_path):
    path = tmp_path / "run.bag"
    recording = Recording(path, 1)
    vector = recording.store.types["geometry_msgs/msg/Vector3"]
    stamped = recording.store.types["geometry_msgs/msg/Vector3Stamped"]
    for i, stamp in enumerate((0, 10, 30, 20, 20, 40)):
        header = recording.header(START + stamp * 1_000_000)
        message = stamped(header=header, vector=vector(x=0.01 * i, y=0.3, z=9.81))
        recording.add("/mixed", "geometry_msgs/msg/Vector3Stamped", message, START + 10_000_000 * i)
    recording.writer.close()
    topics = {
        name: f"/mixed vector.{axis}" for name, axis in (("steer", "x"), ("yaw_rate", "y"), ("omega_r", "z"))
    }
    describe(path, topics=topics, time={"order": "sort", "repeated": "merge"})
    assert read_log(path).channels["steer"].tolist() == [0.0, 0.01, 0.03, 0.02, 0.05]


def test_a_log_goes_through_an_mcap_file_unchanged(tmp_path):
    names = {name: name for name in drive() if name not in ("yaw", "omega_left", "omega_right")}
    log = read_log(write_foreign(tmp_path, Foreign(names=names)))
    back = read_log(write_log(tmp_path / "copy.mcap", log))
    assert set(back.channels) == set(log.channels)
    assert all(np.array_equal(back.channels[name], values) for name, values in log.channels.items())
    assert np.allclose(back.t, log.t, atol=1e-9)


def test_an_axis_that_is_sampled_less_often_costs_no_sample_of_the_others(tmp_path):
    names = {name: name for name in drive() if name not in ("yaw", "omega_left", "omega_right")}
    log = read_log(write_foreign(tmp_path, Foreign(names=names)))
    slow = log.channels["yaw_rate"].copy()
    slow[1::2] = np.nan
    mixed = replace(log, channels={**log.channels, "yaw_rate": slow})
    back = read_log(write_log(tmp_path / "copy.mcap", mixed))
    for name, values in mixed.channels.items():
        np.testing.assert_array_equal(back.channels[name], values, err_msg=name)


def test_the_topics_of_an_mcap_file_are_proposed(tmp_path):
    names = {name: name for name in drive() if name not in ("yaw", "omega_left", "omega_right")}
    path = write_log(tmp_path / "copy.mcap", read_log(write_foreign(tmp_path, Foreign(names=names))))
    settings = path.with_suffix(".yaml")
    text = settings.read_text().partition("topics:")[0]
    settings.write_text(text)
    report = check_log(path)
    assert {"topics.imu", "topics.steer", "topics.torque_f"} <= {line.key for line in report.lines}
    settings.write_text(with_lines(text, report.lines))
    assert np.allclose(read_log(path).channels["steer"], drive()["steer"], atol=1e-8)
    assert not quality(read_log(path)).problems


def test_what_is_no_mcap_file_gets_one_sentence(tmp_path):
    path = tmp_path / "bad.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(range(200)))
    describe(path)
    with pytest.raises(DataError, match=r"bad\.mcap: cannot be read as a ROS bag"):
        read_log(path)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_a_damaged_bag_gets_one_sentence(share, bags, tmp_path):
    content = bags[1].read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(content[: int(share * len(content))])
    describe(path)
    with pytest.raises(DataError, match=r"cut\.bag: cannot be read as a ROS bag"):
        read_log(path)


@pytest.mark.parametrize("file", ["metadata.yaml", "two.db3"])
def test_a_damaged_ros_2_bag_gets_one_sentence(file, bags, tmp_path):
    path = Path(shutil.copytree(bags[2], tmp_path / "two"))
    describe(path)
    (path / file).write_bytes((path / file).read_bytes()[:40])
    with pytest.raises(DataError, match="two: cannot be read as a ROS bag"):
        read_log(path)
