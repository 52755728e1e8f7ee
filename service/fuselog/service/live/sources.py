"""Samples as they came into batches of messages, with an account of each publisher's numbering."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter, methodcaller
from typing import Any, NamedTuple

from fuselog.service.batch import Batch
from fuselog.service.clock import ahead_ns
from fuselog.service.live.inbox import Arrival
from fuselog.service.ros_keys import media_of
from fuselog.service.wire import UNTAGGED, join_tags, tag_fields

_MOST_SOURCES = 4096
_ASK_AGAIN_NS = 2_000_000_000
_NONE = -1
_ATTACHMENT, _TO_BYTES = attrgetter("attachment"), methodcaller("to_bytes")  # which take less time than a loop
_MANY = 8  # samples from which on it is worth looking at them all first

Identify = Callable[[str, str], int | str]


Run = tuple[int, Sequence[Arrival]]  # the number of a key, and samples of it that came one after another


class Progress(NamedTuple):
    """How far a publisher's samples of one key have come: received, and missed by their numbers.

    Of those received, ``repeated`` were taken before a restart, and sent again: they are not fused twice.
    """

    received: int
    missed: int
    repeated: int = 0


@dataclass(slots=True)
class _Source:
    """One publisher of one key and type."""

    stream: int  # _NONE where the type cannot be used
    asked_ns: int
    received: int = 0
    missed: int = 0
    repeated: int = 0
    last: int = 0
    floor: int = 0  # up to this number all was taken before a restart; 0 once the publisher is beyond it


class Sources:
    """Knows every (key, type, publisher) that has sent anything; ``keys`` are numbered as a ``Run`` numbers them.

    A sample whose type cannot be used is counted in ``unknown``, and ``reasons`` says why.
    """

    def __init__(self, keys: Sequence[str], identify: Identify) -> None:
        self.keys = keys
        self.missed = [0] * len(keys)
        self.unknown = [0] * len(keys)
        self.reasons = [""] * len(keys)
        self._identify = identify
        self._sources: dict[tuple[int, str, bytes], _Source] = {}
        self._flowing: dict[tuple[int, bytes], _Source] = {}  # by key and publisher, those of which something came

    def collect(self, runs: Sequence[Run], batch: Batch) -> None:
        """Put the samples that can be used into a batch, in the order in which they came."""
        for key, arrivals in runs:
            self._collect(key, arrivals, batch)

    def _collect(self, key: int, arrivals: Sequence[Arrival], batch: Batch) -> None:
        if len(arrivals) >= _MANY and self._take_flowing(key, arrivals, batch):
            return
        source, of, ahead = None, None, ahead_ns()
        for _, sample, payload, since_ns in arrivals:
            attachment = sample.attachment
            sequence, t_ns, gid = UNTAGGED if attachment is None else tag_fields(attachment.to_bytes())
            if gid != of:
                source, of = self._flowing.get((key, gid)), gid
            if source is not None and sequence == source.last + 1:  # who goes on counting sends what it sent before
                source.received += 1
                source.last = sequence
            else:
                source = self._open(key, media_of(sample), sequence, gid, since_ns)
                if source is None:
                    continue
            t_ns = t_ns if t_ns > 0 else since_ns + ahead
            batch.streams.append(source.stream)
            batch.received.append(t_ns)
            batch.published.append(t_ns)
            batch.numbers.append(sequence if sequence > 0 else 0)
            batch.payloads.append(payload)

    def _take_flowing(self, key: int, arrivals: Sequence[Arrival], batch: Batch) -> bool:
        """The same at once, where all are of one publisher that goes on counting and says the time; else nothing."""
        _, samples, payloads, _ = zip(*arrivals, strict=True)
        given = [*map(_ATTACHMENT, samples)]
        tags = None if any(each is None for each in given) else join_tags([*map(_TO_BYTES, given)])
        source = None if tags is None else self._flowing.get((key, tags.source))
        if tags is None or source is None or tags.first != source.last + 1:
            return False
        source.received += len(arrivals)
        source.last += len(arrivals)
        batch.extend(source.stream, tags.t_ns, tags.first, payloads)
        return True

    def save(self) -> list[list[Any]]:
        """How far each publisher was, for ``load``; publishers that send no numbers are left out."""
        return [
            [self.keys[key], media, gid.hex(), source.stream, source.last]
            for (key, media, gid), source in self._sources.items()
            if source.last and source.stream != _NONE
        ]

    def load(self, saved: list[list[Any]]) -> None:
        """Go on from there: what a publisher sent up to then has been taken, and what is missing since is missed."""
        for key, media, gid, stream, last in saved:
            number = self.keys.index(key)
            source = _Source(stream, 0, last=last, floor=last)
            self._sources[number, media, bytes.fromhex(gid)] = source

    def progress(self) -> dict[str, dict[str, Progress]]:
        """By publisher (hexadecimal) and key."""
        table: dict[str, dict[str, Progress]] = {}
        for (key, _, gid), source in self._sources.items():
            mine = table.setdefault(gid.hex(), {})
            before = mine.get(self.keys[key], Progress(0, 0))
            mine[self.keys[key]] = Progress(
                before.received + source.received, before.missed + source.missed, before.repeated + source.repeated
            )
        return table

    def _open(self, key: int, media: str, sequence: int, gid: bytes, now_ns: int) -> _Source | None:
        """Account for a sample that does not go on from one before -> its source; None for one that is not taken."""
        source = self._source(key, media, gid, now_ns)
        source.received += 1
        if source.last and sequence > source.last + 1:
            gap = sequence - source.last - 1
            source.missed += gap
            self.missed[key] += gap
        source.last = max(source.last, sequence)
        if source.stream == _NONE:
            self.unknown[key] += 1
            self._flowing.pop((key, gid), None)
            return None
        if 0 < sequence <= source.floor:
            source.repeated += 1
            return None
        source.floor = 0
        self._flowing[key, gid] = source
        return source

    def _source(self, key: int, media: str, gid: bytes, now_ns: int) -> _Source:
        """The source of a sample."""
        source = self._sources.get((key, media, gid))
        if source is None:
            if len(self._sources) >= _MOST_SOURCES:
                number, _, publisher = first = next(iter(self._sources))
                del self._sources[first]
                self._flowing.pop((number, publisher), None)
            source = self._sources[key, media, gid] = _Source(self._learn(key, media), now_ns)
        elif source.stream == _NONE and now_ns - source.asked_ns > _ASK_AGAIN_NS:
            source.stream, source.asked_ns = self._learn(key, media), now_ns
        return source

    def _learn(self, key: int, media: str) -> int:
        found = self._identify(self.keys[key], media)
        self.reasons[key] = found if isinstance(found, str) else ""
        return _NONE if isinstance(found, str) else found
