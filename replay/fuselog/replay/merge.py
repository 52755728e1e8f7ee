"""Chunks that overlap in time, merged exactly: by log time, and ties as they lie in the file."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.chunks import Chunk
from fuselog.schemas.compiled import kernel
from fuselog.schemas.messages import Messages

Part = tuple[int, Messages]  # where its chunk lies in the file; its messages in time order


def in_time_order(chunks: Iterable[Chunk], load: Callable[[Chunk], Messages | None]) -> Iterator[Messages]:
    """Load chunks by start time and yield what no later chunk can precede.

    ``load`` gives the messages of a chunk in time order, None if it has none. Only chunks that overlap
    are held together; a chunk that no other overlaps is passed on as it is, without a copy.
    """
    order = by_start(chunks)
    waiting: list[Part] = []
    for chunk, following in zip(order, [*order[1:], None], strict=False):
        messages = load(chunk)
        if messages is not None:
            waiting.append((chunk.offset, messages))
        ready, waiting = _cut(waiting, following)
        if ready:
            yield _join(ready)


def by_start(chunks: Iterable[Chunk]) -> list[Chunk]:
    """The chunks in the order in which they are loaded."""
    return sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset))


def _cut(waiting: list[Part], following: Chunk | None) -> tuple[list[Part], list[Part]]:
    """(what comes before all messages of the following chunk, the rest)."""
    ready: list[Part] = []
    rest: list[Part] = []
    for offset, messages in waiting:
        n = len(messages)
        if following is not None:
            side = "right" if offset < following.offset else "left"
            n = int(np.searchsorted(messages.log_time, following.start_ns, side=side))
        if n:
            ready.append((offset, messages.take(slice(0, n))))
        if n < len(messages):
            rest.append((offset, messages.take(slice(n, None))))
    return ready, rest


def _join(parts: list[Part]) -> Messages:
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
