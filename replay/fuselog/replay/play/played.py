"""One message on its way out of a player."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from fuselog.replay.channels import Channel
from fuselog.schemas.messages import Messages

_TOGETHER = 256  # messages that are taken out of their arrays at once: a tenth of a millisecond


class Played(NamedTuple):
    """A message, and where it lies on the timeline: ``t_ns`` is its log time unless another order is asked for."""

    t_ns: int
    channel: Channel
    payload: bytes
    log_time: int
    is_tick: bool = False  # made by the player: says what time it is, and is no step of the log


def each(messages: Messages, channels: Mapping[int, Channel], t_ns: list[int] | None = None) -> Iterator[Played]:
    """The messages one by one, with bytes of their own; ``t_ns`` (n,) is their log time when None."""
    data = messages.data.data
    for first in range(0, len(messages), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        log_times = messages.log_time[some].tolist()
        for t, log_time, stream, start, length in zip(
            log_times if t_ns is None else t_ns[some],
            log_times,
            messages.stream[some].tolist(),
            messages.start[some].tolist(),
            messages.length[some].tolist(),
            strict=True,
        ):
            yield Played(t, channels[stream], bytes(data[start : start + length]), log_time)
