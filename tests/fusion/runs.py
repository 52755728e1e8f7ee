"""Filters of several kinds and messages for them, with late, repeated and bad ones among them, cut anywhere."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from tests.fusion.setups import make_plan
from tests.logs import Topic, fix, imu, messages_of, odometry, position, static_transform

from fuselog.fusion import Command, Filter, Outputs, Plan, Track
from fuselog.fusion.filter import Beside, Order
from fuselog.schemas import Messages

MS, SECOND, BEGIN = 1_000_000, 1_000_000_000, 1_700_000_000_000_000_000
POINT = {
    "model": {"name": "constant_velocity", "process_noise": {"ax": 0.7, "ay": 0.4}},
    "lag": {"window": "300 ms"},
    "sensors": {
        "one": {"topic": "/one", "fuse": ["x", "y"], "gate": 0.99},
        "two": {"topic": "/two", "fuse": ["x", "y"]},
    },
}
RATES = ["roll_rate", "pitch_rate", "yaw_rate"]


class Case(NamedTuple):
    """A configuration, and the topics of a drive of some seconds."""

    config: dict[str, Any]
    topics: Callable[[np.random.Generator], list[Topic]]


def merged(config: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A configuration with keys of it, and of its sensors, replaced."""
    sensors = {
        name: settings | changes.get("sensors", {}).get(name, {}) for name, settings in config["sensors"].items()
    }
    return config | changes | {"sensors": sensors}


def stamps(rng: np.random.Generator, period_ms: float, seconds: float = 3.0) -> np.ndarray:
    """Stamps of a sensor of this period that is not exact, after the begin."""
    n = int(seconds * 1000 / period_ms)
    return BEGIN + ((np.arange(n) + 1) * period_ms * MS + rng.integers(0, MS, n)).astype(np.int64)


