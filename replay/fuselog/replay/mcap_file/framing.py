"""Messages to Message records, many at a time: the writer's side of `records`."""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file.records import FRAME, MESSAGE, MESSAGE_HEADER, MESSAGE_INDEX, Integer
from fuselog.schemas.compiled import inline, kernel
from fuselog.schemas.messages import Messages

OVERHEAD = FRAME + MESSAGE_HEADER  # bytes of a Message record beside its payload
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class Batch(NamedTuple):
    """n messages as `frame` takes them."""

    data: NDArray[np.uint8]
    extent: NDArray[np.int64]  # (2, n) start and length of the payload in data
    fields: NDArray[np.int64]  # (4, n) channel, sequence, log time, publish time

    @classmethod
    def of(cls, messages: Messages) -> Self:
        """The same messages."""
        channel = messages.stream.astype(np.int64)
        fields = (channel, messages.sequence, messages.log_time, messages.publish_time)
        return cls(messages.data, np.stack((messages.start, messages.length)), np.stack(fields))


class Frames:
    """The records of one chunk in the making; room for ``capacity`` bytes, or for one larger message."""

    def __init__(self, capacity: int) -> None:
        self._data = np.empty(capacity, np.uint8)
        rows = capacity // OVERHEAD + 1
        self._channel = np.empty(rows, np.uint16)
        self._index = np.empty(rows, _INDEX_ENTRY)
        self.size = 0  # bytes
        self.count = 0  # messages

    def add(self, batch: Batch, first: int) -> int:
        """Frame messages from ``first`` on while there is room -> the first that found none."""
        if self.count == 0:
            needed = OVERHEAD + int(batch.extent[1, first])
            if needed > len(self._data):
                self._data = np.empty(needed, np.uint8)
        following, self.size = frame(
            *batch,
            first,
            self._data,
            self.size,
            self._channel[self.count :],
            self._index[self.count :].view(np.int64).reshape(-1, 2),
        )
        self.count += following - first
        return following

    def records(self) -> memoryview:
        """The bytes so far."""
        return self._data[: self.size].data

    def time_range(self) -> tuple[int, int]:
        """Earliest and latest log time in ns."""
        times = self._index["log_time"][: self.count]
        return int(times.min()), int(times.max())

    def index_by_channel(self) -> dict[int, bytes]:
        """The MessageIndex record of each channel, by channel number; messages in the order written."""
        channels = self._channel[: self.count]
        order = np.argsort(channels, kind="stable")
        ids, begins = np.unique(channels[order], return_index=True)
        parts = np.split(self._index[: self.count][order], begins[1:])
        return {id: _index_record(id, part.tobytes()) for id, part in zip(ids.tolist(), parts, strict=True)}


def _index_record(channel: int, entries: bytes) -> bytes:
    head = bytes([MESSAGE_INDEX]) + (6 + len(entries)).to_bytes(8, "little")
    return head + channel.to_bytes(2, "little") + len(entries).to_bytes(4, "little") + entries


@inline
def put_bytes(target: NDArray[np.uint8], at: Integer, value: Integer, width: int) -> None:
    """The low ``width`` bytes of ``value``, little-endian."""
    for k in range(width):
        target[at + k] = (value >> (8 * k)) & 0xFF


@kernel
def frame(
    data: NDArray[np.uint8],
    extent: NDArray[np.int64],
    fields: NDArray[np.int64],
    first: int,
    target: NDArray[np.uint8],
    at: int,
    channel: NDArray[np.uint16],
    index: NDArray[np.int64],
) -> tuple[int, int]:
    """Write Message records at ``target[at:]`` until full -> (first message not written, end).

    ``data``, ``extent``, ``fields`` are those of `Batch`. ``channel`` (m,) and ``index`` (m, 2) take what
    the message index needs: channel, log time and offset.
    """
    i, row = first, 0
    while i < extent.shape[1]:
        start, length = extent[0, i], extent[1, i]
        if at + OVERHEAD + length > len(target):
            break
        target[at] = MESSAGE
        put_bytes(target, at + 1, MESSAGE_HEADER + length, 8)
        put_bytes(target, at + 9, fields[0, i], 2)
        put_bytes(target, at + 11, fields[1, i], 4)
        put_bytes(target, at + 15, fields[2, i], 8)
        put_bytes(target, at + 23, fields[3, i], 8)
        target[at + OVERHEAD : at + OVERHEAD + length] = data[start : start + length]
        channel[row] = fields[0, i]
        index[row, 0], index[row, 1] = fields[2, i], at
        at += OVERHEAD + length
        i, row = i + 1, row + 1
    return int(i), int(at)
