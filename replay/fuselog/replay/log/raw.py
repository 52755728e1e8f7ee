"""Messages one by one, each with its own bytes."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from fuselog.schemas.messages import Messages


class RawMessage(NamedTuple):
    """One message with its payload bytes; times in ns."""

    log_time: int
    publish_time: int
    channel_id: int
    sequence: int
    data: bytes


def one_by_one(batches: Iterable[Messages]) -> Iterator[RawMessage]:
    """The messages of all batches."""
    for batch in batches:
        data = batch.data.data
        for log, publish, channel, sequence, start, length in zip(
            batch.log_time.tolist(),
            batch.publish_time.tolist(),
            batch.stream.tolist(),
            batch.sequence.tolist(),
            batch.start.tolist(),
            batch.length.tolist(),
            strict=True,
        ):
            yield RawMessage(log, publish, channel, sequence, bytes(data[start : start + length]))
