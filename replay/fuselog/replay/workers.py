"""Chunks opened some ahead of who takes them, by several threads."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from fuselog.replay.chunks import Chunk

_T = TypeVar("_T")
_AHEAD = 2  # chunks of a worker that may be open and not taken


@contextmanager
def opened_ahead(
    chunks: Iterable[Chunk], open_chunk: Callable[[Chunk], _T], workers: int
) -> Generator[Callable[[Chunk], _T]]:
    """``open_chunk`` for chunks that are asked for in this order, by so many threads; one worker is no thread.

    The result, or the exception that opening raised, is the same as without threads: they share nothing that changes.
    """
    if workers < 2:
        yield open_chunk
        return
    coming = iter(chunks)
    waiting: deque[tuple[Chunk, Future[_T]]] = deque()
    pool = ThreadPoolExecutor(workers, "opening")

    def ask() -> None:
        for chunk in coming:
            waiting.append((chunk, pool.submit(open_chunk, chunk)))
            return

    def take(chunk: Chunk) -> _T:
        first, future = waiting.popleft()
        if first is not chunk:
            raise AssertionError("chunks are taken in the order in which they were announced")
        ask()
        return future.result()

    try:
        for _ in range(_AHEAD * workers):
            ask()
        yield take
    finally:
        pool.shutdown(cancel_futures=True)
