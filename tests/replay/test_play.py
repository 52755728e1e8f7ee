"""The player without middleware: which messages, in which order, and when, by a clock that the test moves."""

from pathlib import Path

import numpy as np
import pytest

from fuselog.replay import LogWriter, open_log
from fuselog.replay.play import Played, play, playable
from fuselog.schemas import LogError, Messages

S = 1_000_000_000


class Time:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """/a every second, /b every half, /tf_static at the start, and an output of an earlier run."""
    path = tmp_path / "log.mcap"
    with LogWriter(path) as writer:
        a = writer.add_channel("/a", "a/msg/A", "ros2msg", "float64 x")
        b = writer.add_channel("/b", "a/msg/A", "ros2msg", "float64 x")
        tf = writer.add_channel("/tf_static", "a/msg/A", "ros2msg", "float64 x")
        out = writer.add_channel("/fused", "fuselog_msgs/msg/Estimate", "ros2msg", "float64 x")
        rows = [(tf, 10 * S), (a, 10 * S), (b, 10 * S), (out, 10 * S), (b, 10 * S + S // 2), (a, 11 * S), (b, 11 * S)]
        n = len(rows)
        writer.write(
            Messages(
                stream=np.array([channel for channel, _ in rows], np.int32),
                data=np.arange(n, dtype=np.uint8),
                start=np.arange(n),
                length=np.ones(n, np.int64),
                log_time=np.array([time for _, time in rows]),
                publish_time=np.array([time for _, time in rows]),
                sequence=np.full(n, 77),
            )
        )
    return path


def names(messages: list[Played]) -> list[str]:
    """Topic and number of each."""
    return [f"{m.channel.topic}{m.sequence}" for m in messages]


def test_order_and_numbers(log: Path) -> None:
    """Log-time order, ties in file order, each channel counted from 1; results are never played."""
    with open_log(log) as opened:
        messages = list(play(opened, playable(opened), rate=None))
    assert names(messages) == ["/tf_static1", "/a1", "/b1", "/b2", "/a2", "/b3"]
    assert [m.payload for m in messages] == [bytes([i]) for i in (0, 1, 2, 4, 5, 6)]
    assert [m.log_time for m in messages] == [10 * S] * 3 + [10 * S + S // 2, 11 * S, 11 * S]


def test_each_when_it_is_due(log: Path) -> None:
    """At rate 2 a second of the log takes half a second; a consumer that is late gets the rest at once."""
    time = Time()
    with open_log(log) as opened:
        times: list[float] = []
        for message in play(opened, playable(opened), rate=2.0, clock=time.clock, sleep=time.sleep):
            times.append(time.now - 100)
            if message.sequence == 2 and message.channel.topic == "/b":
                time.now += 5
    assert times == pytest.approx([0, 0, 0, 0.25, 5.25, 5.25])
    assert time.slept == pytest.approx([0.25])


def test_unpaced_never_sleeps(log: Path) -> None:
    """Whoever takes the messages sets the pace."""
    time = Time()
    with open_log(log) as opened:
        assert len(list(play(opened, playable(opened), rate=None, clock=time.clock, sleep=time.sleep))) == 6
    assert time.slept == []


def test_a_part(log: Path) -> None:
    """Start and duration count from the beginning of the log; static transforms come in any case, at once."""
    time = Time()
    with open_log(log) as opened:
        part = play(opened, playable(opened), start_s=0.5, duration_s=0.5, clock=time.clock, sleep=time.sleep)
        assert names(list(part)) == ["/tf_static1", "/b1"]
        later = play(opened, playable(opened), start_s=1.0, clock=time.clock, sleep=time.sleep)
        assert names(list(later)) == ["/tf_static1", "/a1", "/b1"]
    assert time.slept == []


def test_which_topics(log: Path) -> None:
    """Chosen and excluded topics; one that is not there is an error that names those that are."""
    with open_log(log) as opened:
        assert names(list(play(opened, playable(opened, topics=["/a"]), rate=None))) == ["/a1", "/a2"]
        rest = playable(opened, exclude=["/a", "/tf_static"])
        assert names(list(play(opened, rest, rate=None))) == ["/b1", "/b2", "/b3"]
        assert playable(opened, topics=["/fused"]) == []
        with pytest.raises(LogError, match=r"no topic '/c'; it has /a, /b, /tf_static, /fused"):
            playable(opened, topics=["/c"])
