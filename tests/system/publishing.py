"""Samples with numbers, published on Zenoh as drivers do it, and what a filter makes of them without a network."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import zenoh

from fuselog.fusion import Filter, Order, Plan, Stream
from fuselog.schemas import CdrEncoder, Messages, definition, pack
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

from .conftest import EPOCH

IMU, ODOMETRY, POSE = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
SOURCE = b"sixteen bytes id"

T = TypeVar("T")


class Sent(NamedTuple):
    """A sample: its key, type, payload, and the time (ns) and number that its publisher gives it."""

    key: str
    kind: str
    payload: bytes
    t_ns: int
    number: int


def samples(
    key: str, kind: str, fields: Sequence[str], times: Iterable[float], values: Iterable[float | Sequence[float]]
) -> list[Sent]:
    """Samples with stamps ``times`` (s since ``EPOCH``), numbered from 1."""
    encoder = CdrEncoder(kind, definition(kind), columns=fields)
    made: list[Sent] = []
    for number, (t, value) in enumerate(zip(times, values, strict=True), start=1):
        stamp = EPOCH + round(t * 1e9)
        payload, _ = encoder.encode(np.array([stamp]), np.atleast_1d(np.asarray(value, float)).reshape(1, -1))
        made.append(Sent(key, kind, payload.tobytes(), stamp, number))
    return made


def drive(prefix: str, *, first: float = 0.0, seconds: float) -> list[Sent]:
    """A robot with a gyro (100 Hz) and wheels (20 Hz), in the order of stamps."""
    n = round(seconds * 100)
    turn, speed = first + np.arange(n) * 0.01, first + np.arange(n // 5) * 0.05 + 0.003
    gyro = samples(f"{prefix}imu/data", IMU, ["angular_velocity.z"], turn, 0.3 + 0.02 * np.sin(7 * turn))
    wheels = samples(f"{prefix}odom", ODOMETRY, ["twist.twist.linear.x"], speed, 1 + 0.05 * np.cos(3 * speed))
    return sorted(gyro + wheels, key=lambda each: each.t_ns)


class Sender:
    """Publishes samples on a session; a new ``source`` is a new publisher to whoever listens."""

    def __init__(self, session: zenoh.Session, source: bytes = SOURCE) -> None:
        self._session, self._source = session, source
        self._publishers: dict[tuple[str, str], Publisher] = {}

    def send(self, sent: Iterable[Sent], *, every_s: float = 0.0) -> None:
        """Publish these, one after the other."""
        for each in sent:
            tag = Tag(each.number, each.t_ns, self._source)
            self.publisher(each.key, each.kind).put(each.payload, write_tag(tag))
            if every_s:
                time.sleep(every_s)

    def publisher(self, key: str, kind: str) -> Publisher:
        """Of samples of this type on this key."""
        if (key, kind) not in self._publishers:
            self._publishers[key, kind] = Publisher(self._session, key, media_type("cdr", kind))
        return self._publishers[key, kind]

    def meet(self, sent: Iterable[Sent]) -> None:
        """Wait until somebody subscribes to all their keys."""
        publishers = [self.publisher(key, kind) for key, kind in {(each.key, each.kind) for each in sent}]
        until(lambda: all(publisher.wanted for publisher in publishers), bool)


def fused(plan: Plan, sent: Sequence[Sent], *, order: Order = "as_received") -> Filter:
    """A filter that has taken these, in this order."""
    filter = Filter(plan, order=order, compare=True)
    kinds = {each.key: each.kind for each in sent}
    for number, (key, kind) in enumerate(kinds.items()):
        text = definition(kind)
        stream = Stream(topic=key, encoding="cdr", schema_name=kind, schema_encoding="ros2msg", schema_text=text)
        filter.intake.open(number, stream)
    numbers = {key: number for number, key in enumerate(kinds)}
    data, start, length = pack([each.payload for each in sent])
    times = np.array([each.t_ns for each in sent])
    filter.feed(
        Messages(
            stream=np.array([numbers[each.key] for each in sent], np.int32),
            data=data,
            start=start,
            length=length,
            log_time=times,
            publish_time=times,
            sequence=np.array([each.number for each in sent]),
        )
    )
    return filter


def until(look: Callable[[], T], done: Callable[[T], bool], *, within_s: float = 10.0) -> T:
    """What ``look`` shows as soon as that is ``done``, or when the time is over."""
    end = time.monotonic() + within_s
    while not done(seen := look()) and time.monotonic() < end:
        time.sleep(0.02)
    return seen
