"""Results on their way out: published by a thread of their own, so that no slow subscriber holds up a filter."""

import queue
import time
from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass
from functools import partial
from itertools import chain, count
from typing import Literal

import numpy as np
import zenoh

from fuselog.fusion import Output, Outputs, Plan
from fuselog.fusion.health import HEALTH
from fuselog.fusion.outputs import ESTIMATE
from fuselog.schemas import Messages, pack
from fuselog.service.live.encodings import stream_of, transcoder_of
from fuselog.service.ros_keys import announce, ros_publication
from fuselog.service.streams import Announcements
from fuselog.service.transport import key_of
from fuselog.service.wire import Tag, media_type, write_tag
from fuselog.service.zenoh_door import Publisher

_LATENCIES = 1000
_NUMBERS = count(1)  # of publishers that ROS 2 lists


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
        transcoders = [transcoder_of(plan.config.output.encoding, output.schema_name) for output in self.topics]
        self._convert = [each.convert for each in transcoders]
        media = [media_type(each.encoding, each.schema_name) for each in transcoders]
        self._keys = [key_of(output.topic) for output in self.topics]
        cache, ros = plan.config.zenoh.cache, plan.config.zenoh.ros
        self._ways = [
            [_Way(Publisher(session, key, kind, cache=cache))] for key, kind in zip(self._keys, media, strict=True)
        ]
        for ways, output in zip(self._ways, self.topics, strict=True):
            if ros is not None:
                ways.append(_ros_way(session, output, ros.domain, cache))
        streams = [stream_of(*each) for each in zip(self.topics, transcoders, strict=True)]
        told.add({key: [stream] for key, stream in zip(self._keys, streams, strict=True)})

    @property
    def wanted(self) -> Container[int]:
        """The streams that somebody subscribes to or records, by number."""
        if self.record is not None:
            return range(len(self.topics))
        return {number for number, ways in enumerate(self._ways) if any(way.publisher.wanted for way in ways)}

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
        wanted = [[way for way in ways if way.publisher.wanted] for ways in self._ways]
        streams, times = messages.stream.tolist(), messages.log_time.tolist()
        starts, lengths = messages.start.tolist(), messages.length.tolist()
        for stream, t_ns, start, length in zip(streams, times, starts, lengths, strict=True):
            if wanted[stream]:
                payload = self._convert[int(stream)](data[start : start + length])
                for way in wanted[int(stream)]:
                    way.sent += 1
                    way.publisher.put(payload, write_tag(Tag(way.sent, t_ns, self._source)))
        if since_ns is not None:
            self.latencies_ns.append(time.monotonic_ns() - since_ns)
        return len(messages)

    def _undeclare(self) -> int:
        for way in chain.from_iterable(self._ways):
            way.end_announcement()
            way.publisher.close()
        return 0


@dataclass(slots=True)
class _Way:
    """A key under which results go out, with numbers of its own."""

    publisher: Publisher
    sent: int = 0
    end_announcement: Callable[[], None] = lambda: None


def _ros_way(session: zenoh.Session, output: Output, domain: int, cache: int) -> _Way:
    """Where ROS 2 finds an output, and the token by which it lists it."""
    key = ros_publication(output.topic, output.schema_name, domain=domain)
    end = announce(session, next(_NUMBERS), output.topic, output.schema_name, domain=domain)
    return _Way(Publisher(session, key, media_type("cdr", output.schema_name), cache=cache), end_announcement=end)
