"""The messages among records in memory, as one batch."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file import records
from fuselog.schemas.messages import Messages


class Found(NamedTuple):
    """What a walk found: the wanted messages as they lie, and how the records are."""

    messages: Messages
    ordered: bool  # whether they are in time order
    short: int  # messages without room for their own header
    whole: int  # where the whole records end


class MessageWalk:
    """Walks over records with room that is made once, for chunk after chunk."""

    def __init__(self) -> None:
        self._rows = np.empty((records.COLUMNS, 0), np.int64)

    def take(
        self, data: NDArray[np.uint8], begin: int, end: int, wanted: NDArray[np.uint8], counts: NDArray[np.int64]
    ) -> Found:
        """The ``wanted`` (65536,) channels' messages of ``data[begin:end]``; ``counts`` (65536,) grows by all."""
        most = (end - begin) // records.LEAST_MESSAGE
        if most > self._rows.shape[1]:
            self._rows = np.empty((records.COLUMNS, most), np.int64)
        n, ordered, short, whole = records.fill(data, begin, end, wanted, counts, self._rows)
        channel, sequence, log_time, publish_time, start, length = self._rows[:, :n].copy()
        messages = Messages(
            stream=channel.astype(np.int32),
            data=data,
            start=start,
            length=length,
            log_time=log_time,
            publish_time=publish_time,
            sequence=sequence,
        )
        return Found(messages, ordered, short, whole)
