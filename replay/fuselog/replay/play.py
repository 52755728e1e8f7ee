"""A log played in time: its messages one after the other, each when it is due. Knows no middleware."""

import time
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from fuselog.replay.channels import Channel
from fuselog.replay.log import Log
from fuselog.replay.tracks import is_output
from fuselog.schemas.errors import LogError

_HOLD = ("/tf_static", "tf_static")  # said once and true ever after: played even when the start is later
_SHORTEST_SLEEP = 1e-4  # s; what is due sooner is played at once


class Played(NamedTuple):
    """One message on its way out. ``sequence`` counts those of its channel from 1; times are ns."""

    channel: Channel
    payload: bytes
    log_time: int
    sequence: int


def playable(log: Log, *, topics: Collection[str] = (), exclude: Collection[str] = ()) -> list[Channel]:
    """The channels that a player publishes: inputs of ``topics`` (all when empty), without ``exclude``.

    Results of an earlier run are never among them. Raises ``LogError`` for a topic that the log does not have.
    """
    for topic in (*topics, *exclude):
        if topic not in log.topics:
            raise LogError(log.path, 0, f"no topic {topic!r}; it has {', '.join(log.topics) or 'none'}")
    return [
        channel
        for channel in log.channels.values()
        if not is_output(channel) and channel.topic not in exclude and (not topics or channel.topic in topics)
    ]


def play(
    log: Log,
    channels: Collection[Channel],
    *,
    rate: float | None = 1.0,
    start_s: float = 0.0,
    duration_s: float | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Played]:
    """Yield the messages of ``channels`` in log-time order, ties in file order, each when it is due.

    Message i is due at (log_time_i - first) / ``rate`` seconds of ``clock`` after the start; with ``rate`` None all
    are due at once, so that whoever takes them sets the pace. A late message is yielded at once, none is left out.
    ``start_s`` and ``duration_s`` count from the beginning of the log.
    """
    first = (log.time_range or (0, 0))[0] + round(start_s * 1e9)
    end = None if duration_s is None else first + round(duration_s * 1e9)
    numbers = {channel.id: channel for channel in channels}
    counts = dict.fromkeys(numbers, 0)
    started = clock()
    for message in log.messages({channel.topic for channel in channels}):
        channel = numbers.get(message.channel_id)
        if channel is None or (message.log_time < first and channel.topic not in _HOLD):
            continue
        if end is not None and message.log_time >= end:
            return
        if rate is not None:
            ahead = (message.log_time - first) / (1e9 * rate) - (clock() - started)
            if ahead > _SHORTEST_SLEEP:
                sleep(ahead)
        counts[channel.id] += 1
        yield Played(channel, message.data, message.log_time, counts[channel.id])