def late(rng: np.random.Generator, t_ns: np.ndarray, most_ms: int = 400) -> np.ndarray:
    """Times of arrival: most soon, some late, and some later than a window of 300 ms."""
    return t_ns + rng.choice([1, 2, 5, most_ms // 4, most_ms], len(t_ns), p=[0.4, 0.3, 0.15, 0.1, 0.05]) * MS


def points(rng: np.random.Generator) -> list[Topic]:
    topics = []
    for topic, period in (("/one", 20), ("/two", 37)):
        t_ns = stamps(rng, period)
        x = 0.5 * (t_ns - BEGIN) * 1e-9 + rng.normal(size=len(t_ns)) * 0.1
        x[rng.integers(0, len(x), 3)] += 40.0
        x[rng.integers(0, len(x), 2)] = np.nan
        topics.append(
            position(t_ns, x=x, y=rng.normal(size=len(t_ns)) * 0.1, topic=topic)._replace(arrival_ns=late(rng, t_ns))
        )
    return [
        *topics,
        topics[0]._replace(
            t_ns=topics[0].t_ns[:9],
            arrival_ns=topics[0].arrival_ns[:9] + MS,
            fields={k: v[:9] if np.ndim(v) and len(v) > 9 else v for k, v in topics[0].fields.items()},
        ),
    ]


def body(rng: np.random.Generator) -> list[Topic]:
    t_ns, slow = stamps(rng, 10), stamps(rng, 50)
    rate = rng.normal(size=(len(t_ns), 3)) * 0.1
    told = static_transform(
        [BEGIN + 400 * MS], parent="base_link", child="imu_link", xyz=[0.1, 0.2, 0.3], xyzw=[0, 0, 0, 1]
    )
    return [
        imu(t_ns, rate=rate, frame="imu_link", arrival_ns=late(rng, t_ns)),
        odometry(slow, speed=rng.normal(size=len(slow)) * 0.1 + 1.0)._replace(arrival_ns=late(rng, slow)),
        told,
    ]


def turning(rng: np.random.Generator) -> list[Topic]:
    t_ns, slow = stamps(rng, 10), stamps(rng, 40)
    field = np.array([20e-6, 5e-6, -40e-6]) * rng.uniform(0.93, 1.2, (len(slow), 1))
    return [
        imu(t_ns, rate=rng.normal(size=(len(t_ns), 3)) * 0.1, arrival_ns=late(rng, t_ns)),
        Topic("/mag", "sensor_msgs/msg/MagneticField", slow, {"magnetic_field": field}, arrival_ns=late(rng, slow)),
    ]


def abroad(rng: np.random.Generator) -> list[Topic]:
    t_ns, slow = stamps(rng, 20), stamps(rng, 200)
    geodetic = np.array([55.0, 37.0, 150.0]) + rng.normal(size=(len(slow), 3)) * [1e-6, 1e-6, 0.1]
    return [
        odometry(t_ns, speed=1.0 + rng.normal(size=len(t_ns)) * 0.1, yaw_rate=0.1)._replace(arrival_ns=late(rng, t_ns)),
        fix(slow, geodetic=geodetic)._replace(arrival_ns=late(rng, slow)),
    ]


CASES: dict[str, Case] = {
    "point": Case(POINT, points),
    "smoothed": Case(
        merged(POINT, smooth={"lag": 0.5, "rate": 20}, output={"ticks": 50, "settled": True, "rate": 25}), points
    ),
    "careful": Case(
        merged(
            POINT,
            model={"name": "constant_velocity", "adapt": {}},
            smooth={"lag": 0.5, "rate": 20},
            sensors={
                "one": {"adapt": {}, "gate_recovery": {"samples": 3}},
                "two": {"robust": {"kind": "huber"}, "enabled": True},
            },
        ),
        points,
    ),
    "cycles": Case(
        merged(
            POINT,
            gain={
                "mode": "fixed",
                "weights": {"one.x": 0.4, "one.y": 0.4, "two.x": 0.3, "two.y": 0.3},
                "cycle": {"period": 0.1, "missing": "renormalize"},
            },
            output={"ticks": 20, "settled": True},
        ),
        points,
    ),
    "body": Case(
        {
            "model": {"name": "omni3d"},
            "lag": {"window": "300 ms"},
            "sensors": {
                "imu": {"topic": "/imu", "fuse": ["roll", "pitch", "yaw", *RATES], "mount": "from_tf", "gate": 0.999},
                "wheel": {"topic": "/odom", "fuse": ["vx", "yaw_rate"]},
            },
            "output": {"ticks": 30},
        },
        body,
    ),
    "turning": Case(
        {
            "model": {"name": "attitude"},
            "lag": {"window": "300 ms"},
            "initial": {"state": {"roll": 0.0, "pitch": 0.0}},
            "sensors": {
                "gyro": {"topic": "/imu", "kind": "input", "noise": dict.fromkeys(RATES, 1e-3)},
                "compass": {"topic": "/mag", "kind": "magnetometer", "noise": {"heading": 0.1}, "field": {}},
            },
        },
        turning,
    ),
    "abroad": Case(
        {
            "model": {"name": "unicycle"},
            "lag": {"window": "300 ms"},
            "sensors": {
                "wheel": {"topic": "/odom", "fuse": ["v", "yaw_rate"]},
                "gps": {"topic": "/fix", "fuse": ["x", "y"]},
            },
            "initial": {"state": {"yaw": 0.1}},
        },
        abroad,
    ),
}


@cache
def plan_of(name: str) -> Plan:
    return make_plan(CASES[name].config)


def drive(name: str, seed: int = 0) -> tuple[list[Topic], Messages]:
    """The topics of a case, and their messages by arrival."""
    topics = CASES[name].topics(np.random.default_rng(seed))
    return topics, messages_of(topics)


def opened(name: str, topics: Sequence[Topic], order: Order, plan: Plan | None = None) -> Filter:
    """A filter of a case with its streams open."""
    filter = Filter(plan or plan_of(name), order=order, compare=True)
    for number, topic in enumerate(topics, start=1):
        filter.intake.open(number, topic.stream)
    return filter


def pieces(messages: Messages, cuts: Sequence[int]) -> Iterator[Messages]:
    for first, last in pairwise(sorted({0, *cuts, len(messages)})):
        yield messages.take(slice(first, last))


class Written:
    """Everything that a filter gives, as the bytes of each output topic."""

    def __init__(self, plan: Plan) -> None:
        self.outputs = Outputs(plan)
        self.bytes = {output.topic: bytearray() for output in self.outputs.topics}

    def add(self, track: Track, beside: Beside) -> None:
        self._add(self.outputs.encode(track, beside))

    def finish(self) -> dict[str, bytes]:
        self._add(self.outputs.finish())
        return {topic: bytes(data) for topic, data in self.bytes.items()}

    def _add(self, encoded: Messages) -> None:
        for stream, start, length in zip(encoded.stream, encoded.start, encoded.length, strict=True):
            self.bytes[self.outputs.topics[stream].topic] += encoded.data[start : start + length].tobytes()


def remembered(filter: Filter) -> tuple[Any, ...]:
    """Estimate, ledger, and what was learned."""
    newest = filter.estimate
    learned = [np.asarray(getattr(newest.learned, column.name)).tobytes() for column in fields(newest.learned)]
    state = newest.x.tobytes(), newest.P.tobytes(), newest.known.tobytes(), newest.t_ns, newest.resets
    return (*state, *learned, filter.ledger, filter.optimality_ratio)


Commands = dict[int, Command]  # by how many messages came before


def run(filter: Filter, messages: Messages, cuts: Sequence[int], commands: Commands, written: Written) -> None:
    """Feed messages and commands at their places, and write what the filter gives."""
    at = 0
    for piece in pieces(messages, [*cuts, *commands]):
        if at in commands:
            written.add(filter.command(commands[at]), filter.beside())
        written.add(filter.feed(piece), filter.beside())
        at += len(piece)
