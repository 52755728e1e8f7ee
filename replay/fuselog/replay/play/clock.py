"""The time of the log as ROS nodes take it: ``rosgraph_msgs/msg/Clock`` at equal steps of event time."""

from collections.abc import Callable, Generator, Iterable

import numpy as np

from fuselog.replay.log.channels import Channel, Schema
from fuselog.replay.play.played import Played
from fuselog.replay.play.timeline import CommandError
from fuselog.schemas import CdrEncoder, definition

CLOCK_TOPIC = "/clock"
TICKS = "@clock"  # what the player calls it: a log may have a /clock as well, played under another name
_TYPE = "rosgraph_msgs/msg/Clock"
_SECONDS = range(0, 2**31)  # that the message can say
_HIGHEST_HZ = 10_000


def clock_channel() -> Channel:
    """The channel of the player's own clock, ``TICKS``; its number is that of no channel of a log."""
    return Channel(-1, TICKS, Schema(_TYPE, "ros2msg", definition(_TYPE).encode()), "cdr", {}, None)


def ticker(hz: float) -> tuple[Callable[[int], Played], int]:
    """What makes the clock message of a time in ns, and the step between two; raises ``CommandError`` for the rate."""
    if not 0 < hz <= _HIGHEST_HZ:
        raise CommandError(f"a clock of {hz:g} Hz: above 0, at most {_HIGHEST_HZ}")
    encoder, channel = CdrEncoder(_TYPE, definition(_TYPE), columns=[], stamp="clock"), clock_channel()
    nothing = np.empty((1, 0))

    def tick(t_ns: int) -> Played:
        said = t_ns if t_ns // 10**9 in _SECONDS else 0
        payload, _ = encoder.encode(np.array([said]), nothing)
        return Played(t_ns, channel, payload.tobytes(), t_ns, is_tick=True)

    return tick, max(1, round(1e9 / hz))


def with_ticks(
    messages: Iterable[Played], tick: Callable[[int], Played], step_ns: int, *, first: int, begin: int
) -> Generator[Played]:
    """The messages, and between them a tick at ``first`` and every ``step_ns`` from there on, after ``begin``.

    A tick comes before messages of the same time. None comes after the last message.
    """
    count = (begin - first) // step_ns + 1
    for played in messages:
        while first + count * step_ns <= played.t_ns:
            yield tick(first + count * step_ns)
            count += 1
        yield played
