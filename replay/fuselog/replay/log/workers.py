"""Calls made some ahead of who takes what they give, by several threads."""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

_T = TypeVar("_T")
_AHEAD = 2  # calls of a worker whose result may wait to be taken


@contextmanager
def opened_ahead(calls: Sequence[Callable[[], _T]], workers: int) -> Generator[Iterator[_T]]:
    """What the calls give, in their order, by so many threads; one worker is no thread.

    A result, or the exception that a call raised, is the same as without threads: they share nothing that changes.
    """
    if workers < 2:
        yield (call() for call in calls)
        return
    pool = ThreadPoolExecutor(workers, "opening")

    def results() -> Iterator[_T]:
        waiting: deque[Future[_T]] = deque()
        for call in calls:
            waiting.append(pool.submit(call))
            if len(waiting) > _AHEAD * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    try:
        yield results()
    finally:
        pool.shutdown(cancel_futures=True)
