"""Messages and logs made of numbers: what sensors send, encoded as they would."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuselog.fusion import Stream
from fuselog.replay import LogWriter
from fuselog.schemas import CdrEncoder, Messages, definition


class Topic(NamedTuple):
    """n messages of one topic: a column of numbers for every named field."""

    topic: str
    type: str
    t_ns: Any  # (n,) stamps
    fields: Mapping[str, Any]  # path: (n,), (n, width) or one value for all
    frame: str = "base_link"
    arrival_ns: Any = None  # (n,) log times; the stamps when None
    constants: Mapping[str, str] = {}  # more strings
    lengths: Mapping[str, int] = {}  # of sequences
    stamp: str | None = "header.stamp"

    @property
    def stream(self) -> Stream:
        return Stream(
            topic=self.topic,
            encoding="cdr",
            schema_name=self.type,
            schema_encoding="ros2msg",
            schema_text=definition(self.type),
        )

    def encode(self) -> tuple[np.ndarray, int]:
        """The payloads one after the other, and the size of each."""
        t_ns = np.asarray(self.t_ns, np.int64)
        columns = [_column(values, len(t_ns)) for values in self.fields.values()]
        frame = {} if self.stamp is None else {self.stamp.replace("stamp", "frame_id"): self.frame}
        encoder = CdrEncoder(
            self.type,
            definition(self.type),
            columns=list(self.fields),
            constants={**frame, **self.constants},
            lengths=self.lengths,
            stamp=self.stamp,
        )
        return encoder.encode(t_ns, np.concatenate(columns, axis=1))


def _column(values: Any, n: int) -> np.ndarray:
    """(n, width) of a value for all, a value each, or a row each."""
    array = np.asarray(values, float)
    array = array.reshape(len(array), math.prod(array.shape[1:])) if array.ndim else array.reshape(1, 1)
    return np.broadcast_to(array, (n, array.shape[1]))


def messages_of(topics: Sequence[Topic]) -> Messages:
    """The messages of all topics by arrival; streams are numbered from 1 in the order of the topics."""
    blocks, parts = [topic.encode() for topic in topics], []
    offset = 0
    for number, (topic, (data, size)) in enumerate(zip(topics, blocks, strict=True), start=1):
        n = len(topic.t_ns)
        arrival = topic.t_ns if topic.arrival_ns is None else topic.arrival_ns
        start = offset + size * np.arange(n)
        offset += len(data)
        parts.append((np.full(n, number, np.int32), start, np.full(n, size), np.asarray(arrival, np.int64)))
    stream, start, length, arrival = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = np.argsort(arrival, kind="stable")
    return Messages(
        stream=stream[order],
        data=np.concatenate([data for data, _ in blocks]),
        start=start[order].astype(np.int64),
        length=length[order].astype(np.int64),
        log_time=arrival[order],
        publish_time=arrival[order],
        sequence=np.arange(len(order)),
    )


def write_log(path: Path, topics: Sequence[Topic], *, compression: str = "zstd", chunk_bytes: int = 1 << 14) -> Path:
    """An MCAP log of the topics, in arrival order."""
    with LogWriter(path, compression=compression, chunk_bytes=chunk_bytes) as writer:
        for topic in topics:
            writer.add_channel(topic.topic, topic.type, "ros2msg", definition(topic.type))
        writer.write(messages_of(topics))
    return path


def imu(
    t_ns: Any,
    *,
    orientation: Any = (0.0, 0.0, 0.0, 1.0),
    rate: Any = (0.0, 0.0, 0.0),
    force: Any = (0.0, 0.0, 9.80665),
    covariances: Any = (0.01, 0.02, 0.03),
    topic: str = "/imu",
    **options: Any,
) -> Topic:
    """sensor_msgs/Imu; each covariance a variance of all three, or nine numbers."""
    names = ("orientation", "angular_velocity", "linear_acceleration")
    fields: dict[str, Any] = {}
    for name, values, covariance in zip(names, (orientation, rate, force), covariances, strict=True):
        fields[name] = np.atleast_2d(values)
        matrix = np.eye(3) * covariance if np.ndim(covariance) == 0 else np.asarray(covariance, float)
        fields[f"{name}_covariance"] = matrix.reshape(1, 9)
    return Topic(topic, "sensor_msgs/msg/Imu", t_ns, fields, **options)


def odometry(t_ns: Any, *, speed: Any, yaw_rate: Any = 0.0, variance: float = 0.01, topic: str = "/odom") -> Topic:
    """nav_msgs/Odometry with a twist only."""
    fields = {
        "pose.pose.orientation.w": 1.0,
        "twist.twist.linear.x": speed,
        "twist.twist.angular.z": yaw_rate,
        "twist.covariance": (np.eye(6) * variance).reshape(1, 36),
    }
    return Topic(topic, "nav_msgs/msg/Odometry", t_ns, fields)


def position(t_ns: Any, *, x: Any, y: Any, variance: float = 0.01, topic: str = "/position") -> Topic:
    """geometry_msgs/PoseWithCovarianceStamped with a position only."""
    fields = {
        "pose.pose.position.x": x,
        "pose.pose.position.y": y,
        "pose.pose.orientation.w": 1.0,
        "pose.covariance": (np.eye(6) * variance).reshape(1, 36),
    }
    return Topic(topic, "geometry_msgs/msg/PoseWithCovarianceStamped", t_ns, fields)


def fix(t_ns: Any, *, geodetic: Any, covariance: Any = 1.0, topic: str = "/fix") -> Topic:
    """sensor_msgs/NavSatFix: latitude, longitude in degrees, altitude in m."""
    geodetic = np.atleast_2d(geodetic)
    matrix = np.eye(3) * covariance if np.ndim(covariance) == 0 else np.asarray(covariance, float)
    fields = {name: geodetic[:, i] for i, name in enumerate(("latitude", "longitude", "altitude"))}
    fields["position_covariance"] = matrix.reshape(1, 9)
    return Topic(topic, "sensor_msgs/msg/NavSatFix", t_ns, fields)


def static_transform(t_ns: Any, *, parent: str, child: str, xyz: Any, xyzw: Any) -> Topic:
    """tf2_msgs/TFMessage with one transform: parent_from_child."""
    fields = {
        "transforms[0].transform.translation": np.atleast_2d(xyz),
        "transforms[0].transform.rotation": np.atleast_2d(xyzw),
    }
    return Topic(
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        t_ns,
        fields,
        frame=parent,
        constants={"transforms[0].child_frame_id": child},
        lengths={"transforms": 1},
        stamp="transforms[0].header.stamp",
    )
