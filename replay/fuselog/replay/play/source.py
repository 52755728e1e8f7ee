"""Where a player takes its messages from: a log that can be begun at any time."""

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from typing import Protocol

import numpy as np

from fuselog.replay.ahead import ahead
from fuselog.replay.log import Log
from fuselog.replay.log.channels import Channel
from fuselog.replay.play.latched import is_latched, latched_before
from fuselog.replay.play.played import Played, each
from fuselog.schemas.messages import Messages

AHEAD = 2  # chunks that are read before they are due


class Source(Protocol):
    """Messages in the order in which they are played; times are ns of that order."""

    @property
    def by_log_time(self) -> Mapping[str, int]:
        """By topic: messages that lie by their log time, for they have no other."""
        ...

    @property
    def first(self) -> int:
        """Where it begins."""
        ...

    @property
    def last(self) -> int:
        """Where its last message lies."""
        ...

    def begin(self, start: int, end: int | None) -> Generator[Played]:
        """The messages from ``start`` up to but without ``end``; close it before the next is begun."""
        ...

    def latched(self, t_ns: int) -> list[Played]:
        """What was said before ``t_ns`` and holds then; not while another reading is begun."""
        ...


class LogSource:
    """Channels of a log by log time, ties as they lie in the file; begun anywhere, it reads what comes from there."""

    def __init__(self, log: Log, channels: Sequence[Channel]) -> None:
        self._log = log
        self._channels = {channel.id: channel for channel in channels}
        self._latched = [channel for channel in channels if is_latched(channel)]
        self.first, self.last = log.time_range or (0, 0)
        self.by_log_time: Mapping[str, int] = {}

    def begin(self, start: int, end: int | None) -> Generator[Played]:
        """See ``Source``. A reading of all of the log compares counts with what the log says, see ``Log.losses``."""
        with closing(
            ahead(chosen(self._log, self._channels, None if start <= self.first else start, end), AHEAD)
        ) as batches:
            for batch in batches:
                yield from each(batch, self._channels)

    def latched(self, t_ns: int) -> list[Played]:
        """See ``Source``."""
        return latched_before(self._log, self._latched, t_ns)


def chosen(log: Log, channels: dict[int, Channel], start: int | None, end: int | None) -> Iterator[Messages]:
    """Batches of the channels alone: a topic may have others besides."""
    ids = np.array(list(channels), np.int32)
    for batch in log.batches({channel.topic for channel in channels.values()}, start_ns=start, end_ns=end):
        mine = np.flatnonzero(np.isin(batch.stream, ids))
        yield batch if len(mine) == len(batch) else batch.take(mine)
