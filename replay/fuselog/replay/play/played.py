"""One message on its way out of a player."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from fuselog.replay.log.channels import Channel
from fuselog.schemas.messages import Messages

_TOGETHER = 256  # messages that are taken out of their arrays at once: a tenth of a millisecond


class Played(NamedTuple):
    """A message, and where it lies on the timeline: ``t_ns`` is its log time unless another order is asked for."""

    t_ns: int
    channel: Channel
    payload: bytes
    log_time: int
    is_tick: bool = False  # made by the player: says what time it is, and is no step of the log


def each(messages: Messages, channels: Mapping[int, Channel]) -> Iterator[Played]:
    """The messages one by one by their log times, with bytes of their own."""
    data = messages.data.data
    for first in range(0, len(messages), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        for log_time, stream, start, length in zip(
            messages.log_time[some].tolist(),
            messages.stream[some].tolist(),
            messages.start[some].tolist(),
            messages.length[some].tolist(),
            strict=True,
        ):
            yield Played(log_time, channels[stream], bytes(data[start : start + length]), log_time)
