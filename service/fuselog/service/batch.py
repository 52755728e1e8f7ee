"""Samples of Zenoh, one after another, into one batch of messages."""

from dataclasses import dataclass, field

import numpy as np

from fuselog.schemas import Messages, pack

Row = tuple[int, int, int, int]  # stream, when received, when published (ns), number


@dataclass(frozen=True, slots=True)
class Batch:
    """Rows, and the payload of each."""

    rows: list[Row] = field(default_factory=list[Row])
    payloads: list[bytes] = field(default_factory=list[bytes])

    def __len__(self) -> int:
        return len(self.rows)

    def messages(self) -> Messages:
        """All of it."""
        table = np.array(self.rows, np.int64).reshape(-1, 4)
        data, start, length = pack(self.payloads)
        return Messages(
            stream=table[:, 0].astype(np.int32),
            data=data,
            start=start,
            length=length,
            log_time=table[:, 1].copy(),
            publish_time=table[:, 2].copy(),
            sequence=table[:, 3].copy(),
        )
