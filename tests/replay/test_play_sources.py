"""Logs as sources: begun anywhere, in each order, several as one, and what latched topics said before."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.logs import imu, messages_of, static_transform, write_log

from fuselog.replay import LogWriter, open_log
from fuselog.replay.play import (
    LogSource,
    Playback,
    Played,
    Range,
    Source,
    StampedSource,
    Timeline,
    header_stamps,
    playable,
    publish_times,
)

from .players import S, Time, taken, write

OFFSETS = st.lists(st.floats(0, 5, allow_nan=False), min_size=1, max_size=50).map(sorted)


def numbers(messages: Sequence[Played]) -> list[int]:
    """The payloads."""
    return [int(played.payload) for played in messages]


@settings(max_examples=60, deadline=None)
@given(OFFSETS, st.floats(-1, 6), st.floats(-1, 6), st.data())
def test_begun_anywhere(
    tmp_path_factory: pytest.TempPathFactory, offsets: list[float], begin: float, end: float, data: st.DataObject
) -> None:
    """Log order and publish order: what a sort of all messages gives, cut at start and end."""
    publish = [data.draw(st.sampled_from([t, t - 1, t - 0.001, 3.0])) for t in offsets]
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    write(path, [("/ab"[: 2 + i % 2], t) for i, t in enumerate(offsets)], publish=publish)
    start, stop = round((10 + begin) * S), round((10 + end) * S)
    with open_log(path) as log:
        for times, source in (
            (offsets, LogSource(log, playable(log))),
            (publish, StampedSource(log, playable(log), publish_times)),
        ):
            order = sorted(range(len(times)), key=lambda i: round((10 + times[i]) * S))
            expected = [i for i in order if start <= round((10 + times[i]) * S)]
            assert (source.first, source.last) == (round((10 + min(times)) * S), round((10 + max(times)) * S))
            assert numbers(list(source.begin(start, None))) == expected
            part = list(source.begin(start, stop))
            assert numbers(part) == [i for i in expected if round((10 + times[i]) * S) < stop]
            assert [p.t_ns for p in part] == [round((10 + times[i]) * S) for i in numbers(part)]
            assert [p.log_time for p in part] == [round((10 + offsets[i]) * S) for i in numbers(part)]
        assert log.losses == []


def test_shared_logs(shared: Path, oracle: Callable[[Path], list[tuple[int, int, int, int, bytes]]]) -> None:
    """A real log from its middle on, against another reader."""
    path = shared / "logs" / "rl_test1_husky.mcap"
    with open_log(path) as log:
        channels = playable(log)
        source = LogSource(log, channels)
        middle = (source.first + source.last) // 2
        ids = {channel.id for channel in channels}
        expected = [(row[0], row[4]) for row in oracle(path) if row[0] >= middle and row[2] in ids]
        assert [(p.log_time, p.payload) for p in source.begin(middle, None)] == expected


def test_header_order(tmp_path: Path) -> None:
    """Stamps order what the log has out of order; without a stamp, or one of another clock, the log time counts."""
    t = np.arange(20) * S // 10 + 1000 * S
    late = t + np.where(np.arange(20) % 3 == 0, 3 * S, S // 100)
    topics = [
        imu(t, arrival_ns=late, topic="/late", rate=np.arange(20)[:, None] * [0.0, 0.0, 1.0]),
        imu(t - 900 * S, arrival_ns=late, topic="/near"),
        imu(t - 9000 * S, arrival_ns=late, topic="/boot"),
        imu(np.zeros(20, np.int64), arrival_ns=late, topic="/none"),
        static_transform(t[:1], parent="a", child="b", xyz=[0, 0, 0], xyzw=[0, 0, 0, 1]),
    ]
    path = write_log(tmp_path / "log.mcap", topics, chunk_bytes=2000)
    with open_log(path) as log:
        channels = playable(log)
        source = StampedSource(log, channels, header_stamps(channels))
        played = list(source.begin(source.first, None))
    assert source.by_log_time == {"/boot": 20, "/none": 20, "/tf_static": 1}
    assert [p.t_ns for p in played] == sorted(p.t_ns for p in played)
    assert [p.t_ns for p in played if p.channel.topic == "/late"] == t.tolist()
    assert [p.t_ns for p in played if p.channel.topic == "/near"] == (t - 900 * S).tolist()
    for topic in ("/boot", "/none"):
        assert [p.t_ns for p in played if p.channel.topic == topic] == sorted(late.tolist())


def test_several_logs_as_one(tmp_path: Path) -> None:
    """By time, ties in the order of the logs; each log by itself may begin later."""
    one = write(tmp_path / "one.mcap", [("/a", 0), ("/a", 1), ("/a", 2)])
    two = write(tmp_path / "two.mcap", [("/a", 1), ("/b", 1.5), ("/a", 3)])
    with open_log(two, one) as log:
        source = LogSource(log, playable(log))
        assert (source.first, source.last) == (10 * S, 13 * S)
        assert numbers(list(source.begin(11 * S, 13 * S))) == [0, 1, 1, 2]
        assert numbers(list(source.begin(0, None))) == [0, 0, 1, 1, 2, 2]


def sources(path: Path) -> list[Source]:
    """The log in log order and by publish times, which are the same."""
    log = open_log(path)
    return [LogSource(log, playable(log)), StampedSource(log, playable(log), publish_times)]


def test_latched_topics(tmp_path: Path) -> None:
    """The newest before the moment, once each, in order; a message at the moment itself comes as any other."""
    rows = [("/map", 0), ("/x", 0.1), ("/mode", 1), ("/map", 400), ("/x", 401), ("/mode", 900), ("/x", 1000)]
    for source in sources(write(tmp_path / "log.mcap", rows, latched=["/map", "/mode"])):
        for t, expected in ((0, []), (0.05, [0]), (2, [0, 2]), (400, [0, 2]), (401, [2, 3]), (950, [3, 5])):
            assert numbers(source.latched(round((10 + t) * S))) == expected


def test_played_after_a_jump(tmp_path: Path) -> None:
    """On the timeline: what is latched at once, then the rest; beginning at the start there is nothing to repeat."""
    rows = [("/map", 0), ("/x", 1), ("/x", 2), ("/map", 2), ("/x", 3)]
    for source in sources(write(tmp_path / "log.mcap", rows, latched=["/map"])):
        time = Time()
        play = Playback(source, Timeline(Range(first=10 * S, last=13 * S, start=10 * S), time.clock))
        assert taken(play, time, until=1) == [(0, "0"), (1, "1")]
        play.seek(12 * S + S // 2)
        assert taken(play, time, until=1) == [(1, "3")]
        play.seek(11 * S + S // 2)
        assert taken(play, time) == [(1, "0"), (1.5, "2"), (1.5, "3"), (2.5, "4")]


@pytest.mark.parametrize(
    ("profiles", "held"),
    [
        ("- durability: 1", True),
        ("- durability: transient_local\n  depth: 1", True),
        ("- durability: volatile\n- durability: transient_local", True),
        ("- durability: 2", False),
        ("durability: 1", False),
        ("- [", False),
        ("- 1", False),
        ("", False),
    ],
)
def test_which_are_latched(tmp_path: Path, profiles: str, held: bool) -> None:
    """Durability as rosbag2 of any year writes it; what cannot be read is none."""
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.add_channel("/x", "a/msg/A", "ros2msg", "float64 x", metadata={"offered_qos_profiles": profiles})
    from fuselog.replay.play.latched import is_latched

    with open_log(tmp_path / "log.mcap") as log:
        assert [is_latched(channel) for channel in log.channels.values()] == [held]


def test_static_transforms_of_several_nodes(tmp_path: Path) -> None:
    """The newest message of each child frame: what another node said of another frame holds on."""
    transforms = [
        static_transform([t * S], parent="base", child=child, xyz=[t, 0, 0], xyzw=[0, 0, 0, 1])
        for t, child in ((1000, "imu"), (1001, "camera"), (1002, "imu"), (1500, "gnss"))
    ]
    path = tmp_path / "log.mcap"
    with LogWriter(path, chunk_bytes=100) as writer:
        channel = writer.add_channel("/tf_static", transforms[0].type, "ros2msg", transforms[0].stream.schema_text)
        writer.write(replace(messages_of(transforms), stream=np.full(4, channel, np.int32)))
    for source in sources(path):
        assert [p.log_time // S for p in source.latched(1400 * S)] == [1001, 1002]
        assert [p.log_time // S for p in source.latched(1600 * S)] == [1001, 1002, 1500]


def test_static_transforms_that_cannot_be_read(tmp_path: Path) -> None:
    """All are given: one too many does no harm."""
    for source in sources(write(tmp_path / "log.mcap", [("/tf_static", 0), ("/tf_static", 1), ("/x", 2)])):
        assert numbers(source.latched(12 * S)) == [0, 1]
