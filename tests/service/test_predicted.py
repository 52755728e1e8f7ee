"""The stream ``.../now``: what the state will have become by the time of the machine's clock."""

import socket
import threading
import time

import numpy as np
import pytest
import zenoh

from fuselog.fusion import compile_plan, parse_config
from fuselog.schemas import CdrEncoder, compile_codec, definition, pack
from fuselog.service.live.fleet import Fleet
from fuselog.service.live.group import make_group
from fuselog.service.rest.answers import health_plain
from fuselog.service.transport import Endpoints, open_session
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

from .conftest import KIND
from .test_fleet import until

ESTIMATE = "fuselog_msgs/msg/Estimate"
SPEED, RATE, SECOND = 2.0, 50.0, 1_000_000_000
CONFIG = f"""\
fuselog: 1
model: {{name: constant_velocity}}
initial: {{state: {{vx: {SPEED}, vy: 0}}, sd: {{vx: 0.01, vy: 0.01}}}}
lag: {{max_step: 1 s}}
sensors:
  gps: {{topic: gps, type: {KIND}, fuse: [x, y], noise: {{x: 0.01, y: 0.01}}}}
output: {{now: {RATE}}}
"""
ENCODER = CdrEncoder(KIND, definition(KIND), columns=["pose.position.x", "pose.position.y"])
CODEC = compile_codec(
    encoding="cdr",
    schema_encoding="ros2msg",
    schema_name=ESTIMATE,
    schema_text=definition(ESTIMATE),
    fields=["state[0]", "covariance[0]"],
    stamp="header.stamp",
)


class Robot:
    """A service, and a target that sends where it is and collects what the service predicts."""

    def __init__(self, fleet: Fleet, session: zenoh.Session) -> None:
        self.fleet, self.session = fleet, session
        self.predicted: list[bytes] = []
        session.declare_subscriber("fused/odom/now", lambda sample: self.predicted.append(sample.payload.to_bytes()))

    def send(self, number: int, stamp: int, x: float) -> None:
        payload = ENCODER.encode(np.array([stamp]), np.array([[x, 0.0]]))[0].tobytes()
        tag = write_tag(Tag(number, stamp, b"sixteen bytes id"))
        self.session.put("gps", payload, encoding=media_type("cdr", KIND), attachment=tag)

    def health(self) -> dict:
        return health_plain(self.fleet.snapshots()["filter"])


@pytest.fixture
def robot():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    here, there = Endpoints(listen=[endpoint]), Endpoints(mode="client", connect=[endpoint])
    with open_session(here, timeout_s=10) as service, open_session(there, timeout_s=10) as session:
        plan = compile_plan(*parse_config(CONFIG, name="robot.yaml"))
        fleet = Fleet([make_group(plan)], service, ended=threading.Event().set)
        robot = Robot(fleet, session)
        publisher = Publisher(session, "gps", media_type("cdr", KIND))
        assert until(lambda: publisher.wanted)
        yield robot
        fleet.finish()


def test_between_samples_the_state_goes_on(robot: Robot) -> None:
    """A sample each 0.2 s, predictions at 50 Hz on the line between, less sure the older the last sample is."""
    begin = time.time_ns()
    for number in range(5):
        stamp = time.time_ns()
        robot.send(number + 1, stamp, SPEED * (stamp - begin) / SECOND)
        time.sleep(0.2)
    data, start, length = pack(robot.predicted)
    columns = CODEC.decode(data, start, length)
    assert len(columns) > 0.5 * RATE
    at = (columns.t_ns - begin) / SECOND
    assert np.all(np.diff(at) > 0)
    assert np.max(np.abs(columns["state[0]"] - SPEED * at)) < 0.05
    assert columns["covariance[0]"].max() > 1.5 * columns["covariance[0]"].min()
    assert not any("now" in reason for reason in robot.health()["reasons"])


def test_stamps_of_another_clock(robot: Robot) -> None:
    """An hour ago is too far to predict from: nothing is published, and the health says why."""
    robot.send(1, time.time_ns() - 3600 * SECOND, 0.0)
    reasons = until(lambda: [reason for reason in robot.health()["reasons"] if ".../now" in reason], bool)
    assert "no estimate at" in reasons[0]
    assert robot.health()["status"] != "healthy"
    assert robot.predicted == []
