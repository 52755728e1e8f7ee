"""Samples of Zenoh, one after another, into one batch of messages."""

from dataclasses import dataclass, field

import numpy as np

from fuselog.schemas import Messages, pack


@dataclass(frozen=True, slots=True)
class Batch:
    """Samples as columns; who adds one adds to each of them."""

    streams: list[int] = field(default_factory=list[int])
    received: list[int] = field(default_factory=list[int])  # ns
    published: list[int] = field(default_factory=list[int])  # ns
    numbers: list[int] = field(default_factory=list[int])
    payloads: list[bytes] = field(default_factory=list[bytes])

    def __len__(self) -> int:
        return len(self.payloads)

    def messages(self) -> Messages:
        """All of it."""
        data, start, length = pack(self.payloads)
        return Messages(
            stream=np.array(self.streams, np.int32),
            data=data,
            start=start,
            length=length,
            log_time=np.array(self.received, np.int64),
            publish_time=np.array(self.published, np.int64),
            sequence=np.array(self.numbers, np.int64),
        )
