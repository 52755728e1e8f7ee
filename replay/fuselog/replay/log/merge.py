"""Pieces that overlap in time, merged exactly: by log time, ties by file and by where they lie in it."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.log.workers import opened_ahead
from fuselog.schemas.compiled import kernel
from fuselog.schemas.messages import Messages

Place = tuple[int, ...]  # where messages lie: number of the file, position in it; equal log times come by it

_FETCHED = 4  # pieces that may be on their way from a server


def _nothing() -> None:
    """What is here need not be fetched or opened."""


class Piece(NamedTuple):
    """Messages that are loaded together: none is before ``start_ns``.

    ``open`` does what takes time, in any thread, and notes nothing; ``load`` makes of what it gave the messages in time
    order, ties as they lie in the file, None if there are none. ``fetch`` is called some pieces before.
    """

    start_ns: int
    place: Place
    load: Callable[[Any], Messages | None]
    open: Callable[[], Any] = _nothing
    fetch: Callable[[], None] = _nothing


_Loaded = tuple[Place, Messages]


def in_time_order(pieces: Iterable[Piece], workers: int = 1) -> Iterator[Messages]:
    """Load pieces by start time and yield what no later one can precede: by log time, ties by place.

    Only pieces that overlap are held together; one that no other overlaps is passed on without a copy. More than one of
    ``workers`` are threads that open pieces ahead, the caller's among them; their number changes nothing that comes.
    """
    order = sorted(pieces, key=lambda piece: (piece.start_ns, piece.place))
    waiting: list[_Loaded] = []
    with opened_ahead([piece.open for piece in order], workers) as opened:
        for number, (piece, following) in enumerate(zip(order, [*order[1:], None], strict=False)):
            for soon in order[number : number + _FETCHED]:
                soon.fetch()
            messages = piece.load(next(opened))
            if messages is not None:
                waiting.append((piece.place, messages))
            ready, waiting = _cut(waiting, following)
            if ready:
                yield _join(ready)


def _cut(waiting: list[_Loaded], following: Piece | None) -> tuple[list[_Loaded], list[_Loaded]]:
    """(what comes before all messages of the following piece, the rest)."""
    ready: list[_Loaded] = []
    rest: list[_Loaded] = []
    for place, messages in waiting:
        n = len(messages)
        if following is not None:
            side = "right" if place < following.place else "left"
            n = int(np.searchsorted(messages.log_time, following.start_ns, side=side))
        if n:
            ready.append((place, messages.take(slice(0, n))))
        if n < len(messages):
            rest.append((place, messages.take(slice(n, None))))
    return ready, rest


def _join(parts: list[_Loaded]) -> Messages:
    """One time-ordered batch of several; the payloads are copied, unless there is one part."""
    if len(parts) == 1:
        return parts[0][1]
    several = [messages for _, messages in sorted(parts, key=lambda part: part[0])]
    log_time = np.concatenate([m.log_time for m in several])
    order = np.argsort(log_time, kind="stable")
    length = np.concatenate([m.length for m in several])
    end = np.cumsum(length[order])
    start = np.empty_like(length)
    start[order] = end - length[order]
    data = np.empty(int(end[-1]), np.uint8)
    at = 0
    for m in several:
        copy_payloads(m.data, m.start, m.length, start[at : at + len(m)], data)
        at += len(m)
    data.flags.writeable = False
    return Messages(
        stream=np.concatenate([m.stream for m in several])[order],
        data=data,
        start=start[order],
        length=length[order],
        log_time=log_time[order],
        publish_time=np.concatenate([m.publish_time for m in several])[order],
        sequence=np.concatenate([m.sequence for m in several])[order],
    )


@kernel
def copy_payloads(
    source: NDArray[np.uint8],
    start: NDArray[np.int64],
    length: NDArray[np.int64],
    target_start: NDArray[np.int64],
    target: NDArray[np.uint8],
) -> None:
    """Copy payload i from ``source[start[i]:]`` to ``target[target_start[i]:]``."""
    for i in range(len(start)):
        target[target_start[i] : target_start[i] + length[i]] = source[start[i] : start[i] + length[i]]
