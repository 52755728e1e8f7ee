"""Samples of Zenoh, one after another, into one batch of messages."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas import Messages, pack

_Ints = NDArray[np.int64]


@dataclass(slots=True)
class Batch:
    """Samples as columns; who adds one adds to each of them, or adds several by ``extend``."""

    streams: list[int] = field(default_factory=list[int])
    received: list[int] = field(default_factory=list[int])  # ns
    published: list[int] = field(default_factory=list[int])  # ns
    numbers: list[int] = field(default_factory=list[int])
    payloads: list[bytes] = field(default_factory=list[bytes])
    _parts: list[tuple[_Ints, _Ints, _Ints, _Ints]] = field(default_factory=list[tuple[_Ints, _Ints, _Ints, _Ints]])

    def __len__(self) -> int:
        return len(self.payloads)

    def extend(self, stream: int, t_ns: _Ints, first: int, payloads: Sequence[bytes]) -> None:
        """Samples of one stream, received and published at these times, numbered from ``first`` on."""
        self._close()
        n = len(payloads)
        self._parts.append((np.full(n, stream), t_ns, t_ns, np.arange(first, first + n)))
        self.payloads.extend(payloads)

    def messages(self) -> Messages:
        """All of it."""
        self._close()
        data, start, length = pack(self.payloads)
        stream, received, published, numbers = map(np.concatenate, zip(*self._parts, strict=True))
        return Messages(
            stream=stream.astype(np.int32),
            data=data,
            start=start,
            length=length,
            log_time=received,
            publish_time=published,
            sequence=numbers,
        )

    def _close(self) -> None:
        """What was added one by one becomes a part."""
        if self.streams or not self._parts:
            lists = (self.streams, self.received, self.published, self.numbers)
            streams, received, published, numbers = (np.array(each, np.int64) for each in lists)
            self._parts.append((streams, received, published, numbers))
            for each in lists:
                each.clear()
