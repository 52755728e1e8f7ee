"""A clock that only the test moves, a source that is a list, and logs of one byte a message."""

from bisect import bisect_left
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from fuselog.replay import Channel, LogWriter, Schema
from fuselog.replay.play import Playback, Played
from fuselog.schemas import Messages

S = 1_000_000_000
CHANNEL = Channel(1, "/a", Schema("a/msg/A", "ros2msg", b"float64 x"), "cdr", {}, None)
LATCHED = "- durability: 1\n  depth: 1\n"


class Time:
    """A clock in ns that stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 100 * S

    def clock(self) -> int:
        return self.now


class Listed:
    """Messages at given times as a source; what is latched is given as well."""

    def __init__(self, times: Sequence[int], latched: Sequence[int] = ()) -> None:
        self.messages = [Played(t, CHANNEL, str(i).encode(), t) for i, t in enumerate(times)]
        self.first, self.last = (times[0], times[-1]) if times else (0, 0)
        self.by_log_time: dict[str, int] = {}
        self._latched = latched
        self.open = 0

    def begin(self, start: int, end: int | None) -> Generator[Played]:
        self.open += 1
        try:
            times = [m.t_ns for m in self.messages]
            yield from self.messages[bisect_left(times, start) : None if end is None else bisect_left(times, end)]
        finally:
            self.open -= 1

    def latched(self, t_ns: int) -> list[Played]:
        return [Played(t, CHANNEL, b"latched", t) for t in self._latched if t < t_ns][-1:]


def taken(playback: Playback, time: Time, until: int | None = None) -> list[tuple[float, str]]:
    """Let the clock run (to ``until`` s) -> when each message left (s from 100), and its payload."""
    left: list[tuple[float, str]] = []
    while not playback.over:
        due = playback.due()
        if due is None or (until is not None and due > until * S + 100 * S):
            break
        time.now = max(time.now, due)
        played = playback.take()
        if played is not None:
            left.append(((time.now - 100 * S) / S, played.payload.decode(errors="replace")))
    if until is not None:
        time.now = max(time.now, until * S + 100 * S)
    return left


def write(
    path: Path,
    rows: Sequence[tuple[str, float]],
    *,
    publish: Sequence[float] | None = None,
    types: dict[str, str] | None = None,
    latched: Sequence[str] = (),
    chunk_bytes: int = 100,
) -> Path:
    """A log of (topic, s after 10 s); the payload is the number of the row. Some topics may be transient local."""
    with LogWriter(path, chunk_bytes=chunk_bytes) as writer:
        channels = {
            topic: writer.add_channel(
                topic,
                (types or {}).get(topic, "a/msg/A"),
                "ros2msg",
                "float64 x",
                metadata={"offered_qos_profiles": LATCHED} if topic in latched else {},
            )
            for topic in dict.fromkeys(topic for topic, _ in rows)
        }
        payloads = [str(number).encode() for number in range(len(rows))]
        length = np.array([len(payload) for payload in payloads], np.int64)
        log_time = np.array([round((10 + t) * S) for _, t in rows], np.int64)
        writer.write(
            Messages(
                stream=np.array([channels[topic] for topic, _ in rows], np.int32),
                data=np.frombuffer(b"".join(payloads), np.uint8),
                start=np.cumsum(length) - length,
                length=length,
                log_time=log_time,
                publish_time=log_time if publish is None else np.array([round((10 + t) * S) for t in publish]),
                sequence=np.full(len(rows), 77),
            )
        )
    return path
