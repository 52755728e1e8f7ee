"""Results on their way out: published by a thread of their own, so that no slow subscriber holds up the filter."""

import queue
from collections.abc import Callable

import zenoh

from fuselog.fusion import Output, Outputs, Stream
from fuselog.schemas import Messages
from fuselog.service.streams import tell
from fuselog.service.transport import key_of
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher


class Outbox:
    """``offer`` never waits: what does not fit is dropped and counted.

    Publishing waits for a slow subscriber. One that takes nothing for 5 s loses its connection by Zenoh's own rule,
    and only that one.
    """

    def __init__(self, session: zenoh.Session, outputs: Outputs, *, source: bytes, capacity: int = 131_072) -> None:
        self.dropped = 0
        self.record: Callable[[Messages], None] | None = None  # is given all that is offered, and never waits either
        self._capacity = capacity
        self._source = source
        self._queue: queue.SimpleQueue[Messages | None] = queue.SimpleQueue()
        self._offered = self._done = 0  # messages; each counter has one writer
        self._sequence = [0] * len(outputs.topics)
        media = [media_type("cdr", output.schema_name) for output in outputs.topics]
        keys = [key_of(output.topic) for output in outputs.topics]
        self._publishers = [Publisher(session, key, kind) for key, kind in zip(keys, media, strict=True)]
        tell(session, {key_of(output.topic): [_stream(output)] for output in outputs.topics}, outputs=True)

    def offer(self, messages: Messages) -> None:
        """Give what ``Outputs.encode`` made to the publishing thread."""
        if self.record is not None:
            self.record(messages)
        if self._offered - self._done + len(messages) > self._capacity:
            self.dropped += len(messages)
        elif len(messages):
            self._offered += len(messages)
            self._queue.put(messages)

    def run(self) -> None:
        """Publish until ``finish``."""
        while (messages := self._queue.get()) is not None:
            self._publish(messages)
            self._done += len(messages)

    def finish(self) -> None:
        """Let ``run`` end after what was offered."""
        self._queue.put(None)

    def _publish(self, messages: Messages) -> None:
        data = messages.data.data
        wanted = [publisher.wanted for publisher in self._publishers]
        streams, times = messages.stream.tolist(), messages.log_time.tolist()
        starts, lengths = messages.start.tolist(), messages.length.tolist()
        for stream, t_ns, start, length in zip(streams, times, starts, lengths, strict=True):
            self._sequence[stream] += 1
            if wanted[stream]:
                tag = Tag(self._sequence[stream], t_ns, self._source)
                self._publishers[int(stream)].put(bytes(data[start : start + length]), write_tag(tag))


def _stream(output: Output) -> Stream:
    return Stream(
        topic=output.topic,
        encoding="cdr",
        schema_name=output.schema_name,
        schema_encoding="ros2msg",
        schema_text=output.schema_text,
    )
