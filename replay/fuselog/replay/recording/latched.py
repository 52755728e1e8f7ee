"""Messages said once and true ever after, such as static transforms: kept to be repeated in every file."""

from collections.abc import Collection

import numpy as np

from fuselog.fusion.intake import same_topic
from fuselog.schemas import Messages, pack

_MOST = 256
_MOST_BYTES = 1 << 20


class Latched:
    """The different messages of ``topics``, of too many the newest. Several publishers may say parts of the truth."""

    def __init__(self, topics: Collection[str]) -> None:
        self._topics = {same_topic(topic) for topic in topics}
        self._channels: list[int] = []
        self._kept: dict[tuple[int, bytes], tuple[int, int]] = {}  # channel, payload: publish time, sequence
        self._bytes = 0

    def watch(self, channel: int, topic: str) -> None:
        """Keep the messages of this channel if its topic is latched."""
        if same_topic(topic) in self._topics:
            self._channels.append(channel)

    def remember(self, messages: Messages) -> None:
        """Keep what is latched among the messages."""
        if not self._channels:
            return
        for i in np.flatnonzero(np.isin(messages.stream, self._channels)).tolist():
            start, length = int(messages.start[i]), int(messages.length[i])
            key = int(messages.stream[i]), messages.data[start : start + length].tobytes()
            if self._kept.pop(key, None) is None:
                self._bytes += length
            self._kept[key] = int(messages.publish_time[i]), int(messages.sequence[i])
        while len(self._kept) > _MOST or self._bytes > _MOST_BYTES:
            oldest = next(iter(self._kept))
            self._bytes -= len(oldest[1])
            del self._kept[oldest]

    def repeat(self, log_time: int) -> Messages | None:
        """What is kept, as received at ``log_time``."""
        if not self._kept:
            return None
        payloads = [payload for _, payload in self._kept]
        data, start, length = pack(payloads)
        said = np.array(list(self._kept.values()), np.int64)
        return Messages(
            stream=np.array([channel for channel, _ in self._kept], np.int32),
            data=data,
            start=start,
            length=length,
            log_time=np.full(len(payloads), log_time, np.int64),
            publish_time=said[:, 0].copy(),
            sequence=said[:, 1].copy(),
        )
