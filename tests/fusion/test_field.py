"""Magnetometers near iron: samples whose field is not the Earth's are refused, or trusted less, however they come."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from tests.fusion.setups import make_plan
from tests.logs import Topic, messages_of

from fuselog.fusion import Decision, Filter, Plan
from fuselog.fusion.events import Events, join
from fuselog.fusion.intake import Intake
from fuselog.schemas import ConfigError

SECOND, MS = 1_000_000_000, 1_000_000
EARTH = 48e-6  # T
STRENGTHS = np.array([1.0, 1.02, 0.98, 1.5, 0.7, 1.05, 0.95, 1.12, 0.88]) * EARTH


def plan_of(field: Any) -> Plan:
    compass = {"topic": "/mag", "kind": "magnetometer", "noise": {"heading": 0.1}, "field": field}
    gyro = {"topic": "/imu", "kind": "input", "noise": dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate"), 1e-3)}
    start = {"state": {"roll": 0.0, "pitch": 0.0}}
    return make_plan({"model": {"name": "attitude"}, "initial": start, "sensors": {"gyro": gyro, "compass": compass}})


def mag(t_ns: Any, strengths: np.ndarray) -> Topic:
    direction = np.random.default_rng(2).normal(size=(len(strengths), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Topic("/mag", "sensor_msgs/msg/MagneticField", t_ns, {"magnetic_field": direction * strengths[:, None]})


def taken(field: Any, topic: Topic, cuts: tuple[int, ...] = ()) -> Events:
    intake = Intake(plan_of(field))
    intake.open(1, topic.stream)
    messages = messages_of([topic])
    names = ("stream", "start", "length", "log_time", "publish_time", "sequence")
    parts = []
    for first, last in pairwise((0, *cuts, len(messages))):
        columns = {name: getattr(messages, name)[first:last] for name in names}
        parts.append(intake.take(type(messages)(data=messages.data, **columns)).events)
    return join(parts)


def gated(events: Events) -> list[int]:
    return np.flatnonzero(events.fault == Decision.GATED).tolist()


def test_a_known_field() -> None:
    topic = mag(SECOND + MS * np.arange(9), STRENGTHS)
    assert gated(taken({"strength": EARTH}, topic)) == [3, 4, 7, 8]
    assert gated(taken({"strength": EARTH, "tolerance": 0.04}, topic)) == [3, 4, 5, 6, 7, 8]
    assert gated(taken(None, topic)) == []


def test_a_field_trusted_less() -> None:
    events = taken({"strength": EARTH, "disturbed": 5}, mag(SECOND + MS * np.arange(9), STRENGTHS))
    assert gated(events) == []
    sd = np.sqrt(events.R[:, 0])
    assert sd == pytest.approx([0.1, 0.1, 0.1, 0.5, 0.5, 0.1, 0.1, 0.5, 0.5])


def test_the_first_second_says_how_strong_the_field_is() -> None:
    """Its mean, of what passes unjudged; the same however messages are cut into batches."""
    t_ns = SECOND + 400 * MS * np.arange(9)
    strengths = np.array([0.9, 1.0, 1.1, 1.0, 1.11, 0.89, 1.09, 0.91, 2.0]) * EARTH
    topic = mag(t_ns, strengths)
    events = taken({}, topic)
    assert gated(events) == [4, 5, 8]
    for cuts in ((1, 2, 3, 4, 5, 6, 7, 8), (2, 3)):
        for one, other in zip(events, taken({}, topic, cuts), strict=True):
            assert one.tobytes() == other.tobytes()


def test_a_refused_sample_is_counted_as_gated_and_moves_nothing() -> None:
    filter = Filter(plan_of({"strength": EARTH}), order="as_received")
    topic = mag(SECOND + MS * np.arange(9), STRENGTHS)
    filter.intake.open(1, topic.stream)
    track = filter.feed(messages_of([topic]))
    account = filter.ledger["compass"]
    assert (account.received, account.fused, account.gated) == (9, 5, 4)
    refused = track.decision == Decision.GATED
    assert (track.dof[refused] == 0).all()
    assert np.array_equal(track.x[4], track.x[2])


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ({"strength": "strong"}, "sensors.compass.field.strength: input should be"),
        ({"disturbed": 0.5}, "sensors.compass.field.disturbed: input should be"),
        ({"strenght": 1}, r"sensors.compass.field.strenght: unknown key \(did you mean strength\?\)"),
    ],
)
def test_mistakes_have_a_place(field: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected) as caught:
        plan_of(field)
    assert len(caught.value.problems) == 1
