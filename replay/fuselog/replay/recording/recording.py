"""A recording: takes messages, owns its files, and knows at every moment what is safe and what was lost."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.channels import Channel, Schema
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.framing import OVERHEAD, Batch, Frames
from fuselog.replay.recording.files import Names, Part, RecordingError
from fuselog.replay.recording.latched import Latched
from fuselog.replay.recording.ledger import Account, Ledger, Reason, total
from fuselog.replay.recording.options import BOUNDS, RecordOptions
from fuselog.replay.recording.ring import Ring
from fuselog.schemas import Messages
from fuselog.schemas.errors import LogError

State = Literal["recording", "stopped", "closed"]

_LARGEST = Limits().chunk_bytes - OVERHEAD  # what a reader takes without being told to
_MOST_CHANNELS = Limits().channels


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingStatus:
    """A recording at one moment.

    ``durable_until``: log time (ns) up to which all that was received and not counted as dropped is safe, None while
    nothing is. ``state`` is "stopped" when the disk takes no more; ``reason`` says why.
    """

    state: State
    reason: str
    files: tuple[str, ...]
    bytes: int  # of all files
    durable_until: int | None
    accounts: Mapping[str, Account]  # by topic

    @property
    def total(self) -> Account:
        """The account of all topics together."""
        return total(self.accounts)


class Recording:
    """Writes messages to ``path``, or where ``options`` call for several files, to NAME_0.mcap, NAME_1.mcap, ...

    Each file is a whole log: it declares all channels met so far and begins with the latched messages. One thread
    calls all methods; between messages it calls ``tick`` at least ten times a second. A disk that takes no more is no
    exception but the state "stopped". Raises ``RecordingError`` or ``LogError`` when the recording cannot begin.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        options: RecordOptions | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._options = options or RecordOptions()
        self._clock = clock
        self._bounds = BOUNDS[self._options.durability]
        self._names = Names(Path(path), numbered=self._options.numbered, resume=self._options.resume)
        self._channels: list[Channel] = []
        self._numbers: dict[tuple[str, Schema, str, tuple[tuple[str, str], ...]], int] = {}
        self._latched = Latched(self._options.latched)
        self._ledger = Ledger()
        self._pending = np.zeros(_MOST_CHANNELS + 1, np.int64)  # written and not safe yet, by channel
        self._pending_bytes = 0
        self._pending_since = 0.0
        self._newest = 0  # log time of what was written
        self._durable: int | None = None
        self._files: list[str] = []
        self._closed_bytes = 0
        self._state: State = "recording"
        self._reason = ""
        self._part: Part | None = None
        self._ring: Ring | None = None
        _load_kernels()
        span = self._options.snapshot_ns
        if span is None:
            self._begin()
        else:
            _check_folder(Path(path))
            self._ring = Ring(span, self._options.snapshot_bytes)

    @property
    def on_demand(self) -> bool:
        """Whether only snapshots are written."""
        return self._ring is not None

    @property
    def full(self) -> bool:
        """Whether there are as many channels as a reader takes."""
        return len(self._channels) >= _MOST_CHANNELS

    def add_channel(
        self, topic: str, schema: Schema, *, encoding: str = "cdr", metadata: Mapping[str, str] | None = None
    ) -> int | None:
        """Declare a channel, or find the same -> its number for ``Messages.stream``; None when there are too many.

        A schema without a name is none.
        """
        about = dict(metadata or {})
        identity = (topic, schema, encoding, tuple(sorted(about.items())))
        if identity in self._numbers:
            return self._numbers[identity]
        if self.full:
            return None
        channel = Channel(len(self._channels) + 1, topic, schema, encoding, about, None)
        self._channels.append(channel)
        self._numbers[identity] = channel.id
        self._latched.watch(channel.id, topic)
        self._ledger.add(topic)
        if self._part is not None:
            try:
                self._part.declare(channel)
            except LogError as error:
                self._stop(error)
        return channel.id

    def drop(self, topic: str, reason: Reason, count: int = 1) -> None:
        """Account for messages that were received and did not come as far as ``write``."""
        self._ledger.add(topic, received=count, **{reason: count})

    def miss(self, topic: str, count: int) -> None:
        """Account for numbers that a publisher gave and that did not come."""
        self._ledger.add(topic, gaps=count)

    def write(self, messages: Messages) -> None:
        """Take messages in the order in which they were received, with log times (from 0) of arrival."""
        if not len(messages):
            return
        self._count(messages, received=1)
        fits = messages.length <= _LARGEST
        if not fits.all():
            self._count(messages.take(np.flatnonzero(~fits)), limit=1)
            messages = messages.take(np.flatnonzero(fits))
        self._latched.remember(messages)
        if self._ring is None:
            self._write(messages)
        elif len(messages):
            self._keep(self._ring, messages)

    def tick(self) -> None:
        """Make safe what has waited for long enough."""
        if self._pending_bytes and self._clock() - self._pending_since >= self._bounds.seconds:
            self._flush()

    def snapshot(self) -> Path | None:
        """Write what is in memory to the next file, and empty the memory -> that file, None when it failed.

        Without ``snapshot_ns`` there is nothing to write. A failed snapshot does not end the recording.
        """
        if self._ring is None:
            return None
        young, old = self._ring.take()
        for messages in old:
            self._count(messages, waiting=-1, expired=1)
        for messages in young:
            self._count(messages, waiting=-1)
        self._state, self._reason = "recording", ""
        try:
            self._begin(int(young[0].log_time[0]) if young else None)
        except (LogError, RecordingError) as error:
            self._stop(error)
        written = self._part
        for messages in young:
            self._write(messages)
        self._end()
        return written.path if written is not None and self._state == "recording" else None

    def close(self) -> None:
        """Make all safe and close the file; what waits for a snapshot is given up."""
        if self._ring is not None:
            for messages in (batch for batches in self._ring.take() for batch in batches):
                self._count(messages, waiting=-1, expired=1)
        self._end()
        if self._state == "recording":
            self._state = "closed"

    def status(self) -> RecordingStatus:
        """The recording as it is now."""
        return RecordingStatus(
            state=self._state,
            reason=self._reason,
            files=tuple(self._files),
            bytes=self._closed_bytes + (self._part.size if self._part is not None else 0),
            durable_until=self._durable,
            accounts=self._ledger.accounts(),
        )

    def _keep(self, ring: Ring, messages: Messages) -> None:
        self._count(messages, waiting=1)
        left = ring.add(messages)
        for batch in left.expired:
            self._count(batch, waiting=-1, expired=1)
        for batch in left.evicted:
            self._count(batch, waiting=-1, limit=1)

    def _write(self, messages: Messages) -> None:
        """Append to the file, cut where a file is full; what finds none is counted."""
        most = min(self._bounds.bytes, max((self._options.max_bytes or self._bounds.bytes) // 4, 1))
        for piece in _pieces(messages, most):
            rest = piece
            while len(rest) and self._part is not None:
                rest = rest.take(slice(self._write_some(self._part, rest), None))
            self._count(rest, disk=1)

    def _write_some(self, part: Part, messages: Messages) -> int:
        """Write those that the file has room for, or begin the next file when it has none -> how many it took."""
        n = self._room(part, messages)
        try:
            if n:
                self._append(messages.take(slice(0, n)))
            else:
                self._next(int(messages.log_time[0]))
        except (LogError, RecordingError) as error:
            self._stop(error)
        return n

    def _room(self, part: Part, messages: Messages) -> int:
        """How many of the messages the file still takes; at least one when it has none."""
        options, n = self._options, len(messages)
        if part.first_ns is None:
            part_first = int(messages.log_time[0])
        else:
            part_first = part.first_ns
            size = part.size + self._pending_bytes + _bytes(messages)
            if options.max_bytes is not None and size > options.max_bytes:
                return 0
        if options.max_ns is None:
            return n
        over = messages.log_time >= part_first + options.max_ns
        return int(over.argmax()) if over.any() else n

    def _append(self, messages: Messages) -> None:
        size = _bytes(messages)
        if self._pending_bytes and self._pending_bytes + size > self._bounds.bytes:
            self._flush()
        if self._part is None:
            self._count(messages, disk=1)
            return
        if not self._pending_bytes:
            self._pending_since = self._clock()
        self._pending += np.bincount(messages.stream, minlength=len(self._pending))
        self._count(messages, waiting=1)
        self._pending_bytes += size
        if self._durable is not None:  # a clock that went back
            self._durable = min(self._durable, int(messages.log_time.min()) - 1)
        self._newest = max(self._newest, int(messages.log_time.max()))
        self._part.write(messages)
        if self._pending_bytes >= self._bounds.bytes:
            self._flush()

    def _flush(self) -> None:
        if self._part is None:
            return
        try:
            self._part.flush()
        except LogError as error:
            self._stop(error)
            return
        if self._pending_bytes:
            self._durable = self._newest
        self._settle(written=1)

    def _settle(self, **where: int) -> None:
        """Move what was pending to another field of the ledger."""
        for channel in np.flatnonzero(self._pending).tolist():
            n = int(self._pending[channel])
            moved = {name: n * sign for name, sign in where.items()}
            self._ledger.add(self._channels[channel - 1].topic, waiting=-n, **moved)
        self._pending[:] = 0
        self._pending_bytes = 0

    def _begin(self, first_ns: int | None = None) -> None:
        """Open the next file, with all channels, and in one that begins at ``first_ns`` what is latched."""
        part = self._part = Part(self._names.next(), self._options, self._channels)
        self._files.append(str(part.path))
        repeated = None if first_ns is None else self._latched.repeat(first_ns)
        if repeated is not None:
            part.write(repeated)

    def _next(self, first_ns: int) -> None:
        self._end()
        if self._state == "recording":
            self._begin(first_ns)

    def _end(self) -> None:
        """Make all safe and close the file, if one is open."""
        self._flush()
        if self._part is None:
            return
        try:
            self._part.close({name: str(n) for name, n in self.status().total._asdict().items()})
        except (LogError, OSError) as error:
            self._halt(error)
        self._closed_bytes += self._part.size
        self._part = None

    def _stop(self, error: LogError | RecordingError) -> None:
        """Give up the file; what was not safe in it is lost."""
        self._halt(error)
        if self._part is not None:
            self._part.cut()
            self._closed_bytes += self._part.size
            self._part = None
        self._settle(disk=1)

    def _halt(self, error: LogError | RecordingError | OSError) -> None:
        self._state = "stopped"
        self._reason = str(error) if isinstance(error, OSError) else f"{error.path}: {error.reason}"

    def _count(self, messages: Messages, **where: int) -> None:
        """Add the messages to fields of the ledger; a field of -1 loses them."""
        counts = np.bincount(messages.stream, minlength=1)
        for channel in np.flatnonzero(counts).tolist():
            n = int(counts[channel])
            topic = self._channels[channel - 1].topic
            self._ledger.add(topic, **{name: n * sign for name, sign in where.items()})


def _bytes(messages: Messages) -> int:
    return int(messages.length.sum()) + OVERHEAD * len(messages)


def _pieces(messages: Messages, most: int) -> Iterator[Messages]:
    """The messages in parts of at most so many bytes each, or of one larger message."""
    ends: NDArray[np.int64] = np.cumsum(messages.length + OVERHEAD)
    first = 0
    while first < len(messages):
        begin = int(ends[first - 1]) if first else 0
        last = max(first + 1, int(np.searchsorted(ends, begin + most, "right")))
        yield messages.take(slice(first, last))
        first = last


def _check_folder(path: Path) -> None:
    if not path.parent.is_dir():
        raise RecordingError(path, f"there is no folder {path.parent}")


def _load_kernels() -> None:
    """Compile what writing needs, or load it, before the first message comes."""
    one = np.zeros(1, np.int64)
    empty = Messages(
        stream=np.zeros(1, np.int32),
        data=np.frombuffer(b"", np.uint8),
        start=one,
        length=one,
        log_time=one,
        publish_time=one,
        sequence=one,
    )
    Frames(2 * OVERHEAD).add(Batch.of(empty), 0)
