"""Calls made some ahead of who takes what they give, by the taker and other threads."""

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

_T = TypeVar("_T")
_Begun = tuple[Callable[[], _T], Future[_T]]
_AHEAD = 2  # calls of a worker whose result may wait to be taken


@contextmanager
def opened_ahead(calls: Sequence[Callable[[], _T]], workers: int) -> Generator[Iterator[_T]]:
    """What the calls give, in their order, by so many threads, of which one is the taker itself while it would wait.

    A result, or the exception that a call raised, is the same as without threads: they share nothing that changes.
    """
    if workers < 2:
        yield (call() for call in calls)
        return
    pool = ThreadPoolExecutor(workers - 1, "opening")

    def results() -> Iterator[_T]:
        begun: deque[_Begun[_T]] = deque()
        for call in calls:
            begun.append((call, pool.submit(call)))
            if len(begun) > _AHEAD * workers:
                yield _take(begun)
        while begun:
            yield _take(begun)

    try:
        yield results()
    finally:
        pool.shutdown(cancel_futures=True)


def _take(begun: deque[_Begun[_T]]) -> _T:
    """The result of the first call; until it is there, those that no thread has begun are made here."""
    while not begun[0][1].done():
        free = next((n for n, (_, future) in enumerate(begun) if future.cancel()), None)
        if free is None:
            break
        call = begun[free][0]
        begun[free] = call, _made(call)
    return begun.popleft()[1].result()


def _made(call: Callable[[], _T]) -> Future[_T]:
    future: Future[_T] = Future()
    try:
        future.set_result(call())
    except Exception as error:  # raised where the result is taken
        future.set_exception(error)
    return future
