"""A log in the order of publish times or of stamps: exact over the whole log, by an index made in one pass before."""

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.ahead import ahead
from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.play.latched import is_latched, is_static, newest
from fuselog.replay.play.played import Played
from fuselog.replay.play.source import AHEAD, chosen
from fuselog.schemas import Codec, Fault, Messages, SchemaError, compile_codec, stamp_path

Ints = NDArray[np.int64]
Times = Callable[[Messages], Ints]  # of a batch, (n,) ns; 0 where a message has none

_FAR_NS = 3600 * 10**9  # a time further from the log time is of another clock


def publish_times(batch: Messages) -> Ints:
    """When the publishers sent them, as the log says."""
    return batch.publish_time


def header_stamps(channels: Sequence[Channel]) -> Times:
    """The stamps of messages of these channels, by the columnar decoder; 0 for types without a stamp."""
    codecs = {channel.id: codec for channel in channels if (codec := _stamp_codec(channel)) is not None}

    def stamps(batch: Messages) -> Ints:
        found = np.zeros(len(batch), np.int64)
        for id, codec in codecs.items():
            mine = np.flatnonzero(batch.stream == id)
            columns = codec.decode(batch.data, batch.start[mine], batch.length[mine])
            found[mine] = np.where(columns.fault == Fault.NONE, columns.t_ns, 0)
        return found

    return stamps


def _stamp_codec(channel: Channel) -> Codec | None:
    """What decodes the stamp; None for a type that has none, or that cannot be decoded."""
    try:
        stamp = stamp_path(**channel.message_type)
        return None if stamp is None else compile_codec(**channel.message_type, fields=[], stamp=stamp)
    except SchemaError:
        return None


class StampedSource:
    """Channels of a log by other times than its own, ties in the order of the log.

    The first pass keeps 36 bytes a message: no window limits how far a message may move. Playing reads the log in its
    own order and holds those chunks that messages still to come lie in. Where ``times`` says nothing, or is more than
    an hour off, the log time counts; ``by_log_time`` counts these by topic.
    """

    def __init__(self, log: Log, channels: Sequence[Channel], times: Times) -> None:
        self._log = log
        self._channels = {channel.id: channel for channel in channels}
        self._latched = [channel for channel in channels if is_latched(channel)]
        log_time, stream, wanted = self._index(times)
        own = (wanted <= 0) | (np.abs(wanted - log_time) > _FAR_NS)
        self.by_log_time = Counter[str]()
        for id, count in zip(*np.unique(stream[own], return_counts=True), strict=True):
            self.by_log_time[self._channels[int(id)].topic] += int(count)
        t_ns = np.where(own, log_time, wanted)
        self._order = np.argsort(t_ns, kind="stable")  # k-th to be played -> its number in the log
        self._t_ns = t_ns[self._order]
        self._lowest = np.minimum.accumulate(self._order[::-1])[::-1]  # number in the log of all from the k-th on
        self._log_time, self._stream = log_time, stream
        self._sorted = bool(np.all(np.diff(log_time) >= 0))  # it is, in a sound log
        self.first, self.last = (int(self._t_ns[0]), int(self._t_ns[-1])) if len(t_ns) else (0, 0)

    def begin(self, start: int, end: int | None) -> Generator[Played]:
        """See ``Source``."""
        k = int(np.searchsorted(self._t_ns, start))
        stop = len(self._t_ns) if end is None else int(np.searchsorted(self._t_ns, end))
        if k >= stop:
            return
        order = (self._order[k:stop].tolist(), self._t_ns[k:stop].tolist(), self._lowest[k:stop].tolist())
        held: deque[tuple[int, Messages]] = deque()
        reach = 0
        with closing(ahead(self._read(int(self._lowest[k])), AHEAD)) as reading:
            for n, t_ns, lowest in zip(*order, strict=True):
                while held and held[0][0] + len(held[0][1]) <= lowest:
                    held.popleft()
                while reach <= n:
                    held.append(next(reading))
                    reach = held[-1][0] + len(held[-1][1])
                base, batch = held[bisect_right(held, n, key=lambda part: part[0]) - 1]
                yield self._one(batch, n - base, t_ns)

    def latched(self, t_ns: int) -> list[Played]:
        """See ``Source``."""
        before = int(np.searchsorted(self._t_ns, t_ns))
        stream = self._stream[self._order[:before]]
        rows: list[int] = []
        for channel in self._latched:
            mine = np.flatnonzero(stream == channel.id).tolist()
            rows += mine if is_static(channel) else mine[-1:]
        return newest([self._fetch(k) for k in sorted(rows)])

    def _index(self, times: Times) -> tuple[Ints, NDArray[np.int32], Ints]:
        """Log time, channel and wanted time of every message in the order of the log."""
        found = [(b.log_time, b.stream, times(b)) for b in chosen(self._log, self._channels, None, None)]
        log_time = np.concatenate([np.empty(0, np.int64), *(part[0] for part in found)])
        stream = np.concatenate([np.empty(0, np.int32), *(part[1] for part in found)])
        return log_time, stream, np.concatenate([np.empty(0, np.int64), *(part[2] for part in found)])

    def _read(self, n: int) -> Iterator[tuple[int, Messages]]:
        """Batches in the order of the log, each with the number of its first message, from that with message n on."""
        start = int(self._log_time[n]) if self._sorted else None
        base = int(np.searchsorted(self._log_time, start)) if start is not None else 0
        for batch in chosen(self._log, self._channels, start, None):
            yield base, batch
            base += len(batch)

    def _fetch(self, k: int) -> Played:
        """The k-th message of this order by itself."""
        n = int(self._order[k])
        base, batch = next((base, batch) for base, batch in self._read(n) if n < base + len(batch))
        return self._one(batch, n - base, int(self._t_ns[k]))

    def _one(self, batch: Messages, row: int, t_ns: int) -> Played:
        start = int(batch.start[row])
        payload = bytes(batch.data.data[start : start + int(batch.length[row])])
        return Played(t_ns, self._channels[int(batch.stream[row])], payload, int(batch.log_time[row]))
