"""What a log holds, found by reading all of it."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fuselog.replay.log import Log
from fuselog.replay.log.loss import Loss


@dataclass(slots=True)
class TopicSurvey:
    """One channel: how many messages, how often, and the longest silence between two of them (log time)."""

    topic: str
    type: str
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    longest_gap_ns: int | None = None

    def add(self, log_time: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        """Take the log times of the next messages, in order."""
        times = log_time if self.last_ns is None else np.append(self.last_ns, log_time)
        if len(times) > 1:
            self.longest_gap_ns = max(self.longest_gap_ns or 0, int(np.diff(times).max()))
        self.first_ns = int(times[0]) if self.first_ns is None else self.first_ns
        self.last_ns = int(times[-1])
        self.messages += len(log_time)

    def to_json(self) -> dict[str, Any]:
        """As plain data, with the mean rate."""
        span = ((self.last_ns or 0) - (self.first_ns or 0)) * 1e-9
        gap = None if self.longest_gap_ns is None else self.longest_gap_ns * 1e-9
        rate = (self.messages - 1) / span if span > 0 else None
        head = {"topic": self.topic, "type": self.type, "messages": self.messages}
        return head | {"rate_hz": rate, "longest_gap_s": gap, "first_ns": self.first_ns, "last_ns": self.last_ns}


@dataclass(frozen=True, slots=True)
class Survey:
    """All channels of a log, and what could not be read."""

    path: str
    topics: list[TopicSurvey]
    losses: list[Loss]

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        firsts = [topic.first_ns for topic in self.topics if topic.first_ns is not None]
        lasts = [topic.last_ns for topic in self.topics if topic.last_ns is not None]
        return {
            "schema": 1,
            "path": self.path,
            "messages": sum(topic.messages for topic in self.topics),
            "seconds": (max(lasts) - min(firsts)) * 1e-9 if firsts and lasts else 0.0,
            "topics": [topic.to_json() for topic in self.topics],
            "losses": [asdict(loss) for loss in self.losses],
        }


def survey(log: Log) -> Survey:
    """Read every message of a log, in bounded memory."""
    found = {c.id: TopicSurvey(c.topic, c.schema.name) for c in log.channels.values()}
    for messages in log.batches():
        for channel in np.unique(messages.stream):
            found[int(channel)].add(messages.log_time[messages.stream == channel])
    return Survey(str(log.path), sorted(found.values(), key=lambda topic: topic.topic), list(log.losses))
