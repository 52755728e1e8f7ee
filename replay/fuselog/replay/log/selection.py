"""Which messages of a log are wanted: channels, and a stretch of log time."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from fuselog.replay.log.channels import Channel

Topics = str | Collection[str] | re.Pattern[str]  # one name, names, or a pattern for whole names
BEGINNING, END = 0, 2**63  # ns; no log time lies before or at


@dataclass(frozen=True, slots=True)
class Selection:
    """The messages of ``channels`` (all when None) with ``start_ns`` <= log time < ``end_ns``."""

    channels: frozenset[int] | None = None
    start_ns: int = BEGINNING
    end_ns: int = END

    @property
    def whole_time(self) -> bool:
        """Whether no time is left out."""
        return self.start_ns <= BEGINNING and self.end_ns >= END

    def overlaps(self, start_ns: int, finish_ns: int) -> bool:
        """Whether something of [start_ns, finish_ns] can be wanted; one that ends before it begins tells nothing."""
        return finish_ns < start_ns or (finish_ns >= self.start_ns and start_ns < self.end_ns)

    def renumbered(self, numbers: Mapping[int, int]) -> "Selection":
        """The same for a file whose channel c is ``numbers[c]`` here."""
        if self.channels is None:
            return self
        mine = frozenset(own for own, number in numbers.items() if number in self.channels)
        return Selection(mine, self.start_ns, self.end_ns)


def select(
    channels: Iterable[Channel], topics: Topics | None, start_ns: int | None = None, end_ns: int | None = None
) -> Selection:
    """The selection of ``topics`` (all when None) among ``channels``; an open end is None."""
    return Selection(
        None if topics is None else frozenset(c.id for c in channels if _matches(c.topic, topics)),
        BEGINNING if start_ns is None else start_ns,
        END if end_ns is None else end_ns,
    )


def _matches(topic: str, topics: Topics) -> bool:
    if isinstance(topics, re.Pattern):
        return topics.fullmatch(topic) is not None
    return topic == topics if isinstance(topics, str) else topic in topics
