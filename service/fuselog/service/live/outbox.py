"""Results on their way out: published by a thread of their own, so that no slow subscriber holds up a filter."""

import queue
import time
from collections import deque
from collections.abc import Callable, Container
from functools import partial
from typing import Literal

import numpy as np
import zenoh

from fuselog.fusion import Output, Outputs, Plan
from fuselog.fusion.health import HEALTH
from fuselog.fusion.outputs import ESTIMATE
from fuselog.schemas import Messages, pack
from fuselog.service.live.encodings import stream_of, transcoder_of
from fuselog.service.streams import Announcements
from fuselog.service.transport import key_of
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

_LATENCIES = 1000


class Post:
    """The publishing thread of a service, for the outboxes of all its filters. ``put`` never waits.

    What is put goes out together at the next ``flush``: a thread that is woken for each filter would be in the way of
    the next one.

    Publishing waits for a slow subscriber. One that takes nothing for 5 s loses its connection by Zenoh's own rule,
    and only that one.
    """

    def __init__(self, *, capacity: int = 131_072) -> None:
        self._capacity = capacity  # messages
        self._queue: queue.SimpleQueue[list[Callable[[], int]] | None] = queue.SimpleQueue()
        self._gathered: list[Callable[[], int]] = []  # to do, each for so many messages
        self._offered = self._done = 0  # messages; each counter has one writer

    def put(self, size: int, publish: Callable[[], int]) -> bool:
        """Take ``size`` messages to publish -> whether there was room; called on the thread of the filters."""
        if self._offered - self._done + size > self._capacity:
            return False
        self._offered += size
        self._gathered.append(publish)
        return True

    def flush(self) -> None:
        """Let what was put go out; called on the thread of the filters."""
        if self._gathered:
            self._queue.put(self._gathered)
            self._gathered = []

    def run(self) -> None:
        """Publish until ``finish``."""
        while (gathered := self._queue.get()) is not None:
            for publish in gathered:
                self._done += publish()

    def finish(self) -> None:
        """Let ``run`` end after what was put."""
        self.flush()
        self._queue.put(None)


class Outbox:
    """The publishers of one filter. ``offer`` never waits: what does not fit is dropped and counted.

    What is offered is CDR; ``output.encoding`` is put on as it leaves, on the publishing thread.
    """

    def __init__(self, session: zenoh.Session, post: Post, told: Announcements, plan: Plan, *, source: bytes) -> None:
        self.dropped = 0
        self.latencies_ns: deque[int] = deque(maxlen=_LATENCIES)  # from a sample's arrival to its published results
        self.record: Callable[[Messages], None] | None = None  # is given all that is offered, and never waits either
        base, outputs = plan.config.output.estimate.rstrip("/"), Outputs(plan).topics
        live = {"health": HEALTH} if plan.config.output.now is None else {"now": ESTIMATE, "health": HEALTH}
        self.topics = (*outputs, *(Output(f"{base}/{name}", kind) for name, kind in live.items()))
        self._live = {name: len(outputs) + number for number, name in enumerate(live)}  # what a clock says, and no log
        self._post, self._told, self._source = post, told, source
        self._sequence = [0] * len(self.topics)
        transcoders = [transcoder_of(plan.config.output.encoding, output.schema_name) for output in self.topics]
        self._convert = [each.convert for each in transcoders]
        media = [media_type(each.encoding, each.schema_name) for each in transcoders]
        self._keys = [key_of(output.topic) for output in self.topics]
        self._publishers = [
            Publisher(session, key, kind, cache=plan.config.zenoh.cache)
            for key, kind in zip(self._keys, media, strict=True)
        ]
        streams = [stream_of(*each) for each in zip(self.topics, transcoders, strict=True)]
        told.add({key: [stream] for key, stream in zip(self._keys, streams, strict=True)})

    @property
    def wanted(self) -> Container[int]:
        """The streams that somebody subscribes to or records, by number."""
        if self.record is not None:
            return range(len(self.topics))
        return {number for number, publisher in enumerate(self._publishers) if publisher.wanted}

    def offer(self, messages: Messages, *, since_ns: int | None = None) -> None:
        """Give what ``Outputs.encode`` made to the publishing thread; ``since_ns``: when the oldest sample came."""
        if self.record is not None:
            self.record(messages)
        if len(messages) and not self._post.put(len(messages), partial(self._publish, messages, since_ns)):
            self.dropped += len(messages)

    def wants(self, name: Literal["now", "health"]) -> bool:
        """Whether anybody wants messages of ``.../name``."""
        return self._live[name] in self.wanted

    def tell(self, name: Literal["now", "health"], payload: bytes, t_ns: int) -> None:
        """Give a message of ``.../name``, of a time of the filter, to the publishing thread."""
        data, start, length = pack([payload])
        stream, at = np.array([self._live[name]], np.int32), np.array([t_ns])
        self.offer(
            Messages(
                stream=stream,
                data=data,
                start=start,
                length=length,
                log_time=at,
                publish_time=at,
                sequence=0 * at,
            )
        )

    def close(self) -> None:
        """Take the publishers back, after what was offered."""
        self._told.forget(self._keys)
        self._post.put(0, self._undeclare)

    def _publish(self, messages: Messages, since_ns: int | None) -> int:
        data = messages.data.data
        wanted = [publisher.wanted for publisher in self._publishers]
        streams, times = messages.stream.tolist(), messages.log_time.tolist()
        starts, lengths = messages.start.tolist(), messages.length.tolist()
        for stream, t_ns, start, length in zip(streams, times, starts, lengths, strict=True):
            if wanted[stream]:
                self._sequence[stream] += 1
                tag = Tag(self._sequence[stream], t_ns, self._source)
                payload = self._convert[int(stream)](data[start : start + length])
                self._publishers[int(stream)].put(payload, write_tag(tag))
        if since_ns is not None:
            self.latencies_ns.append(time.monotonic_ns() - since_ns)
        return len(messages)

    def _undeclare(self) -> int:
        for publisher in self._publishers:
            publisher.close()
        return 0
